#pragma once
// Is the difference between a picture and its reference more than noise? Means over the whole picture and over
// 8 x 8 tiles: a small bias drowns in the noise of pixels, but not in that of their mean.

#include <array>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "stages/core/stats/student.h"

namespace loom::compare {

inline constexpr std::size_t n_tiles = 8;  // per side

/// Pixel (x, y) lies in region 1 + tile; region 0 is the picture. Pictures smaller than 8 pixels leave tiles empty.
std::size_t tile_of(std::size_t x, std::size_t y, std::size_t width, std::size_t height);

/// Mean and number of pixels of each region: [region], 1 + 64 of them, of each channel of RGB.
struct Regions {
    std::array<std::vector<double>, 3> sum;
    std::vector<double> n;
    double mean(std::size_t channel, std::size_t region) const { return sum[channel][region] / n[region]; }
};
Regions regions_of(std::span<const float> rgb, std::size_t width, std::size_t height);

/// One picture, or several replicates of it, [y, x, rgb].
struct Sampled {
    std::span<const std::vector<float>> pictures;
    std::span<const float> var_mean;  // of pictures[0]; used when there is one only. Empty: unknown
};

struct RegionTest {
    double difference = 0;  // of the means
    double se = 0;          // its standard error
    double p_value = 1;
};

/// Of m tests the smallest p, corrected for their number: 1 - (1 - p)^m
/// [Sidak1967]
double corrected_p(double p, double m);

struct Significance {
    const char* kind = "";  // "Welch": from replicates; "Z": from variances; "none": neither is there
    std::array<std::vector<RegionTest>, 3> tests;  // [channel][region]
    /// Smallest p-value of the three channels, of all tiles and channels, corrected for their number.
    double p_image = 1, p_tiles = 1;
    std::size_t worst_tile = 0;  // 8 row + column of the smallest
};

/// Two-sided tests that picture and reference have the same mean, by region.
///   t = (mean - mean_r) / sqrt(se^2 + se_r^2), se from the spread of R replicates (Welch's t) or from the variances
///   that a single picture brings along (Z)                                                           [Welch1947]
/// in:      var_reference  of the reference's pixels; empty: it is exact
/// differs: R - 1 degrees of freedom, the fewest that Welch's formula can give: with few replicates one of the 192
///          tiles has by chance almost no spread, and the formula then believes in it        [Scheffe1970]
/// differs: Z takes pixels and samples for independent. Methods that share samples between pixels need replicates;
///          stratified samples have less variance than they claim, so that Z then sees less than it could
Significance test_means(const Sampled& x, std::span<const float> reference, std::span<const float> var_reference,
                        std::size_t width, std::size_t height);

/// Ratio of two errors with a 95 % interval.
struct Ratio {
    double value = 0, low = 0, high = 0;  // NaN where unknown
};

/// How many times larger error a is than error b.
///   log(a/b) +- t se,  se^2 = se_a^2/a^2 + se_b^2/b^2 from replicates, dof by Welch-Satterthwaite     [Welch1947]
/// needs:   at least two replicates each; else an interval of NaN
Ratio ratio_of(std::span<const double> a, std::span<const double> b);

/// The same of one picture each: the interval is from the spread over tiles, linearised.         [Cochran1977]
///   se = sqrt(T / (T - 1) sum_t (A_t - q B_t)^2) / B,  A_t: sum of the squared errors in tile t, q = A/B
/// differs: parts of the picture differ in more than noise, so the interval is rather too wide
Ratio ratio_of_tiles(std::span<const double> a, std::span<const double> b);

}  // namespace loom::compare
