// How many samples the static image of an animation should have.
#include "stages/residual/frame_plan.h"

#include <gtest/gtest.h>

#include <cmath>

namespace loom::residual {
namespace {

const FramePilot pilots[] = {{0.4, 0.45, 0.002, 0.04}, {0.02, 0.02, 0.003, 0.13}, {4, 4, 0.1, 0.9}};

double variance(const FramePilot& p, double n, double n_s) {
    return p.still / n_s + p.difference / n;
}
double cost(const FramePilot& p, double n, double n_s, double n_frames, double n_graphs) {
    return n_s + n_graphs * FramePlan::graph * n + n_frames * n * p.cost();
}

// Detected mutations: the graphs' own cost left out; that of one counted where there are two.
TEST(FramePlan, HasTheLeastVarianceTimesCost) {
    for (const FramePilot& pilot : pilots)
        for (const std::uint64_t n_frames : {30u, 240u})
            for (const auto& [n, n_graphs] : {std::pair(8u, 1u), std::pair(32u, 1u), std::pair(8u, 2u)}) {
                const FramePlan plan(pilot, n, n_frames, n_graphs);
                double least = INFINITY;
                std::uint64_t best = 0;
                for (std::uint64_t n_s = 2; n_s <= n * n_frames; ++n_s) {
                    const double product = variance(pilot, double(n), double(n_s)) *
                                           cost(pilot, double(n), double(n_s), double(n_frames), double(n_graphs));
                    if (product < least) least = product, best = n_s;
                }
                EXPECT_NEAR(double(plan.still_spp), double(best), 1) << n_frames << " " << n;
                EXPECT_NEAR(plan.gain, double(n_frames) * pilot.fresh / least, 1e-3 * plan.gain);
            }
}

TEST(FramePlan, BreaksEvenWhereTheGainIsOne) {
    for (const FramePilot& pilot : pilots) {
        const FramePlan plan(pilot, 8, 24);
        if (plan.break_even == 0) {
            EXPECT_LT(FramePlan(pilot, 8, 1'000'000).gain, 1);
            continue;
        }
        EXPECT_GE(FramePlan(pilot, 8, plan.break_even).gain, 1);
        if (plan.break_even > 1) {
            EXPECT_LT(FramePlan(pilot, 8, plan.break_even - 1).gain, 1);
        }
    }
    // All is touched and nothing in common.
    EXPECT_EQ(FramePlan({1, 1, 2, 1}, 8, 24).break_even, 0u);
    EXPECT_LT(FramePlan({1, 1, 2, 1}, 8, 24).gain, 1);
    // Nothing moves: no more than path tracing has.
    EXPECT_EQ(FramePlan({1, 1, 0, 0}, 8, 24).still_spp, 8u * 24);
    EXPECT_EQ(FramePlan({0, 0, 0, 0}, 8, 24).still_spp, 2u);
}

}  // namespace
}  // namespace loom::residual
