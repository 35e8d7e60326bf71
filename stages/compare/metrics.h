#pragma once
// How far an array x lies from its reference r. The pointwise measures take arrays of any shape, flat; those
// that look at neighbours take pictures [y, x] or [y, x, channel].

#include <array>
#include <cstdint>
#include <span>
#include <vector>

namespace loom::compare {

/// Added to r^2 where an error is relative, so that black pixels count but do not decide: 0.1^2.   [PG] §7
inline constexpr double relative_floor = 0.01;

/// mean (x - r)^2                                                           needs (all): equal sizes
double mean_squared(std::span<const float> x, std::span<const float> r);
/// relMSE = mean (x - r)^2 / (r^2 + 0.01)
/// differs: [PG] leaves the floor open
double mean_squared_relative(std::span<const float> x, std::span<const float> r);
/// The same without the `share` of the elements (pixels: n_channels consecutive values) whose error is largest;
/// floor(share n) of them. Outliers decide the plain one; quote both.
double trimmed_mean_squared_relative(std::span<const float> x, std::span<const float> r, std::size_t n_channels,
                                     double share = 0.001);
/// MAPE / 100 = mean |x - r| / (|r| + 0.01)
double mean_absolute_relative(std::span<const float> x, std::span<const float> r);

/// What a display shows: sRGB of x 2^exposure_ev, clamped to [0, 1].
std::vector<float> displayed(std::span<const float> x, double exposure_ev);
/// 10 log10(1 / mean (x - r)^2) in dB of displayed values; infinite for equal ones.
double psnr_db(std::span<const float> x, std::span<const float> r);

/// Structural similarity of two displayed pictures of one channel, mean over the pixels.       [Wang2004] Eq. (13)
///   Gaussian window of 11 x 11 pixels, sigma 1.5; C1 = 0.01^2, C2 = 0.03^2
/// needs:   width height values in [0, 1]
/// differs: windows are cut at the border and their weights scaled to sum 1, so that every pixel counts
double ssim(std::span<const float> x, std::span<const float> r, std::size_t width, std::size_t height);
/// Luma Y' of displayed RGB.                                                        [ITU-R BT.709]
std::vector<float> luma(std::span<const float> displayed_rgb);

/// Correlation of the relative error e = (x - r) / sqrt(r^2 + 0.01) with itself, shifted; 0 for independent
/// pixels, towards 1 for blotches. NaN where no pixel has such a neighbour or the error is constant.
///   rho(d) = <(e(p) - m)(e(p + d) - m)>_p / <(e - m)^2>,   m: mean of the channel; channels pooled
struct Correlation {
    double right = 0;  // (1, 0)
    double down = 0;   // (0, 1)
    double near = 0;   // mean of rho(k, 0) and rho(0, k) over k = 2 … 8
};
Correlation error_correlation(std::span<const float> x, std::span<const float> r, std::size_t width, std::size_t height,
                              std::size_t n_channels);

/// Bias and variance apart, on the scale of relMSE (each value over r^2 + 0.01).
///   several replicates x_1 … x_R:  variance = <s^2>,      bias2 = <(m - r)^2 - s^2/R - var_r>
///   one with var_mean v:           variance = <v>,        bias2 = <(x - r)^2 - v - var_r>
/// so that the mean relMSE is bias2 + variance + reference. bias2 has no bias of its own, and may be below 0.
struct Decomposition {
    double bias2 = 0, variance = 0;
    double reference = 0;  // var_r, the part that is the reference's own noise; 0 when it does not say
};
/// in:      x      R arrays
/// in:      var_x  of x[0], used for R = 1; empty: unknown, and bias2 and variance are then NaN
/// in:      var_r  empty: unknown, taken for 0
Decomposition decompose(std::span<const std::vector<float>> x, std::span<const float> var_x, std::span<const float> r,
                        std::span<const float> var_r);

}  // namespace loom::compare
