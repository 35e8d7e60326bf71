#pragma once
// Tests whether the difference between an image and its reference is more than noise. The tests use means over the
// whole image and over 8 x 8 tiles: a small bias is hidden in the noise of pixels, but not in that of their mean.

#include <array>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "stages/core/stats/student.h"

namespace loom::compare {

inline constexpr std::size_t n_tiles = 8;  // per side

/// Returns the region of pixel (x, y): 1 + tile; region 0 is the whole image. Images smaller than 8 pixels have empty
/// tiles.
std::size_t tile_of(std::size_t x, std::size_t y, std::size_t width, std::size_t height);

/// Sum and number of pixels of each region for each channel of RGB: [region], 1 + 64 regions.
struct Regions {
    std::array<std::vector<double>, 3> sum;
    std::vector<double> n;
    double mean(std::size_t channel, std::size_t region) const { return sum[channel][region] / n[region]; }
};
Regions regions_of(std::span<const float> rgb, std::size_t width, std::size_t height);

/// One image, or several replicates of it, [y, x, rgb].
struct Sampled {
    std::span<const std::vector<float>> pictures;
    std::span<const float> var_mean;  // of pictures[0]; used for a single image only. Empty: unknown
};

struct RegionTest {
    double difference = 0;  // difference of the means
    double se = 0;          // standard error of the difference
    double p_value = 1;
};

/// Returns the smallest p of m tests, corrected for their number: 1 - (1 - p)^m.   [Sidak1967]
double corrected_p(double p, double m);

struct Significance {
    const char* kind = "";  // "Welch": from replicates; "Z": from variances; "none": neither is available
    std::array<std::vector<RegionTest>, 3> tests;  // [channel][region]
    /// Smallest p-values of the three channels, and of all tiles and channels; each corrected for their number.
    double p_image = 1, p_tiles = 1;
    std::size_t worst_tile = 0;  // 8 row + column of the tile with the smallest p
};

/// Two-sided tests that image and reference have the same mean, by region.
///   t = (mean - mean_r) / sqrt(se^2 + se_r^2), se from the spread of R replicates (Welch's t) or from the variances
///   stored with a single image (Z)                                                                   [Welch1947]
/// in:      var_reference  of the reference's pixels; empty: the reference is exact
/// differs: R - 1 degrees of freedom, the fewest that Welch's formula can give. With few replicates, one of the 192
///          tiles has almost no spread by chance, and the formula then gives too many        [Scheffe1970]
/// differs: Z assumes independent pixels and samples. Methods that share samples between pixels need replicates.
///          Stratified samples have less variance than stored, so Z then detects less than it could
Significance test_means(const Sampled& x, std::span<const float> reference, std::span<const float> var_reference,
                        std::size_t width, std::size_t height);

/// Ratio of two errors with a 95 % interval.
struct Ratio {
    double value = 0, low = 0, high = 0;  // NaN where unknown
};

/// Returns the ratio of error a to error b.
///   log(a/b) +- t se,  se^2 = se_a^2/a^2 + se_b^2/b^2 from replicates, dof by Welch-Satterthwaite     [Welch1947]
/// needs:   at least two replicates each; else an interval of NaN
Ratio ratio_of(std::span<const double> a, std::span<const double> b);

/// Returns the ratio of the errors of one image each; the interval is from the spread over tiles, linearised.
/// [Cochran1977]
///   se = sqrt(T / (T - 1) sum_t (A_t - q B_t)^2) / B,  A_t: sum of the squared errors in tile t, q = A/B
/// differs: regions of an image differ by more than noise, so the interval is rather too wide
Ratio ratio_of_tiles(std::span<const double> a, std::span<const double> b);

}  // namespace loom::compare
