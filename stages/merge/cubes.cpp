#include <fmt/format.h>

#include <filesystem>

#include "formats/io/cost.h"
#include "formats/io/error.h"
#include "formats/transient_cube.h"
#include "stages/core/app/report.h"
#include "stages/merge/merge.h"

namespace loom::merge {
namespace {

/// Returns the rows [first, first + n) of one array of all parts. var_mean: null where only the mean is needed.
std::vector<PartOf> rows_of(std::span<const TransientCube> cubes, Column<float> TransientCube::*mean,
                            Column<float> TransientCube::*var_mean, std::size_t first, std::size_t n) {
    std::vector<PartOf> parts;
    for (const TransientCube& cube : cubes)
        parts.push_back({cube.film.samples_per_pixel, (cube.*mean).values().subspan(first, n),
                         var_mean ? (cube.*var_mean).values().subspan(first, n) : std::span<const float>()});
    return parts;
}

/// Returns the row of one array of the derivatives by parameter p, of all parts.
/// in:      row_size  numbers of a row y
///          height    rows y of the film
std::vector<PartOf> derivatives_of(std::span<const TransientCube> cubes, Column<float> TransientCube::Derivative::*mean,
                                   Column<float> TransientCube::Derivative::*var_mean, std::size_t p,
                                   std::size_t height, std::size_t y, std::size_t row_size) {
    std::vector<PartOf> parts;
    const std::size_t first = (p * height + y) * row_size;
    for (const TransientCube& cube : cubes)
        parts.push_back(
            {cube.film.samples_per_pixel, (cube.derivative.*mean).values().subspan(first, row_size),
             var_mean ? (cube.derivative.*var_mean).values().subspan(first, row_size) : std::span<const float>()});
    return parts;
}

std::vector<float> floats(const std::vector<double>& values) {
    return {values.begin(), values.end()};
}

/// Row y of the merged derivatives of all parameters.
struct DerivativeRow {
    std::vector<float> bins, var_mean, before, after, never, steady, steady_var_mean;

    DerivativeRow(std::span<const TransientCube> cubes, std::size_t y) {
        using Arrays = TransientCube::Derivative;
        const TransientCube& first = cubes[0];
        const auto join = [](std::vector<float>& to, const std::vector<double>& row) {
            to.insert(to.end(), row.begin(), row.end());
        };
        for (std::size_t p = 0; p < first.n_parameters(); ++p) {
            const auto rows = [&](Column<float> Arrays::*mean, Column<float> Arrays::*variance, std::size_t row_size) {
                return derivatives_of(cubes, mean, variance, p, first.film.height, y, row_size);
            };
            const std::size_t pixels = 3 * std::size_t{first.film.width};
            const auto of_bins = rows(&Arrays::bins, &Arrays::var_mean, first.row_size());
            join(bins, pooled_mean(of_bins));
            join(var_mean, pooled_var_mean(of_bins));
            join(before, pooled_mean(rows(&Arrays::before, nullptr, pixels)));
            join(after, pooled_mean(rows(&Arrays::after, nullptr, pixels)));
            join(never, pooled_mean(rows(&Arrays::never, nullptr, pixels)));
            const auto of_all_times = rows(&Arrays::steady, &Arrays::steady_var_mean, pixels);
            join(steady, pooled_mean(of_all_times));
            join(steady_var_mean, pooled_var_mean(of_all_times));
        }
    }
    TransientRows::Derivative rows() const { return {bins, var_mean, before, after, never, steady, steady_var_mean}; }
};

/// Merges what two parts say of light that moves between bins. A part in which no arrival time changes fits any other.
/// throws:  InputError when one part is widened and the other exact
void merge_temporal(std::vector<std::string>& merged, const TransientCube& part, const std::string& file) {
    for (std::size_t p = 0; p < merged.size(); ++p) {
        const std::string& own = part.parameters.temporal[p];
        if (merged[p] == "none") merged[p] = own;
        if (own != "none" && own != merged[p])
            throw InputError(fmt::format("{}: derivatives by {} are {} in time, those of other parts {}", file,
                                         part.parameters.name[p], own, merged[p]));
    }
}

}  // namespace

void run_cubes(const Options& options, app::Report& report) {
    using Cube = TransientCube;
    TransientCubeHeader header;
    std::vector<Cube> cubes;
    std::vector<InputId> inputs = identify_parts(options.parts);
    std::uint64_t samples = 0;
    for (const std::string& file : options.parts) {
        cubes.push_back(read_transient_cube(file));
        if (cubes.back().film.samples_per_pixel == 0)
            throw InputError(fmt::format(
                "{}: has no number of samples per pixel (attribute samples), which weighs the parts", file));
        samples += cubes.back().film.samples_per_pixel;
        if (const std::string why = difference_in_words(cubes.back(), cubes[0]); !why.empty())
            throw InputError(fmt::format("{}: {} (of {})", file, why, options.parts[0]));
        if (const std::string why = parameter_difference_in_words(cubes.back(), cubes[0]); !why.empty())
            throw InputError(fmt::format("{}: {} (of {})", file, why, options.parts[0]));
    }
    header = cubes[0];
    for (std::size_t i = 0; i < cubes.size(); ++i)
        merge_temporal(header.parameters.temporal, cubes[i], options.parts[i]);
    header.film.samples_per_pixel = samples;
    header.provenance = report.provenance(cubes[0].provenance.seed, std::move(inputs), cubes[0].provenance.plan);

    TransientCubeWriter writer(options.output, header);
    const std::size_t bins = header.row_size(), pixels = 3 * std::size_t(header.film.width);
    for (std::uint32_t y = 0; y < header.film.height; ++y) {
        const auto radiance = rows_of(cubes, &Cube::radiance, &Cube::var_mean, y * bins, bins);
        const auto of_pixels = [&](Column<float> Cube::*field) {
            return floats(pooled_mean(rows_of(cubes, field, nullptr, y * pixels, pixels)));
        };
        const std::vector<float> mean = floats(pooled_mean(radiance)), var_mean = floats(pooled_var_mean(radiance));
        const std::vector<float> before = of_pixels(&Cube::before), after = of_pixels(&Cube::after),
                                 never = of_pixels(&Cube::never), steady = of_pixels(&Cube::steady);
        const DerivativeRow derivative(cubes, y);
        writer.write_rows(y, {mean, var_mean, before, after, never, steady, derivative.rows()});
    }
    writer.commit();

    write_cost_of(options.output, report.cost(header.provenance.plan), options.parts);
    report.done("{}: {} parts, {} samples per pixel", options.output, options.parts.size(), samples);
}

}  // namespace loom::merge
