#pragma once
// Tests bin by bin whether the difference between a transient cube and its reference is more than noise. A single bin
// of a single pixel has few contributions, whose sum is far from normal. Bins are therefore tested in pools.

#include <cstdint>
#include <span>
#include <string>
#include <vector>

namespace loom::compare {

/// Whether two cubes have one distribution of samples, or derivatives by different estimators, such as differences.
enum class Estimators { alike, different };

/// Means of a cube [y, x, bin, rgb], the variances of these means, and the samples per pixel.
struct SampledCube {
    std::span<const float> mean, var_mean;
    double samples = 0;
};

struct PoolTests {
    std::string name;
    std::size_t n = 0;                                                       // number of pools
    double mean_z = 0, rms_z = 0;                                            // for noise of independent samples 0 and 1
    double worst_z = 0;                                                      // z of the largest absolute value
    std::size_t worst_x = 0, worst_y = 0, worst_bin = 0, worst_channel = 0;  // a bin of the worst pool
    double p = 1;  // p of the worst pool, corrected for the number of pools [Sidak1967]
};

enum class Pooling { pixels, image };

/// Z tests of pools of bins: z = sum (x - r) / sqrt(V). V is the larger of two values. One is sum (var_x + var_r). The
/// other is the variance that follows from the variance of a sample, estimated from both cubes together. Few samples
/// have a small variance exactly when they miss the bright ones; without the second value z would be skewed. Samples of
/// different estimators have no common variance; then V is the first value.
///   pixels  neighbouring pixels (along a Z-order curve) of one bin; as many as make the standard error of the
///           expected difference at most `relative_error` of the sum of their magnitudes
///   image   all pixels of one bin: little noise, exact in time
/// Bins of a pixel are pooled only where one bin of the whole image is not enough. A path may contribute to several
/// bins, and no file stores the covariance; pixels are independent.
/// All samples of x and r together decide where a pool ends. Their mean is uncorrelated with x - r, so the end of a
/// pool does not favour a sign.
/// in:      n_pixels = width height; arrays of 3 n_bins n_pixels
/// differs: variances are those of the samples, which are too large for stratified ones. Where samples share light, V
///          is computed as for independent samples of the reference; z is then too small
PoolTests test_pools(const SampledCube& x, const SampledCube& r, std::size_t width, std::size_t height,
                     std::size_t n_bins, Pooling pooling, double relative_error,
                     Estimators estimators = Estimators::alike);

/// Returns the smallest p of the sums over bins of single pixels, corrected for their number.
/// in:      sums  replicates [y, x, rgb]: Welch's t with R - 1 degrees of freedom; for one replicate Z with the V of
///          test_pools and bins taken as independent
/// in:      n_x, n_r  samples per pixel; n_r = 0: unknown, taken as n_x
double test_pixels(std::span<const std::vector<float>> sums, std::span<const float> var_sums, double n_x,
                   std::span<const float> reference, std::span<const float> var_reference, double n_r,
                   Estimators estimators = Estimators::alike);

}  // namespace loom::compare
