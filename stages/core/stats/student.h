#pragma once
#include <span>

namespace loom {

/// Returns the two-sided p-value of Student's t with `dof` degrees of freedom.
double student_p_value(double t, double dof);

/// Returns the t beyond which the two-sided p-value is below alpha.
double student_critical(double alpha, double dof);

/// A mean with its standard error; dof: degrees of freedom of that error, infinite when it is known exactly.
struct Estimate {
    double mean = 0, se = 0, dof = 0;
};

/// Returns the mean of replicates and the standard error from their spread.     needs: at least two values
Estimate estimate_of(std::span<const double> replicates);

/// Returns the two-sided p-value of the hypothesis that two means with unequal variances are equal.
///   t = (a - b) / sqrt(se_a^2 + se_b^2), dof by Welch-Satterthwaite                          [Welch1947]
double welch_p_value(const Estimate& a, const Estimate& b);

}  // namespace loom
