// The variance that a pilot promises for a spending of effort, and the spending that makes it least.
#include "stages/residual/effort/effort_model.h"

#include <gtest/gtest.h>

#include "stages/core/sampling/sampler.h"

namespace loom::residual {
namespace {

/// A part of one family alone.
PilotPart own_part(std::size_t family, float value) {
    PilotPart part{};
    part.w[family] = 1;
    part.v[0] = part.v[1] = part.v[2] = value;
    return part;
}

void add_sample(PilotSamples& samples, std::vector<PilotPart> parts, std::vector<std::uint32_t> pixels) {
    samples.end_sample(parts, pixels);
}

/// Random parts of three families, some of whose samples have several parts in one pixel, with either sign.
Pilot random_pilot() {
    Pilot pilot;
    pilot.families.resize(3);
    pilot.cost = {5, 2, 9};
    pilot.camera_scale = 8;
    std::uint64_t n = 0;
    const auto u = [&] { return Sampler(SamplerKind::independent, 3, 0, n++).pair(0).x; };
    for (std::size_t f = 0; f < 3; ++f)
        for (std::uint32_t i = 0; i < 40; ++i) {
            std::vector<PilotPart> parts;
            std::vector<std::uint32_t> pixels;
            for (int k = 0; k < 3; ++k) {
                PilotPart part{};
                for (float& v : part.v) v = u() - 0.4f;
                const float a = u(), b = (1 - a) * u();
                part.w[0] = a;
                part.w[1] = b;
                part.w[2] = 1 - a - b;
                part.at_first = u() < 0.3f;
                parts.push_back(part);
                pixels.push_back(f == 2 ? i / 2 : std::uint32_t(4 * u()));
            }
            pilot.families[f].end_sample(parts, pixels);
        }
    return pilot;
}

// Detected mutations: the derivative of the camera's mean counted twice; the share of a path that is left to camera
// paths counted for other families.
TEST(EffortModel, SlopesAreThoseOfFiniteDifferences) {
    const Pilot pilot = random_pilot();
    for (const bool first_to_camera : {false, true}) {
        const Factors x{0.7, 2.5, 1.3};
        const Objective o = variance_of(pilot, first_to_camera, x);
        EXPECT_GT(o.M, 0);
        double along = 0;
        for (std::size_t k = 0; k < 3; ++k) {
            Factors lower = x, upper = x;
            lower[k] -= 1e-5;
            upper[k] += 1e-5;
            const double slope =
                (variance_of(pilot, first_to_camera, upper).M - variance_of(pilot, first_to_camera, lower).M) / 2e-5;
            EXPECT_NEAR(o.slope[k], slope, 1e-5 * std::abs(o.M)) << k;
            along += x[k] * o.slope[k];
        }
        EXPECT_NEAR(along, -o.M, 1e-9 * o.M) << "homogeneous of degree -1";
    }
}

TEST(EffortModel, PartsOfOneSampleThatCancelInAPixelHaveNoVariance) {
    Pilot pilot;
    pilot.families.resize(2);
    pilot.cost = {1, 1};
    add_sample(pilot.families[0], {own_part(0, 2), own_part(0, -2)}, {7, 7});
    EXPECT_EQ(variance_of(pilot, false, {1, 1}).M, 0);
    add_sample(pilot.families[0], {own_part(0, 2), own_part(0, -2)}, {7, 8});
    EXPECT_DOUBLE_EQ(variance_of(pilot, false, {1, 1}).M, 8);
    EXPECT_DOUBLE_EQ(variance_of(pilot, false, {4, 1}).M, 2);
}

// Camera paths of a pixel vary about their mean: two equal ones do not.
TEST(EffortModel, CameraPathsVaryAboutTheirMean) {
    Pilot pilot;
    pilot.families.resize(1);
    pilot.cost = {1};
    add_sample(pilot.families[0], {own_part(0, 3)}, {5});
    add_sample(pilot.families[0], {own_part(0, 3)}, {5});
    EXPECT_EQ(variance_of(pilot, false, {1}).M, 0);
    add_sample(pilot.families[0], {own_part(0, 3)}, {6});  // and a zero one
    EXPECT_DOUBLE_EQ(variance_of(pilot, false, {1}).M, 2 * 2 * 1.5 * 1.5);
}

// Families that share no path: samples by sqrt(variance / cost), a closed form.
TEST(EffortModel, BestSpendingOfSeparateFamiliesIsNeymans) {
    Pilot pilot;
    pilot.families.resize(3);
    pilot.cost = {1, 4, 1};
    add_sample(pilot.families[0], {own_part(0, 3)}, {0});
    add_sample(pilot.families[1], {own_part(1, 12)}, {1});
    add_sample(pilot.families[2], {own_part(2, 1)}, {2});  // variance 1 of the camera
    const double budget = 300;
    const Spending best = best_spending(pilot, false, budget, 1);
    // V = 9, 144, 1: sqrt(V / C) = 3, 6, 1; sum of C sqrt(V / C) = 28.
    EXPECT_NEAR(best.x[0], budget * 3 / 28, 1);
    EXPECT_NEAR(best.x[1], budget * 6 / 28, 2);
    EXPECT_NEAR(best.x[2], budget * 1 / 28, 1);
    EXPECT_NEAR(best.M, 28 * 28 / budget, 1e-3);
}

// Contributions that camera paths find too are left to them when that costs less.
TEST(EffortModel, AFamilyThatDoesNotPayIsLeftOut) {
    Pilot pilot;
    pilot.families.resize(2);
    pilot.cost = {100, 1};
    PilotPart shared = own_part(0, 1);
    shared.w[0] = shared.w[1] = 0.5f;
    add_sample(pilot.families[0], {shared}, {0});
    add_sample(pilot.families[1], {shared}, {0});
    const Spending best = best_spending(pilot, false, 1000, 1);
    EXPECT_EQ(best.x[0], 0);
    EXPECT_NEAR(best.x[1], 1000, 1e-6);
}

// Families that find all that camera paths find, equally often, predict the variance of camera paths, whichever sampled
// it.
TEST(EffortModel, SiteSamplesSayWhatCameraPathsWouldHave) {
    Pilot pilot;
    pilot.families.resize(2);
    pilot.cost = {1, 1};
    PilotPart shared = own_part(0, 1);
    shared.w[0] = shared.w[1] = 0.5f;  // F = 2 x 0.5 / n0: found twice in the pilot, once by either
    add_sample(pilot.families[0], {shared}, {0});
    add_sample(pilot.families[1], {shared}, {0});
    // Alone each camera path has F / p = v / w = 2, one of them is found: 2^2.
    EXPECT_DOUBLE_EQ(camera_variance_by_all(pilot, 1), 4);
    EXPECT_DOUBLE_EQ(camera_variance_by_all(pilot, 8), 0.5);
}

}  // namespace
}  // namespace loom::residual
