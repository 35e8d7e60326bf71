#pragma once
// How many pairs of paths each pixel gets, by a map that the pixel itself has no part in.

#include <cstdint>
#include <vector>

#include "stages/core/scene/sensor.h"

namespace loom::residual {

/// Numbers of pairs by pixel.
struct PairCounts {
    std::vector<double> expected;      // before rounding
    std::vector<std::uint32_t> pairs;  // rounded at random: its mean is `expected`

    std::uint64_t all() const;
};

/// Rounds numbers of pairs at random, so that the mean of each is its number, and their sum that of all to one pair.
///   n_i = floor(S_i + u) - floor(S_(i-1) + u),  S_i the sum up to pixel i,  u uniform           [HY] Eq. (8)
/// Pixels come tile by tile, 4 x 4 each, in an order of its own in each tile: numbers below 1 are spread evenly, without a
/// pattern.
/// in:      expected  [pixel] not negative, finite
std::vector<std::uint32_t> dithered(const Sensor& sensor, const std::vector<double>& expected, std::uint64_t seed);

/// Returns numbers of pairs in proportion to the deviation of a pair:
///   s_p = mean (N - 1) D_p / sum of d_q over q != p,  d = sqrt(variance), D_p its mean around p    [HY] Eq. (7)
/// Neither D_p nor the sum has the pixel itself in it, so that its number is independent of its own samples.
/// in:      variances  [pixel] of one pair
///          mean       pairs per pixel, about
PairCounts pairs_by_deviation(const Sensor& sensor, const std::vector<double>& variances, double mean,
                              std::uint64_t seed);

/// Returns numbers of pairs in proportion to the mean of what single pairs of the pixels around bring, where only some
/// pixels have pairs. Without any, `mean` everywhere.
/// in:      sums   [pixel] of |f_new - f_old| over the pairs of the pixel
///          pairs  [pixel] their number
///          takes  [pixel] 0: it has no part in this, and gets none
///          mean   pairs per pixel of the others, about
PairCounts pairs_by_size(const Sensor& sensor, const std::vector<double>& sums, const std::vector<std::uint32_t>& pairs,
                         const std::vector<std::uint8_t>& takes, double mean, std::uint64_t seed);

}  // namespace loom::residual
