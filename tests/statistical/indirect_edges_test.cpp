// Edges in front of surfaces (family 3): vertices, points of their outlines and sides of edges in proportion to what they
// may bring, against all of them alike. They must have one mean.
#include <fmt/format.h>
#include <gtest/gtest.h>
#include <tbb/parallel_for.h>

#include <cstdio>

#include "stages/derive/boundary.h"
#include "tests/statistical/derivative_support.h"
#include "tests/statistical/support.h"

namespace loom {
namespace {

struct EdgeScene {
    const char* name;
    std::uint64_t spp;
    double share_of_all;  // of paths whose vertices are all sampled
    std::vector<std::string> wrt;
    std::string text;
};

const std::string sensor =
    R"(<integrator type="path"><integer name="max_depth" value="4"/></integrator>
<sensor type="perspective"><float name="fov" value="45"/><transform name="to_world"><lookat origin="0, -4, 1.5" target="0, 0, 0.8" up="0, 0, 1"/></transform>
<film type="hdrfilm"><integer name="width" value="8"/><integer name="height" value="8"/><rfilter type="box"/></film></sensor>
<bsdf type="twosided" id="grey"><bsdf type="diffuse"><rgb name="reflectance" value="0.7, 0.7, 0.7"/></bsdf></bsdf>
)";

const EdgeScene scenes[] = {
    // A point sees two faces of a box, lit unlike, and nothing behind it: all of the light that edges sweep is that of
    // points which slide over the box.
    {"creases",
     1024,
     0.03,
     {"x", "turn"},
     R"(<scene version="3.0.0"><default name="x" value="0"/><default name="turn" value="40"/>
<integrator type="path"><integer name="max_depth" value="3"/></integrator>
<sensor type="perspective"><float name="fov" value="0.05"/><transform name="to_world"><lookat origin="3, 0, 1" target="0, 0, 0" up="0, 0, 1"/></transform>
<film type="hdrfilm"><integer name="width" value="8"/><integer name="height" value="8"/><rfilter type="box"/></film></sensor>
<bsdf type="diffuse" id="white"><rgb name="reflectance" value="1, 1, 1"/></bsdf>
<shape type="rectangle"><transform name="to_world"><scale value="0.05"/></transform><ref id="white"/></shape>
<shape type="cube"><transform name="to_world"><scale value="0.2"/><rotate y="1" angle="$turn"/><translate x="0.25" y="0.05" z="1"/><translate x="$x"/></transform><ref id="white"/></shape>
<emitter type="directional"><vector name="direction" x="2" y="0.5" z="1"/><rgb name="irradiance" value="1, 1, 1"/></emitter></scene>)"},
    // A board and a ball in a corner; the wall behind them moves, too.
    {"corner",
     384,
     0.5,
     {"board", "ball", "wall"},
     R"(<scene version="3.0.0">
<default name="board" value="0"/><default name="ball" value="0"/><default name="wall" value="1.9"/>)" +
         sensor + R"(
<shape type="rectangle"><transform name="to_world"><scale value="3"/></transform><ref id="grey"/></shape>
<shape type="rectangle"><transform name="to_world"><scale value="2"/><rotate x="1" angle="90"/><translate y="$wall" z="2.1"/></transform><ref id="grey"/></shape>
<shape type="rectangle"><transform name="to_world"><scale x="0.5" y="0.4"/><rotate x="1" angle="70"/><translate x="0.1" y="0.4" z="1.1"/><translate x="$board"/></transform><ref id="grey"/></shape>
<shape type="sphere"><point name="center" x="-0.9" y="0.3" z="0.6"/><float name="radius" value="0.3"/><transform name="to_world"><translate z="$ball"/></transform><ref id="grey"/></shape>
<shape type="rectangle"><transform name="to_world"><scale value="0.3"/><rotate x="1" angle="180"/><translate x="0.2" y="0.1" z="2.6"/></transform>
<bsdf type="diffuse"><rgb name="reflectance" value="0, 0, 0"/></bsdf><emitter type="area"><rgb name="radiance" value="10, 10, 10"/></emitter></shape>
</scene>)"},
    // No straight edge: a ball in front of another.
    {"balls", 512, 0.5, {"x"}, R"(<scene version="3.0.0"><default name="x" value="0"/>)" + sensor + R"(
<shape type="disk"><transform name="to_world"><scale value="2"/></transform><ref id="grey"/></shape>
<shape type="sphere"><point name="center" x="-0.2" y="0.3" z="0.9"/><float name="radius" value="0.3"/><transform name="to_world"><translate x="$x"/></transform><ref id="grey"/></shape>
<shape type="sphere"><point name="center" x="0.4" y="0.6" z="1.8"/><float name="radius" value="0.5"/><ref id="grey"/></shape>
<emitter type="directional"><vector name="direction" x="-1" y="1" z="-0.4"/><rgb name="irradiance" value="3, 3, 3"/></emitter></scene>)"},
};

