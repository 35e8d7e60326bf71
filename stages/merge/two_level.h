#pragma once
// An unbiased sum of two levels: cluster estimates have low noise and a bias, path estimates are noisy but unbiased.

#include <cstdint>
#include <functional>

#include "formats/image.h"

namespace loom::merge {

/// Combines cluster estimates B_i and estimates P_i of the same paths alone. It sums all n parts of B and, over the
/// first m parts, the correction:
///   1/n sum_(i < n) B_i + 1/m sum_(i < m) (P_i - B_i)                                       [Giles2008]
/// Its mean is that of P for any B. VarMean is from the spread of the two groups of parts, which are independent:
///   var(P - (1 - m/n) B) / m + (n - m) / n^2 var(B)
/// in:      part   reads part i; called twice for each
/// out:     R, G, B, VarMean; layers that all parts have, without the estimates
/// needs:   check_two_levels, parts of one size with estimates
/// differs: the parts of the second level are among those of the first, which saves passes and reduces the variance
Image two_level_image(std::size_t n_parts, std::size_t n_corrected, const std::function<Image(std::size_t)>& part);

/// throws:  InputError unless both groups are large enough to estimate their variance: 2 <= m, and m = n or m <= n - 2
void check_two_levels(std::size_t n_corrected, std::size_t n_parts);

}  // namespace loom::merge
