// The 14 public render references of Mitsuba 3. Detected mutations: cosine of the emitter dropped from its density
// (image mean off by 30 %), texture v not flipped (tiles), pdf of the environment without sin theta.
#include <fmt/format.h>
#include <gtest/gtest.h>

#include <cmath>

#include "tests/statistical/support.h"

namespace loom {
namespace {

struct Reference {
    const char* folder;
    const char* scene;
    const char* image;
};

// The variances of the references were measured in XYZ.
constexpr double xyz_from_rgb[3][3] = {
    {0.412453, 0.357580, 0.180423}, {0.212671, 0.715160, 0.072169}, {0.019334, 0.119193, 0.950227}};

std::vector<double> to_xyz(const Image& image) {
    const auto rgb = image.interleaved("");
    std::vector<double> xyz(rgb.size());
    for (std::size_t i = 0; i < rgb.size(); i += 3)
        for (int c = 0; c < 3; ++c)
            for (int k = 0; k < 3; ++k) xyz[i + c] += xyz_from_rgb[c][k] * rgb[i + k];
    return xyz;
}

class RenderOracle : public testing::TestWithParam<Reference> {};

TEST_P(RenderOracle, PixelsImageMeanAndTilesAgree) {
    const auto shared = shared_dir();
    if (shared.empty()) GTEST_SKIP() << "the folder of references (../shared/oracles) is not there";
    const auto folder = shared / "oracles" / "render" / GetParam().folder;
    const auto scene = load_scene(folder / (std::string(GetParam().scene) + ".xml"));
    const Image reference = read_image(folder / "refs" / (std::string(GetParam().image) + "_ref_rgb.exr"));
    const Image variance = read_image(folder / "refs" / (std::string(GetParam().image) + "_ref_rgb_var.exr"));
    const std::size_t n = scene->sensor.n_pixels();
    ASSERT_EQ(reference.n_pixels(), n);
    const std::uint64_t spp = 2'000'000 / n;

    app::Report report;
    report.set_quiet(true);
    PathOptions path = options_of(*scene);
    // The test is about samples as independent as those that the variance was measured on.
    path.sampler = SamplerKind::independent;
    trace::Counts counts;
    const Image ours = trace::render_image(*scene, path, {0, spp, 0}, report, counts);
    EXPECT_EQ(counts.nonfinite, 0u);

    const auto x = to_xyz(ours), mu = to_xyz(reference), v = to_xyz(variance);
    const double alpha = 1 - std::pow(0.99, 1.0 / double(n));
    std::size_t passed = 0;
    std::array<std::array<double, 3>, 65> difference{}, variance_of{}, level{};
    for (std::size_t pixel = 0; pixel < n; ++pixel) {
        const std::size_t px = pixel % ours.width, py = pixel / ours.width;
        const std::size_t tile = 1 + py * 8 / ours.height * 8 + px * 8 / ours.width;
        for (int c = 0; c < 3; ++c) {
            const std::size_t i = 3 * pixel + c;
            const double per_mean = std::max(v[i], 1e-4) / double(spp);
            const double z = std::abs(x[i] - mu[i]) / std::sqrt(per_mean);
            passed += std::erfc(z / std::sqrt(2.0)) > alpha;
            for (std::size_t region : {std::size_t(0), tile}) {
                difference[region][c] += x[i] - mu[i];
                variance_of[region][c] += std::max(v[i], 0.0) / double(spp);
                level[region][c] += mu[i];
            }
        }
    }
    const double share = double(passed) / double(3 * n);
    EXPECT_GE(share, 0.9975);
    // Both means have errors; the reference's is not published, so it is taken as equal to ours.
    double worst_tile = 0;
    for (std::size_t region = 0; region < 65; ++region)
        for (int c = 0; c < 3; ++c) {
            const double se = std::sqrt(2 * variance_of[region][c]), off = std::abs(difference[region][c]);
            const double relative = level[region][c] > 0 ? off / level[region][c] : 0;
            if (region > 0) worst_tile = std::max(worst_tile, se > 0 ? off / se : 0);
            EXPECT_TRUE(off <= 5 * se || relative <= 0.002)
                << (region == 0 ? std::string("image mean")
                                : fmt::format("tile ({}, {})", (region - 1) % 8, (region - 1) / 8))
                << " channel " << c << ": off by " << 100 * relative << " %, " << off / se << " standard errors";
        }
    RecordProperty("share_of_pixels", std::to_string(share));
    std::printf("    pixels that pass %.5f; image mean off by %+.4f %% %+.4f %% %+.4f %%; largest tile %.1f SE\n",
                share, 100 * difference[0][0] / level[0][0], 100 * difference[0][1] / level[0][1],
                100 * difference[0][2] / level[0][2], worst_tile);
    if (HasFailure()) {
        const auto out = source_dir() / "out" / "test-failures";
        std::filesystem::create_directories(out);
        write_image(ours, out / (std::string(GetParam().image) + ".exr"));
        write_png(ours, out / (std::string(GetParam().image) + ".png"));
        write_png(reference, out / (std::string(GetParam().image) + "-reference.png"));
    }
}

INSTANTIATE_TEST_SUITE_P(
    Mitsuba, RenderOracle,
    testing::Values(Reference{"bsdf_spheres", "test_arealight_path", "test_arealight"},
                    Reference{"bsdf_spheres", "test_bumpmap_path", "test_bumpmap"},
                    Reference{"bsdf_spheres", "test_constant_path", "test_constant"},
                    Reference{"bsdf_spheres", "test_envmap_path", "test_envmap"},
                    Reference{"bsdf_spheres", "test_normalmap_path", "test_normalmap"},
                    Reference{"bsdf_spheres", "test_pointlight_path", "test_pointlight"},
                    Reference{"bsdf_spheres", "test_roughdielectric_path", "test_roughdielectric"},
                    Reference{"bsdf_spheres", "test_roughplastic_nonlinear_path", "test_roughplastic_nonlinear"},
                    Reference{"bsdf_spheres", "test_textured_diffuse_path", "test_textured_diffuse"},
                    Reference{"floating_sphere", "test_directional_direct", "test_directional"},
                    Reference{"infinite_mirrors", "scene_path", "scene"},
                    Reference{"orthographic_sensor", "test_orthographic_path", "test_orthographic"},
                    Reference{"spot_light", "test_spot_direct", "test_spot"},
                    Reference{"texture_interp", "test_texture_interp_direct", "test_texture_interp"}),
    [](const auto& info) { return std::string(info.param.scene); });

}  // namespace
}  // namespace loom
