#pragma once
// An unbiased sum of two levels: clusters are quiet and biased, their paths are noisy and exact in the mean.

#include <cstdint>
#include <functional>

#include "formats/image.h"

namespace loom::merge {

/// Parts B_i say what clusters know, P_i what the same paths know alone. All n parts and, of the first m, what is
/// between:
///   1/n sum_(i < n) B_i + 1/m sum_(i < m) (P_i - B_i)                                       [Giles2008]
/// The mean of P whatever B is. VarMean from the spread of the two groups of parts, which are independent:
///   var(P - (1 - m/n) B) / m + (n - m) / n^2 var(B)
/// in:      part   reads part i; called twice for each
/// out:     R, G, B, VarMean; layers that all parts have, without the estimates
/// needs:   check_two_levels, parts of one size with estimates
/// differs: the parts of the second level are among those of the first, which costs no pass and takes of its variance
Image two_level_image(std::size_t n_parts, std::size_t n_corrected, const std::function<Image(std::size_t)>& part);

/// throws:  InputError unless both groups are large enough to know their variance: 2 <= m, and m = n or m <= n - 2
void check_two_levels(std::size_t n_corrected, std::size_t n_parts);

}  // namespace loom::merge
