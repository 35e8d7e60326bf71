// hide_emitters as in Mitsuba 3.8: camera rays pass through area lights, and the sky is black to them until they
// scatter; a mask, a null surface and straight transmission through a thin pane do not count. Lit surfaces stay lit.
// Detected mutations: all but the lit wall with hide_emitters unread; the area lights with camera_rays = rays.

#include <fmt/format.h>
#include <gtest/gtest.h>

#include "stages/core/scattering/fresnel.h"
#include "stages/core/tracing/path_tracer.h"
#include "tests/traced_graph.h"

namespace loom::testing {
namespace {

constexpr const char* sky = "<emitter type='constant'><rgb name='radiance' value='0.5'/></emitter>";
constexpr const char* light =
    "<shape type='rectangle'><transform name='to_world'><translate z='1'/></transform>"
    "<emitter type='area'><rgb name='radiance' value='2'/></emitter></shape>";
constexpr const char* wall =
    "<shape type='rectangle'><transform name='to_world'><scale value='50'/><translate z='-1'/></transform>"
    "<bsdf type='diffuse'><rgb name='reflectance' value='0.6'/></bsdf></shape>";

std::string pane(const char* bsdf) {
    return fmt::format("<shape type='rectangle'><transform name='to_world'><translate z='2'/></transform>{}</shape>",
                       bsdf);
}

std::unique_ptr<Scene> scene_of(const std::string& body, bool hides, const char* version = "3.0.0") {
    const auto file = scratch_file(".xml");
    const bool legacy = version[0] == '0';
    std::ofstream(file) << fmt::format(
        R"(<scene version="{}"><integrator type="path"><boolean name="{}" value="{}"/></integrator>
<sensor type="perspective"><float name="fov" value="4"/><transform name="{}"><lookat origin="0,0,5" target="0,0,0" up="0,1,0"/></transform>
<film type="hdrfilm"><integer name="width" value="4"/><integer name="height" value="4"/><rfilter type="box"/></film></sensor>
{}</scene>)",
        version, legacy ? "hideEmitters" : "hide_emitters", hides, legacy ? "toWorld" : "to_world", body);
    auto scene = load_scene(file);
    std::filesystem::remove(file);
    return scene;
}

struct Mean {
    double L = 0, depth = 0;
};

/// Means over all pixels: red, and the distance of the camera's first hit.
Mean mean(const Scene& scene, std::uint64_t spp, int max_depth = -1) {
    PathOptions options = path_options(scene, 1, SamplerKind::sobol);
    options.max_depth = max_depth;
    PathBatch batch(scene, options);
    std::vector<PathId> ids;
    for (std::uint64_t sample = 0; sample < spp; ++sample)
        for (std::uint64_t pixel = 0; pixel < scene.sensor.n_pixels(); ++pixel) ids.push_back({pixel, sample});
    Mean sum;
    std::vector<PathResult> results(PathBatch::capacity);
    for (std::size_t begin = 0; begin < ids.size(); begin += PathBatch::capacity) {
        const std::size_t n = std::min(PathBatch::capacity, ids.size() - begin);
        batch.trace({&ids[begin], n}, {results.data(), n});
        for (std::size_t i = 0; i < n; ++i) {
            sum.L += results[i].L.r / double(ids.size());
            sum.depth += results[i].first.depth / double(ids.size());
        }
    }
    return sum;
}

TEST(HiddenEmitters, SkyIsBlackToTheCameraInBothDialects) {
    EXPECT_FLOAT_EQ(float(mean(*scene_of(sky, false), 1).L), 0.5f);
    EXPECT_EQ(mean(*scene_of(sky, true), 1).L, 0);
    EXPECT_EQ(mean(*scene_of(sky, true, "0.6.0"), 1).L, 0);
}

TEST(HiddenEmitters, WhatTheSkyLightsStaysLit) {
    EXPECT_NEAR(mean(*scene_of(std::string(sky) + wall, true), 64).L, 0.6 * 0.5, 1e-3);
}

TEST(HiddenEmitters, CameraRaysPassThroughAreaLights) {
    const std::string lit = std::string(light) + wall;
    EXPECT_NEAR(mean(*scene_of(lit, false), 16).depth, 4, 0.01);
    EXPECT_EQ(mean(*scene_of(lit, false), 16, 1).L, 2);
    // The wall behind; of the light only its illumination there, which is zero, because its back is black.
    EXPECT_NEAR(mean(*scene_of(lit, true), 16).depth, 6, 0.01);
    EXPECT_EQ(mean(*scene_of(lit, true), 16, 1).L, 0);
    EXPECT_EQ(mean(*scene_of(std::string(light) + sky, true), 16).L, 0);
    // The sky that the light does not take from the wall: Mitsuba 3.8 gives the same for a wall of this size, 0.2258
    // (0.002) with its camera at a field of view of 10 degrees and a wall of 6 m.
    const double shaded = mean(*scene_of(std::string(sky) + lit, true), 256).L;
    EXPECT_LT(shaded, 0.26);
    EXPECT_GT(shaded, 0.20);
}

TEST(HiddenEmitters, StraightWaysDoNotUncoverTheSky) {
    EXPECT_EQ(mean(*scene_of(sky + pane("<bsdf type='null'/>"), true), 4).L, 0);
    EXPECT_EQ(
        mean(*scene_of(sky + pane("<bsdf type='mask'><float name='opacity' value='0'/><bsdf type='diffuse'/></bsdf>"),
                       true),
             4)
            .L,
        0);
    // A thin pane leaves its reflection alone.
    const double R = fresnel_dielectric(1.0f, 1.5046f / 1.000277f).reflectance, both = 2 * R / (1 + R);
    EXPECT_NEAR(mean(*scene_of(sky + pane("<bsdf type='thindielectric'/>"), true), 1024).L, 0.5 * both, 0.002);
}

TEST(HiddenEmitters, GraphHasNeitherTheSkyNorTheLight) {
    const auto scene = scene_of(std::string(sky) + light + pane("<bsdf type='null'/>") + wall, true);
    const PathGraph graph = trace_graph(*scene, path_options(*scene, 1), 16);
    for (std::size_t i = 0; i < graph.n_paths(); ++i) {
        EXPECT_TRUE(is_black(rgb(graph.paths.Le, i)));
        const std::size_t first = graph.paths.first_vertex[i];
        ASSERT_LT(first, graph.paths.first_vertex[i + 1]);
        EXPECT_EQ(graph.vertices.shape[first], 1u) << "the pane";
    }
    // Behind the pane the light is there.
    EXPECT_EQ(graph.n_light_edges(), graph.n_paths());
    const auto open = scene_of(std::string(sky) + pane("<bsdf type='null'/>"), true);
    EXPECT_EQ(trace_graph(*open, path_options(*open, 1), 4).n_light_edges(), 0u);
}

}  // namespace
}  // namespace loom::testing
