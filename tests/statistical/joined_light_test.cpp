// Shadows of area lights beyond first hits: from stored vertices (family 1) and from points of the light, joined to
// stored vertices (family 4), which a pilot chooses between. They must have one mean.
#include <fmt/format.h>
#include <gtest/gtest.h>
#include <tbb/parallel_for.h>

#include <cstdio>

#include "stages/derive/boundary.h"
#include "tests/statistical/derivative_support.h"
#include "tests/statistical/support.h"

namespace loom {
namespace {

constexpr const char* text = R"(<scene version="3.0.0">
<default name="grow" value="1"/><default name="size" value="0.2"/><default name="shiny" value="grey"/><default name="plate" value="-0.3"/>
<integrator type="path"><integer name="max_depth" value="3"/></integrator>
<sensor type="perspective"><float name="fov" value="45"/><transform name="to_world"><lookat origin="0, -4, 1.5" target="0, 0, 0.8" up="0, 0, 1"/></transform>
<film type="hdrfilm"><integer name="width" value="8"/><integer name="height" value="8"/><rfilter type="box"/></film></sensor>
<bsdf type="twosided" id="grey"><bsdf type="diffuse"><rgb name="reflectance" value="0.7, 0.7, 0.7"/></bsdf></bsdf>
<bsdf type="twosided" id="metal"><bsdf type="roughconductor"><float name="alpha" value="0.3"/></bsdf></bsdf>
<shape type="rectangle"><transform name="to_world"><scale value="2"/></transform><ref id="grey"/></shape>
<shape type="rectangle"><transform name="to_world"><scale value="2"/><rotate x="1" angle="90"/><translate y="1.9" z="2"/></transform><ref id="$shiny"/></shape>
<shape type="rectangle"><transform name="to_world"><scale value="0.5"/><rotate x="1" angle="15"/><translate x="0.5" y="0.8" z="$plate"/></transform><ref id="$shiny"/></shape>
<shape type="rectangle"><transform name="to_world"><scale x="0.5" y="0.4"/><scale value="$grow"/><rotate z="1" angle="20"/><translate x="0.1" y="0.4" z="1.1"/></transform><ref id="grey"/></shape>
<shape type="rectangle"><transform name="to_world"><scale value="$size"/><rotate x="1" angle="180"/><translate x="0.2" y="0.1" z="2.6"/></transform>
<bsdf type="diffuse"><rgb name="reflectance" value="0, 0, 0"/></bsdf><emitter type="area"><rgb name="radiance" value="10, 10, 10"/></emitter></shape>
</scene>)";

constexpr std::size_t n_quadrants = 4, n_bins = 8;
constexpr double start = 6, width = 0.5;

/// Sums over quadrants of the image and bins of the arrival time, and over all times.
std::vector<double> sums_of(const std::vector<derive::BoundaryRows>& rows) {
    std::vector<double> out(n_quadrants * (n_bins + 1));
    for (const derive::BoundaryRows& part : rows)
        for (std::size_t i = 0; i < part.pixel.size(); ++i) {
            const std::size_t q = part.pixel[i] / 8 / 4 * 2 + part.pixel[i] % 8 / 4;
            const double k = (part.opl[i] - start) / width;
            if (k >= 0 && k < double(n_bins)) out[q * (n_bins + 1) + std::size_t(k)] += double(part.dL[3 * i]);
            out[q * (n_bins + 1) + n_bins] += double(part.dL[3 * i]);
        }
    return out;
}

struct Case {
    const char* size;
    const char* shiny = "grey";  // material of the wall and of the plate
    const char* plate = "-0.3";  // its height: below the floor
};

// Standard errors of the sums 0.4 to 1.4 % of stored vertices, 0.1 to 0.2 % of joined ones. Detected mutations: near points
// joined, too, which family 1 takes (p < 1e-90); metal joined to metal, which it takes as well; the cosine of the joined
// surface left out; the share of the point that stands for all left out.
TEST(JoinedLight, AreaLightsHaveTheMeanOfStoredVertices) {
    const auto file = testing::scratch_file(".xml");
    std::ofstream(file) << text;
    const int replicates = 16;
    for (const auto& [size, shiny, plate] : {Case{"0.4"}, {"0.1"}, {"0.03"}, {"0.2", "metal", "0.2"}}) {
        const DerivableScene scene(file, {"grow"}, {{"size", size}, {"shiny", shiny}, {"plate", plate}});
        Samples of_vertices(std::size_t{replicates}), joined(std::size_t{replicates});
        tbb::parallel_for(0, replicates, [&](int i) {
            app::Report report;
            report.set_quiet(true);
            const PathGraph graph = trace_derivable(*scene.scene, full_run() ? 16384 : 2048, std::uint64_t(100 + i));
            const derive::BoundaryOptions options{.seed = std::uint64_t(500 + i)};
            derive::BoundaryScene s(graph, *scene.scene, scene.tangents, options);
            // More than by default, so that what is near matters here.
            s.joined_beyond = 0.3 * double(scene.scene->radius);
            std::vector<derive::BoundaryRows> rows[2];
            std::vector<std::uint64_t> samples(n_boundary_families);
            derive::add_vertex_light(s, 1, {derive::reached_by::joined}, rows[0], samples, report);
            derive::add_joined_light(s, 1, {1}, rows[1], samples, report);
            of_vertices[std::size_t(i)] = sums_of(rows[0]), joined[std::size_t(i)] = sums_of(rows[1]);
        });
        const Agreement a = compare_numbers(of_vertices, joined);
        double total[2] = {}, noise[2] = {};
        for (std::size_t f = 0; f < 2; ++f) {
            std::vector<double> sums;
            for (const auto& one : f == 0 ? of_vertices : joined)
                sums.push_back(one[n_bins] + one[2 * n_bins + 1] + one[3 * n_bins + 2] + one[4 * n_bins + 3]);
            const Estimate e = estimate_of(sums);
            total[f] = e.mean, noise[f] = e.se;
        }
        std::printf("    half %-4s %-5s n %2d chi^2 %5.1f p %.2g; vertices %+.4e +- %.1e, joined %+.4e +- %.1e\n", size,
                    shiny, a.n, a.chi2, a.p, total[0], noise[0], total[1], noise[1]);
        EXPECT_GE(a.n, 8) << size;
        EXPECT_GT(a.p, 1e-3) << size;
    }
    std::filesystem::remove(file);
}

}  // namespace
}  // namespace loom
