#include "stages/core/stats/chi_square.h"

#include <gtest/gtest.h>

#include <cmath>
#include <vector>

namespace loom {
namespace {

TEST(ChiSquare, TailAtTabledQuantiles) {
    EXPECT_NEAR(chi_square_tail(3.841459, 1), 0.05, 1e-7);
    EXPECT_NEAR(chi_square_tail(18.307038, 10), 0.05, 1e-7);
    EXPECT_NEAR(chi_square_tail(149.449253, 100), 0.001, 1e-6);
}

TEST(ChiSquare, SidakMakesTheWholeFamilyAsRareAsOne) {
    EXPECT_NEAR(sidak_alpha(1), 0.001, 1e-12);
    EXPECT_NEAR(1 - std::pow(1 - sidak_alpha(1000), 1000), 0.001, 1e-9);
}

TEST(ChiSquare, PoolsScarceCellsAndReportsStrays) {
    const std::vector<double> expected = {0, 2, 2, 2, 4, 40, 50}, observed = {0, 1, 3, 2, 4, 41, 49};
    const ChiSquareResult r = chi_square_test(observed, expected);
    // Pools {2, 2, 2}, {4, 40}, {50}.
    EXPECT_EQ(r.dof, 2);
    EXPECT_NEAR(r.statistic, 0.0 + 1.0 / 44 + 1.0 / 50, 1e-12);
    EXPECT_EQ(r.stray, 0);
    const std::vector<double> strayed = {3, 1, 2, 2, 4, 40, 48};
    EXPECT_EQ(chi_square_test(strayed, expected).stray, 3);
}

TEST(ChiSquare, RejectsAShiftedHistogram) {
    std::vector<double> expected(100, 1000.0), observed(100, 1000.0);
    for (int i = 0; i < 100; ++i) observed[i] += i % 2 ? 100 : -100;
    EXPECT_LT(chi_square_test(observed, expected).p_value, sidak_alpha(1000));
    EXPECT_GT(chi_square_test(expected, expected).p_value, 0.999);
}

}  // namespace
}  // namespace loom
