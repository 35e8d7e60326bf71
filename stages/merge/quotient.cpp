#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "formats/io/cost.h"
#include "formats/io/error.h"
#include "formats/transient_cube.h"
#include "stages/core/app/report.h"
#include "stages/core/app/values.h"
#include "stages/merge/merge.h"

namespace loom::merge {
namespace {

/// A parameter and its values in the cubes of both sides.
struct Step {
    std::string name;
    double low, high;
};

/// throws:  InputError unless the text is NAME=LOW:HIGH with LOW < HIGH
Step parse_step(const std::string& text) {
    const std::size_t equals = text.rfind('='), colon = text.find(':', equals == std::string::npos ? 0 : equals);
    if (equals != std::string::npos && equals > 0 && colon != std::string::npos) {
        const auto low = app::parse_number<double>(std::string_view(text).substr(equals + 1, colon - equals - 1));
        const auto high = app::parse_number<double>(std::string_view(text).substr(colon + 1));
        if (low && high && *low < *high) return {text.substr(0, equals), *low, *high};
    }
    throw InputError(fmt::format("--quotient {}: must be NAME=LOW:HIGH, LOW below HIGH", text));
}

/// The cubes of both values of the parameter, traced with the same random numbers.
struct Pair {
    TransientCube high, low;
};

std::vector<Pair> read_pairs(const Options& options) {
    if (options.minus.size() != options.parts.size())
        throw InputError(
            fmt::format("--quotient: {} cubes after --minus for {} parts", options.minus.size(), options.parts.size()));
    std::vector<Pair> pairs;
    for (std::size_t i = 0; i < options.parts.size(); ++i) {
        const std::string &high = options.parts[i], &low = options.minus[i];
        pairs.push_back({read_transient_cube(high), read_transient_cube(low)});
        const TransientCube &a = pairs.back().high, &b = pairs.back().low, &first = pairs[0].high;
        for (const auto& [cube, file] : {std::pair{&a, &high}, std::pair{&b, &low}})
            if (const std::string why = difference_in_words(*cube, first); !why.empty())
                throw InputError(fmt::format("{}: {} (of {})", *file, why, options.parts[0]));
        if (a.provenance.seed != b.provenance.seed)
            throw InputError(
                fmt::format("{}: was made with seed {}, but {} with {}; trace both with the same --seed, so that their "
                            "noise cancels",
                            low, b.provenance.seed, high, a.provenance.seed));
        for (const auto& [cube, file] : {std::pair{&a, &high}, std::pair{&b, &low}})
            if (cube->film.samples_per_pixel != first.film.samples_per_pixel || cube->film.samples_per_pixel == 0)
                throw InputError(fmt::format("{}: has {} samples per pixel, but {} has {}", *file,
                                             cube->film.samples_per_pixel, options.parts[0],
                                             first.film.samples_per_pixel));
    }
    return pairs;
}

/// A row of one array: means over the pairs of the values and of their difference quotients, with variances.
struct QuotientRow {
    std::vector<float> mean, var_mean, derivative, derivative_var_mean;

    /// in:      variance  null where only means are needed
    QuotientRow(std::span<const Pair> pairs, double step, Column<float> TransientCube::*values,
                Column<float> TransientCube::*variance, std::size_t first, std::size_t n)
        : mean(n), var_mean(n), derivative(n), derivative_var_mean(n) {
        const auto R = double(pairs.size());
        for (std::size_t i = 0; i < n; ++i) {
            double sum = 0, quotients = 0, squares = 0, bound = 0;
            for (const Pair& pair : pairs) {
                const auto a = double((pair.high.*values)[first + i]), b = double((pair.low.*values)[first + i]);
                sum += (a + b) / 2;
                quotients += (a - b) / step;
                squares += (a - b) / step * ((a - b) / step);
                if (variance)
                    bound += double((pair.high.*variance)[first + i]) + double((pair.low.*variance)[first + i]);
            }
            mean[i] = float(sum / R);
            derivative[i] = float(quotients / R);
            var_mean[i] = float(bound / 2 / (R * R));
            // The spread of the pairs; of a single pair, Var(a - b) <= 2 (Var a + Var b).
            derivative_var_mean[i] =
                float(pairs.size() > 1 ? std::max(0.0, squares - quotients * quotients / R) / (R * (R - 1))
                                       : 2 * bound / (step * step));
        }
    }
};

}  // namespace

void run_quotient(const Options& options, app::Report& report) {
    using Cube = TransientCube;
    const Step step = parse_step(options.quotient);
    const std::vector<Pair> pairs = read_pairs(options);
    const double h = step.high - step.low;
    const Cube& first = pairs[0].high;

    // Set up the cube, whose derivative holds for the middle of the step.
    TransientCubeHeader header = first;
    header.film.samples_per_pixel = first.film.samples_per_pixel * pairs.size();
    header.parameters.name = {step.name};
    header.parameters.unit = {"1"};
    header.parameters.temporal = {"none"};
    header.parameters.value = std::vector<double>{(step.low + step.high) / 2};
    std::vector<std::string> parents = options.parts;
    parents.insert(parents.end(), options.minus.begin(), options.minus.end());
    header.provenance = report.provenance(
        first.provenance.seed, identify_parts(parents),
        fmt::format("on: difference quotient by {} from {:.9g} to {:.9g}", step.name, step.low, step.high));

    // Write.
    TransientCubeWriter writer(options.output, header);
    const std::size_t bins = header.row_size(), pixels = 3 * std::size_t(header.film.width);
    for (std::uint32_t y = 0; y < header.film.height; ++y) {
        const auto of_pixels = [&](Column<float> Cube::*field) {
            return QuotientRow(pairs, h, field, nullptr, y * pixels, pixels);
        };
        const QuotientRow radiance(pairs, h, &Cube::radiance, &Cube::var_mean, y * bins, bins);
        const QuotientRow before = of_pixels(&Cube::before), after = of_pixels(&Cube::after),
                          never = of_pixels(&Cube::never), steady = of_pixels(&Cube::steady);
        writer.write_rows(y, {radiance.mean,
                              radiance.var_mean,
                              before.mean,
                              after.mean,
                              never.mean,
                              steady.mean,
                              {radiance.derivative, radiance.derivative_var_mean, before.derivative, after.derivative,
                               never.derivative, steady.derivative, steady.derivative_var_mean}});
    }
    writer.commit();
    write_cost_of(options.output, report.cost(header.provenance.plan), parents);
    report.done("{}: {} pairs, {} samples per pixel", options.output, pairs.size(), header.film.samples_per_pixel);
}

}  // namespace loom::merge
