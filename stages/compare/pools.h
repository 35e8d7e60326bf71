#pragma once
// Is the difference between a transient cube and its reference more than noise, bin by bin? Single bins of single
// pixels hold few contributions, whose sum is far from normal: they are tested in pools.

#include <cstdint>
#include <span>
#include <string>
#include <vector>

namespace loom::compare {

/// Means of a cube [y, x, bin, rgb] and the variances of these means, of so many samples per pixel.
struct SampledCube {
    std::span<const float> mean, var_mean;
    double samples = 0;
};

struct PoolTests {
    std::string name;
    std::size_t n = 0;             // pools
    double mean_z = 0, rms_z = 0;  // 0 and 1 for noise, where samples are independent
    double worst_z = 0;            // by size
    std::size_t worst_x = 0, worst_y = 0, worst_bin = 0, worst_channel = 0;  // a bin of the worst pool
    double p = 1;  // of the worst one, corrected for their number [Sidak1967]
};

enum class Pooling { pixels, image };

/// Z tests of pools of bins: z = sum (x - r) / sqrt(V), V the larger of sum (var_x + var_r) and of what the variance of
/// a sample, estimated from both together, makes of it: few samples have a small variance just when they miss the
/// bright ones, and z would be skewed.
///   pixels  pixels side by side (along a Z-order curve) of one bin, as many as make the standard error of the
///           expected difference at most `relative_error` of their sum
///   image   all pixels of one bin: little noise, sharp in time
/// Bins of a pixel are pooled only where a bin of the whole image is not enough: a path may reach several bins, and the
/// covariance is in no file; pixels are independent.
/// Where a pool ends is decided by all samples together, x and r: their mean is uncorrelated with x - r, so that ending
/// a pool where it looks good does not favour a sign.
/// in:      n_pixels = width height; arrays of 3 n_bins n_pixels
/// needs:   radiance, that is means of one sign
/// differs: variances are the samples' own, which for stratified ones are too large; and where samples share light V is
///          what ones of the reference would have: z is then too small
PoolTests test_pools(const SampledCube& x, const SampledCube& r, std::size_t width, std::size_t height,
                     std::size_t n_bins, Pooling pooling, double relative_error);

/// Smallest p of the sums over bins of single pixels, corrected for their number.
/// in:      sums  replicates [y, x, rgb]: Welch's t with R - 1 degrees of freedom; of one, Z with the V of test_pools
///          and
///                bins taken for independent
/// in:      n_x, n_r  samples per pixel; n_r = 0: unknown, as many as n_x
double test_pixels(std::span<const std::vector<float>> sums, std::span<const float> var_sums, double n_x,
                   std::span<const float> reference, std::span<const float> var_reference, double n_r);

}  // namespace loom::compare