/// Sums over quadrants of the image, by parameter.
std::vector<double> sums_of(const std::vector<derive::BoundaryRows>& rows, std::size_t n_parameters) {
    std::vector<double> out(4 * n_parameters);
    for (const derive::BoundaryRows& part : rows)
        for (std::size_t i = 0; i < part.pixel.size(); ++i)
            for (std::size_t p = 0; p < n_parameters; ++p)
                out[4 * p + part.pixel[i] / 8 / 4 * 2 + part.pixel[i] % 8 / 4] +=
                    double(part.dL[3 * (i * n_parameters + p)]);
    return out;
}

TEST(IndirectEdges, ImportantOnesHaveTheMeanOfAll) {
    const int replicates = 16;
    for (const EdgeScene& test : scenes) {
        const auto file = testing::scratch_file(".xml");
        std::ofstream(file) << test.text;
        const DerivableScene scene(file, test.wrt);
        Samples all(std::size_t{replicates}), chosen(std::size_t{replicates});
        tbb::parallel_for(0, replicates, [&](int i) {
            app::Report report;
            report.set_quiet(true);
            const PathGraph graph =
                trace_derivable(*scene.scene, (full_run() ? 8 : 1) * test.spp, std::uint64_t(100 + i));
            const derive::BoundaryOptions options{.seed = std::uint64_t(500 + i)};
            derive::BoundaryScene s(graph, *scene.scene, scene.tangents, options);
            std::vector<derive::BoundaryRows> rows[2];
            std::vector<std::uint64_t> samples(n_boundary_families);
            derive::add_indirect(s, 1, derive::indirect_units(s, true, true), true, true, rows[0], samples, report);
            s.always_passes_from = 0;
            derive::add_indirect(s, test.share_of_all, {}, true, true, rows[1], samples, report);
            chosen[std::size_t(i)] = sums_of(rows[0], test.wrt.size());
            all[std::size_t(i)] = sums_of(rows[1], test.wrt.size());
        });
        const Agreement a = compare_numbers(chosen, all);
        std::printf("    %s: n %d, chi^2 %.1f, p %.2g\n", test.name, a.n, a.chi2, a.p);
        for (std::size_t p = 0; p < test.wrt.size(); ++p) {
            Estimate e[2];
            for (std::size_t k = 0; k < 2; ++k) {
                std::vector<double> sums;
                for (const auto& one : k == 0 ? chosen : all)
                    sums.push_back(one[4 * p] + one[4 * p + 1] + one[4 * p + 2] + one[4 * p + 3]);
                e[k] = estimate_of(sums);
            }
            std::printf("      %-6s %+.4e +- %.1e, of all %+.4e +- %.1e\n", test.wrt[p].c_str(), e[0].mean, e[0].se,
                        e[1].mean, e[1].se);
        }
        EXPECT_GE(a.n, 4 * int(test.wrt.size())) << test.name;
        EXPECT_GT(a.p, 1e-3) << test.name;
        std::filesystem::remove(file);
    }
}

}  // namespace
}  // namespace loom
