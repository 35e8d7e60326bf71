// Derivatives where surfaces cut each other, against central differences of our own traced graphs.
#include <fmt/format.h>
#include <gtest/gtest.h>
#include <tbb/parallel_for.h>

#include <cstdio>
#include <fstream>

#include "tests/statistical/derivative_support.h"
#include "tests/statistical/support.h"

namespace loom {
namespace {

constexpr std::size_t res = 8, n_bins = 8, n_quadrants = 4;

/// A bright, tilted box sunk into a dark floor that cuts through a wall, too, and an area light in front of it. A screen
/// behind the light may receive what these reflect.
constexpr const char* sunk_text = R"(<scene version="3.0.0">
<default name="box_y" value="0"/><default name="box_z" value="0"/><default name="floor_z" value="0"/><default name="camera_x" value="0"/>
<default name="camera_y" value="0"/><default name="depth" value="2"/><default name="origin" value="0.4, -1.9, 0.9"/><default name="target" value="0, 0.1, 0.1"/>
<default name="fov" value="45"/><default name="screen_y" value="-9"/><default name="glow" value="0"/><default name="light" value="15"/>
<integrator type="path"><integer name="max_depth" value="$depth"/></integrator>
<sensor type="perspective"><float name="fov" value="$fov"/><transform name="to_world"><lookat origin="$origin" target="$target" up="0, 0, 1"/>
<translate x="$camera_x" y="$camera_y"/></transform><film type="hdrfilm"><integer name="width" value="8"/><integer name="height" value="8"/><rfilter type="box"/></film></sensor>
<bsdf type="twosided" id="dark"><bsdf type="diffuse"><rgb name="reflectance" value="0.02, 0.02, 0.02"/></bsdf></bsdf>
<bsdf type="twosided" id="bright"><bsdf type="diffuse"><rgb name="reflectance" value="0.9, 0.9, 0.9"/></bsdf></bsdf>
<bsdf type="twosided" id="grey"><bsdf type="diffuse"><rgb name="reflectance" value="0.5, 0.5, 0.5"/></bsdf></bsdf>
<shape type="rectangle" id="floor"><transform name="to_world"><scale value="2"/><translate z="$floor_z"/></transform><ref id="dark"/></shape>
<shape type="rectangle" id="wall"><transform name="to_world"><scale value="1.9"/><rotate x="1" angle="90"/><translate y="1.3" z="1.2"/></transform><ref id="grey"/></shape>
<shape type="rectangle" id="screen"><transform name="to_world"><scale value="0.9"/><rotate x="1" angle="-90"/><translate y="$screen_y" z="2.2"/></transform><ref id="bright"/></shape>
<shape type="cube" id="box"><transform name="to_world"><scale x="0.6" y="0.4" z="0.45"/><rotate z="1" angle="15"/><rotate x="1" angle="-30"/>
<translate y="0.1" z="0.05"/><translate y="$box_y" z="$box_z"/></transform><ref id="bright"/><emitter type="area"><rgb name="radiance" value="$glow, $glow, $glow"/></emitter></shape>
<shape type="rectangle" id="light"><transform name="to_world"><scale value="0.25"/><lookat origin="0, -1.4, 1.6" target="0, 0, 0" up="0, 0, 1"/></transform>
<bsdf type="diffuse"><rgb name="reflectance" value="0, 0, 0"/></bsdf><emitter type="area"><rgb name="radiance" value="$light, $light, $light"/></emitter></shape>
</scene>)";

std::vector<double> quadrants(const std::vector<double>& bins) {
    std::vector<double> out(n_quadrants * n_bins);
    for (std::size_t p = 0; p < res * res; ++p) {
        const std::size_t q = p / res / (res / 2) * 2 + p % res / (res / 2);
        for (std::size_t k = 0; k < n_bins; ++k)
            out[q * n_bins + k] += bins[3 * (p * n_bins + k)] / double(res * res / n_quadrants);
    }
    return out;
}

struct Case {
    const char *name, *variable;
    int depth;
    derive::Attachment attachment;
    bool always = false;  // not in the full run alone
    Defines defines = {};
};

constexpr double step = 0.1;
constexpr auto automatic = derive::Attachment::automatic, surface = derive::Attachment::surface,
               ray = derive::Attachment::ray;
/// Looks at the screen alone, which receives light of the box and of the floor but none of the emitter.
const Defines at_screen{{"origin", "0, 0.5, 1.7"}, {"target", "0, -1.9, 2.3"}, {"screen_y", "-1.9"}};
/// The box is the emitter.
const Defines glowing{
    {"origin", "0, 0.5, 1.7"}, {"target", "0, -1.9, 2.3"}, {"screen_y", "-1.9"}, {"glow", "3"}, {"light", "0"}};
/// The box is the emitter, and the floor beside it is seen.
const Defines glowing_floor{{"glow", "3"}, {"light", "0"}, {"origin", "-1.5, -1.8, 1.3"}, {"target", "-1.1, -0.4, 0"}};
// Detected mutation: seams left out; p is below 1e-20 where the camera sees them, and by the screen below 1e-12 in each
// case but that of `ray`.
const Case cases[] = {
    {"box_y", "box_y", 2, automatic},
    {"box_z", "box_z", 2, automatic, true},
    {"floor", "floor_z", 2, automatic},
    {"camera", "camera_y", 2, automatic, true},
    {"box_y_deep", "box_y", 4, automatic},
    {"box_z_deep", "box_z", 4, automatic},
    {"box_z_deep_surface", "box_z", 4, surface},
    {"floor_deep", "floor_z", 4, automatic, true},
    {"camera_deep", "camera_y", 4, automatic},
    {"screen_box_z", "box_z", 3, automatic, false, at_screen},
    {"screen_box_z_surface", "box_z", 3, surface, true, at_screen},
    {"screen_box_z_ray", "box_z", 3, ray, false, at_screen},
    {"screen_floor", "floor_z", 3, automatic, true, at_screen},
    {"screen_glow_box_z", "box_z", 3, surface, false, glowing},
    {"screen_glow_floor", "floor_z", 3, automatic, true, glowing},
    {"floor_of_glow", "box_z", 2, automatic, true, glowing_floor},
};

class DerivativeOfSeams : public ::testing::TestWithParam<Case> {};

TEST_P(DerivativeOfSeams, BinsAgree) {
    const Case& c = GetParam();
    if (!c.always && !full_run()) GTEST_SKIP() << "in the full run";
    const auto file = testing::scratch_file(".xml");
    std::ofstream(file) << sunk_text;
    TimeResponse response;
    response.n_bins = n_bins, response.start = 2, response.width = response.gate = 1.2;
    response.pulse = Pulse::box(1.2);
    const auto at = [&](double value) {
        Defines d = c.defines;
        d.emplace_back(c.variable, fmt::format("{:.10g}", value));
        d.emplace_back("depth", std::to_string(c.depth));
        return d;
    };
    const int replicates = 16;
    const std::uint64_t spp = full_run() ? 1024 : 128;
    const auto below = load_scene(file, at(-step)), above = load_scene(file, at(step));
    Samples ours(replicates), theirs(replicates);
    tbb::parallel_for(0, replicates, [&](int i) {
        const auto k = std::size_t(i);
        const DerivableScene here(file, {c.variable}, at(step * place_in(i, replicates)));
        const PathGraph graph = trace_derivable(*here.scene, spp, std::uint64_t(100 + i));
        const Derivative derivative = differentiate(graph, here, std::uint64_t(500 + i), {}, c.attachment);
        ours[k] = quadrants(bins_of(graph, &derivative, response).derivative);
        const auto bins = [&](const Scene& scene) {
            const PathGraph g = trace_derivable(scene, spp, std::uint64_t(1000 + i));
            return quadrants(bins_of(g, nullptr, response).value);
        };
        const std::vector<double> low = bins(*below), high = bins(*above);
        for (std::size_t j = 0; j < low.size(); ++j) theirs[k].push_back((high[j] - low[j]) / (2 * step));
    });
    std::filesystem::remove(file);
    const Agreement all = compare_numbers(ours, theirs);
    std::printf("    %-24s n %3d chi^2 %7.1f p %.2g\n", c.name, all.n, all.chi2, all.p);
    EXPECT_GT(all.p, 1e-3) << c.name;
}

INSTANTIATE_TEST_SUITE_P(Sunk, DerivativeOfSeams, ::testing::ValuesIn(cases),
                         [](const auto& one) { return std::string(one.param.name); });

}  // namespace
}  // namespace loom
