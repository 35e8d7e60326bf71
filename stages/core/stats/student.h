#pragma once
#include <span>

namespace loom {

/// Two-sided p-value of Student's t with `dof` degrees of freedom.
double student_p_value(double t, double dof);

/// t beyond which the two-sided p-value is below alpha.
double student_critical(double alpha, double dof);

/// A mean with the standard error of it; dof: degrees of freedom of that error, infinite when it is known.
struct Estimate {
    double mean = 0, se = 0, dof = 0;
};

/// Mean of replicates and the standard error from their spread.     needs: at least two values
Estimate estimate_of(std::span<const double> replicates);

/// Two-sided p-value of the hypothesis that two means are equal, variances unequal.
///   t = (a - b) / sqrt(se_a^2 + se_b^2), dof by Welch-Satterthwaite                          [Welch1947]
double welch_p_value(const Estimate& a, const Estimate& b);

}  // namespace loom
