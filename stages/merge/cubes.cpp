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

std::vector<float> floats(const std::vector<double>& values) {
    return {values.begin(), values.end()};
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
    }
    header = cubes[0];
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
        writer.write_rows(y, {mean, var_mean, before, after, never, steady});
    }
    writer.commit();

    write_cost_of(options.output, report.cost(header.provenance.plan), options.parts);
    report.done("{}: {} parts, {} samples per pixel", options.output, options.parts.size(), samples);
}

}  // namespace loom::merge
