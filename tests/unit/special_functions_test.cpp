#include "stages/core/stats/special_functions.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <numbers>

namespace loom {
namespace {

void expect_close(double value, double known) {
    EXPECT_NEAR(value, known, 1e-12 * known) << known;
}

TEST(SpecialFunctions, IncompleteGammaAtClosedForms) {
    for (const double x : {0.01, 0.5, 1.0, 3.0, 20.0, 200.0}) {
        expect_close(regularized_gamma_q(0.5, x), std::erfc(std::sqrt(x)));
        expect_close(regularized_gamma_q(1, x), std::exp(-x));
        expect_close(regularized_gamma_q(2, x), (1 + x) * std::exp(-x));
    }
    EXPECT_NEAR(regularized_gamma_q(500, 500), 0.494053, 2e-6);  // near 1/2 at the mean
}

TEST(SpecialFunctions, IncompleteBetaAtClosedForms) {
    expect_close(incomplete_beta(1, 3, 0.2), 1 - std::pow(0.8, 3));
    expect_close(incomplete_beta(2, 1, 0.9), 0.81);
    expect_close(incomplete_beta(2.5, 2.5, 0.5), 0.5);
    for (const double x : {1e-300, 1e-9, 0.1, 0.5, 0.999})
        expect_close(incomplete_beta(0.5, 0.5, x), 2 / std::numbers::pi * std::asin(std::sqrt(x)));
}

// Statistics of constant or broken images come here too, and must not end a stage.
TEST(SpecialFunctions, LimitsInPlaceOfExceptions) {
    const double infinity = std::numeric_limits<double>::infinity(), nan = std::numeric_limits<double>::quiet_NaN();
    EXPECT_EQ(regularized_gamma_q(3, 0), 1);
    EXPECT_EQ(regularized_gamma_q(3, 1e6), 0);
    EXPECT_EQ(regularized_gamma_q(3, infinity), 0);
    EXPECT_TRUE(std::isnan(regularized_gamma_q(3, nan)));
    EXPECT_EQ(incomplete_beta(3, 0.5, 0), 0);
    EXPECT_EQ(incomplete_beta(3, 0.5, 1), 1);
    EXPECT_EQ(incomplete_beta(3, 0.5, 1e-300), 0);
    EXPECT_TRUE(std::isnan(incomplete_beta(3, 0.5, nan)));
    EXPECT_TRUE(std::isnan(incomplete_beta(nan, 0.5, 0.5)));
}

}  // namespace
}  // namespace loom
