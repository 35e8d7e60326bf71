#include "stages/core/stats/student.h"

#include <gtest/gtest.h>

#include <cmath>
#include <vector>

namespace loom {
namespace {

// Textbook quantiles. A swapped pair of shape parameters of the beta function misses each by far.
TEST(Student, MatchesTabulatedQuantiles) {
    EXPECT_NEAR(student_critical(0.05, 1), 12.706, 1e-3);
    EXPECT_NEAR(student_critical(0.05, 31), 2.0395, 1e-4);
    EXPECT_NEAR(student_critical(0.001, 10), 4.5869, 1e-4);
    EXPECT_NEAR(student_p_value(1.959964, INFINITY), 0.05, 1e-6);
    EXPECT_NEAR(student_p_value(2.0, 2), 2 * 0.0917517, 1e-6);
}

TEST(Student, WelchDegreesOfFreedom) {
    // Equal errors with n - 1 degrees each add up to 2 (n - 1).
    const Estimate a{1.0, 0.1, 9}, b{1.3, 0.1, 9};
    EXPECT_NEAR(welch_p_value(a, b), student_p_value(0.3 / std::sqrt(0.02), 18), 1e-12);
    // A mean without error gives the one-sample test.
    EXPECT_NEAR(welch_p_value(a, {1.3, 0, INFINITY}), student_p_value(3, 9), 1e-12);
}

TEST(Student, EstimateOfReplicates) {
    const std::vector<double> x{1, 2, 3, 4};
    const Estimate e = estimate_of(x);
    EXPECT_DOUBLE_EQ(e.mean, 2.5);
    EXPECT_NEAR(e.se, std::sqrt(5.0 / 3 / 4), 1e-15);
    EXPECT_EQ(e.dof, 3);
}

}  // namespace
}  // namespace loom
