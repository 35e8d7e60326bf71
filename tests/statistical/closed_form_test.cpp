// Scenes with a closed-form answer, stated in their comments.
#include <fmt/format.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "stages/core/stats/chi_square.h"
#include "tests/statistical/support.h"

namespace loom {
namespace {

constexpr int replicates = 32;
constexpr int n_comparisons = 64;  // in this file, rounded up

struct Known {
    const char* scene;
    Defines defines;
    double answer;      // of every pixel, all channels alike
    std::uint64_t spp;  // per replicate
    bool noisy = true;  // false: every sample is the answer, to rounding
};

void PrintTo(const Known& k, std::ostream* out) {
    *out << k.scene;
}

class ClosedForm : public testing::TestWithParam<Known> {};

// Detected mutations: no cosine in the emitter's density; depth counted from 0; roulette without 1/q; eta^2 left out of
// the roulette by throughput.
TEST_P(ClosedForm, ImageMeanIsTheAnswer) {
    const Known& known = GetParam();
    const auto scene = load_scene(source_dir() / "scenes" / known.scene, known.defines);
    for (const Roulette roulette : {Roulette::albedo, Roulette::throughput, Roulette::off}) {
        if (roulette == Roulette::off && scene->max_depth < 0) continue;
        PathOptions path = options_of(*scene);
        path.roulette = roulette;
        const Replicates r = trace_replicates(*scene, path, known.spp, replicates);
        const Estimate e = r.estimate(1, 0);
        const double alpha = sidak_alpha(n_comparisons);
        if (!known.noisy) {
            EXPECT_NEAR(e.mean, known.answer, 1e-5 * known.answer);
            continue;
        }
        // A furnace can be free of noise too: then rounding is all that may separate it from the answer.
        if (std::abs(e.mean - known.answer) < 2e-5 * known.answer) continue;
        EXPECT_GE(welch_p_value(e, {known.answer, 0, INFINITY}), alpha)
            << fmt::format("{:.7g} +- {:.2g} instead of {:.7g}", e.mean, e.se, known.answer);
        // Power: a bias of 1 % would be detected in nine of ten runs.
        EXPECT_LE((student_critical(alpha, e.dof) + 1.28) * e.se, 0.01 * known.answer);
    }
}

double furnace(double rho, int n) {
    return (1 - std::pow(rho, n)) / (1 - rho);
}

INSTANTIATE_TEST_SUITE_P(
    Scenes, ClosedForm,
    testing::Values(
        Known{"furnace.xml", {}, furnace(0.5, 6), 16},
        Known{"furnace.xml", {{"rho", "0.9"}, {"max_depth", "20"}}, furnace(0.9, 20), 64},
        Known{"furnace-box.xml", {}, furnace(0.5, 6), 16},
        Known{"furnace-box.xml", {{"rho", "0.8"}, {"max_depth", "-1"}}, 5.0, 64},
        Known{"furnace.xml", {{"max_depth", "1"}}, 1.0, 1, false},
        Known{"direct-directional.xml", {}, 0.5 * 5 * 0.8 / pi_double, 4, false},
        Known{"direct-point.xml", {}, 0.5 * 40 * 0.8 / (6.25 * pi_double), 4, false},
        Known{"direct-spot.xml", {}, 0.5 * 40 * 0.8 / (6.25 * pi_double), 4, false},
        Known{"direct-disk.xml", {}, 1.0, 64}, Known{"direct-sphere.xml", {}, 1.0, 64},
        Known{"direct-rectangle.xml", {}, 0.5 * 4 * 4 / pi_double* std::atan(std::sqrt(0.5)) / std::sqrt(2.0), 64},
        Known{"environment-sphere.xml", {}, 1.2, 64}, Known{"slab.xml", {}, 1.5, 16, false},
        Known{"mask.xml", {}, 0.85, 256}),
    [](const auto& info) { return test_name(fmt::format("{} {}", info.param.scene, info.index)); });

TEST(ClosedFormPictures, MirrorCorridorIsBandsOfPowers) {
    const auto scene = load_scene(source_dir() / "scenes" / "mirror-corridor.xml");
    ASSERT_EQ(scene->sensor.width, 16u);
    const Replicates r = trace_replicates(*scene, options_of(*scene), 4, 2);
    const auto green = r.mean.find("G");
    // The outermost reflectance and radiance are taken from the middle of the image: bands are r^k Le.
    const int k[16] = {4, 3, 3, 2, 2, 1, 1, 0, 0, 1, 1, 2, 2, 3, 3, 4};
    const double Le = green[7], reflectance = green[6] / Le;
    EXPECT_GT(reflectance, 0.1);
    EXPECT_LT(reflectance, 0.99);
    for (std::uint32_t y = 0; y < scene->sensor.height; ++y)
        for (int x = 0; x < 16; ++x)
            EXPECT_NEAR(green[y * 16 + x], Le * std::pow(reflectance, k[x]), 1e-4 * Le) << x << ", " << y;
}

TEST(ClosedFormPictures, TextureLiesTheRightWayUp) {
    const auto scene = load_scene(source_dir() / "scenes" / "textured.xml");
    const Replicates r = trace_replicates(*scene, options_of(*scene), 64, 8);
    const std::uint32_t n = scene->sensor.width;
    double Le = 0;
    for (std::uint32_t y = 0; y < n; ++y)
        for (std::uint32_t x = 0; x < n; ++x) {
            const std::uint32_t i = 4 * x / n, j = 3 - 4 * y / n;
            const double expected[3] = {(51 + 51.0 * i) / 255, (51 + 51.0 * j) / 255, 0.4};
            const char* rgb[] = {"R", "G", "B"};
            // Bilinear interpolation and noise blur the values; the centre of each texel is near its own.
            const std::uint32_t inside = n / 4;
            if (inside > 2 &&
                (x % inside == 0 || x % inside == inside - 1 || y % inside == 0 || y % inside == inside - 1))
                continue;
            if (Le == 0) Le = r.mean.find("B")[y * n + x] / 0.4;
            for (int c = 0; c < 3; ++c)
                EXPECT_NEAR(r.mean.find(rgb[c])[y * n + x], expected[c] * Le, 0.1 * Le) << x << ", " << y << ", " << c;
        }
}

}  // namespace
}  // namespace loom
