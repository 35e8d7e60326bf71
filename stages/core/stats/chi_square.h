#pragma once
// Tests goodness of fit: whether a histogram of samples follows the density that should describe them. Shared by the
// tests of every sample/pdf pair.

#include <span>

namespace loom {

/// Probability that a χ² variable with `dof` degrees of freedom exceeds `statistic`.
double chi_square_tail(double statistic, int dof);

/// Returns the significance level per comparison at which `n_comparisons` independent comparisons together raise a
/// false alarm with probability 1 - confidence.
///   α = 1 - confidence^(1/m)                                         [Sidak1967]
double sidak_alpha(int n_comparisons, double confidence = 0.999);

struct ChiSquareResult {
    double statistic = 0;
    int dof = 0;         // degrees of freedom, of the pooled cells
    double p_value = 1;  // small: the samples do not follow the expectation
    double stray = 0;    // samples in cells whose expected count is zero
};

/// Pearson's χ² of counts against expected counts. Cells are pooled in order of their expectation until each pool
/// expects at least `min_expected`.
///   χ² = Σ (observed - expected)² / expected
/// in:      observed  double[n]  1  counts; expected the same, with the same total
/// needs:   equal sizes, every expected >= 0
/// differs: a cell that expects less than 1e-9 of a sample is not pooled; its samples count as `stray`
ChiSquareResult chi_square_test(std::span<const double> observed, std::span<const double> expected,
                                double min_expected = 5);

}  // namespace loom
