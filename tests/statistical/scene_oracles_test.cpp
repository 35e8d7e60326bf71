// The shared scenes, both dialects, against references by Mitsuba 3: image mean and tiles by Welch tests.
#include <fmt/format.h>
#include <gtest/gtest.h>

#include <cmath>

#include "tests/statistical/support.h"

namespace loom {
namespace {

struct SharedScene {
    const char* name;  // folder
    const char* file;
    const char* reference;
    int width, height;
    // Relative bound on the image means, where the published 0.x file is not the scene of the reference: then
    // nothing else is judged. 0: means and tiles by their standard errors.
    double means_within = 0;
    bool swapped_checkerboard = false;  // the two published files have its colours swapped
};

/// Means and standard errors of the regions of a reference, from its image and its variance of the mean.
void reference_regions(const Image& mean, const Image& var_mean, RegionMeans& means, RegionMeans& se) {
    means = region_means(mean);
    se = region_means(var_mean);
    for (auto& channel : se)
        for (std::size_t region = 0; region < channel.size(); ++region) {
            // Of n pixels with mean variance v the mean has variance v / n.
            const double n = double(mean.n_pixels()) / (region == 0 ? 1 : n_tiles * n_tiles);
            channel[region] = std::sqrt(std::max(channel[region], 0.0) / n);
        }
}

class SceneOracle : public testing::TestWithParam<SharedScene> {};

TEST_P(SceneOracle, ImageMeanAndTilesAgree) {
    const auto shared = shared_dir();
    if (shared.empty()) GTEST_SKIP() << "the folder of references (../shared/oracles) is not there";
    const SharedScene& s = GetParam();
    const auto file = shared / "scenes" / s.name / s.file;
    Defines defines;
    if (std::string(s.file).find("_v3") != std::string::npos)
        defines = {{"resx", std::to_string(s.width)}, {"resy", std::to_string(s.height)}};
    auto scene = load_scene(file, defines);
    // Files of the 0.x dialect have no parameters for the size.
    scene->sensor.width = std::uint32_t(s.width);
    scene->sensor.height = std::uint32_t(s.height);
    scene->sensor.prepare();
    if (s.swapped_checkerboard)
        for (Texture& texture : scene->textures) std::swap(texture.color0, texture.color1);
    const Image mean = read_image(shared / "oracles" / "scenes" / (std::string(s.reference) + "_ref.exr"));
    const Image var = read_image(shared / "oracles" / "scenes" / (std::string(s.reference) + "_var.exr"));
    RegionMeans means, se;
    reference_regions(mean, var, means, se);

    constexpr int replicates = 32;
    const std::uint64_t spp = full_run() ? 32 : 2;
    const Replicates ours = trace_replicates(*scene, options_of(*scene), spp, replicates);
    for (int c = 0; c < 3; ++c) {
        const Estimate e = ours.estimate(c, 0);
        std::printf("    channel %d: %.6g +- %.2g, reference %.6g +- %.2g, %+.3f %%\n", c, e.mean, e.se, means[c][0],
                    se[c][0], 100 * (e.mean / means[c][0] - 1));
        if (s.means_within > 0) {
            EXPECT_NEAR(e.mean / means[c][0], 1, s.means_within);
        }
    }
    if (s.means_within > 0) return;
    // 21 files, 3 channels, 65 regions.
    const std::string failures = judge_regions(
        ours, means, se, 21 * 3 * 65, fmt::format("{}-{}", s.name, std::filesystem::path(s.file).stem().string()));
    EXPECT_TRUE(failures.empty()) << failures;
}

INSTANTIATE_TEST_SUITE_P(
    Mitsuba, SceneOracle,
    testing::Values(SharedScene{"cbox-caustics", "scene_v3.xml", "cbox-caustics", 256, 256},
                    SharedScene{"cbox-caustics", "scene.xml", "cbox-caustics", 256, 256},
                    SharedScene{"cbox-caustics", "scene_area_v3.xml", "cbox-caustics_area", 256, 256},
                    SharedScene{"classroom", "scene_v3.xml", "classroom", 256, 144},
                    // Sky and sun are baked by us, those of the reference by Mitsuba 0.6.
                    SharedScene{"classroom", "scene.xml", "classroom", 256, 144, 0.03},
                    SharedScene{"cornell-box", "scene_v3.xml", "cornell-box", 256, 256},
                    SharedScene{"cornell-box", "scene_glossy_v3.xml", "cornell-box_glossy", 256, 256},
                    SharedScene{"dining-room", "scene_v3.xml", "dining-room", 256, 144},
                    SharedScene{"dining-room", "scene.xml", "dining-room", 256, 144, 0.03},
                    SharedScene{"living-room-2", "scene_v3.xml", "living-room-2", 256, 144},
                    SharedScene{"living-room-2", "scene.xml", "living-room-2", 256, 144},
                    SharedScene{"sponza", "scene_v3.xml", "sponza", 256, 144},
                    // phong instead of diffuse, and maxSmoothAngle.
                    SharedScene{"sponza", "scene.xml", "sponza", 256, 144, 0.15},
                    SharedScene{"staircase", "scene_v3.xml", "staircase", 144, 256},
                    SharedScene{"staircase", "scene.xml", "staircase", 144, 256},
                    SharedScene{"teapot", "scene_v3.xml", "teapot", 256, 144},
                    SharedScene{"teapot", "scene.xml", "teapot", 256, 144, 0, true},
                    SharedScene{"veach-ajar", "scene_v3.xml", "veach-ajar", 256, 144}),
    [](const auto& info) { return test_name(fmt::format("{} {}", info.param.name, info.param.file)); });

}  // namespace
}  // namespace loom
