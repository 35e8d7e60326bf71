#pragma once

namespace loom {

/// Returns the regularised upper incomplete gamma function Q(a, x), the tail of a gamma distribution.
///   Q(a, x) = 1/Γ(a) ∫_x^∞ t^(a-1) e^-t dt                           [NumericalRecipes] §6.2
/// needs:   a > 0, x >= 0; NaN for a NaN
double regularized_gamma_q(double a, double x);

/// Returns the regularised incomplete beta function I_x(a, b).
/// needs:   a, b > 0, 0 <= x <= 1; NaN for a NaN
double incomplete_beta(double a, double b, double x);

}  // namespace loom
