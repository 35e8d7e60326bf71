#pragma once
// Errors of an array x against its reference r. Pointwise measures take flat arrays of any shape. Measures of
// neighbourhoods take images [y, x] or [y, x, channel].

#include <array>
#include <cstdint>
#include <span>
#include <vector>

namespace loom::compare {

/// Added to r^2 in relative errors, so that black pixels count but do not dominate: 0.1^2.   [PG] §7
inline constexpr double relative_floor = 0.01;

/// mean (x - r)^2                                                           needs (all): equal sizes
double mean_squared(std::span<const float> x, std::span<const float> r);
/// relMSE = mean (x - r)^2 / (r^2 + 0.01)
/// differs: [PG] does not specify the floor
double mean_squared_relative(std::span<const float> x, std::span<const float> r);
/// relMSE without the `share` of the elements (pixels: n_channels consecutive values) with the largest error;
/// floor(share n) of them are removed. Outliers dominate the plain relMSE, so quote both.
double trimmed_mean_squared_relative(std::span<const float> x, std::span<const float> r, std::size_t n_channels,
                                     double share = 0.001);
/// MAPE / 100 = mean |x - r| / (|r| + 0.01)
double mean_absolute_relative(std::span<const float> x, std::span<const float> r);

/// Displayed values: sRGB of x 2^exposure_ev, clamped to [0, 1].
std::vector<float> displayed(std::span<const float> x, double exposure_ev);
/// PSNR in dB: 10 log10(1 / mean (x - r)^2) of displayed values; infinite for equal ones.
double psnr_db(std::span<const float> x, std::span<const float> r);

/// Structural similarity of two displayed images of one channel, mean over the pixels.         [Wang2004] Eq. (13)
///   Gaussian window of 11 x 11 pixels, sigma 1.5; C1 = 0.01^2, C2 = 0.03^2
/// needs:   width height values in [0, 1]
/// differs: windows are cut at the border and their weights scaled to sum 1, so that every pixel counts
double ssim(std::span<const float> x, std::span<const float> r, std::size_t width, std::size_t height);
/// Luma Y' of displayed RGB.                                                        [ITU-R BT.709]
std::vector<float> luma(std::span<const float> displayed_rgb);

/// Autocorrelation of the relative error e = (x - r) / sqrt(r^2 + 0.01); 0 for independent pixels, towards 1 for
/// blotches. NaN where no pixel has such a neighbour or the error is constant.
///   rho(d) = <(e(p) - m)(e(p + d) - m)>_p / <(e - m)^2>,   m: mean of the channel; channels pooled
struct Correlation {
    double right = 0;  // (1, 0)
    double down = 0;   // (0, 1)
    double near = 0;   // mean of rho(k, 0) and rho(0, k) over k = 2 … 8
};
Correlation error_correlation(std::span<const float> x, std::span<const float> r, std::size_t width, std::size_t height,
                              std::size_t n_channels);

/// Bias and variance separately, on the scale of relMSE (each value over r^2 + 0.01).
///   several replicates x_1 … x_R:  variance = <s^2>,      bias2 = <(m - r)^2 - s^2/R - var_r>
///   one with var_mean v:           variance = <v>,        bias2 = <(x - r)^2 - v - var_r>
/// The mean relMSE is bias2 + variance + reference. The estimate bias2 is unbiased and may be below 0.
struct Decomposition {
    double bias2 = 0, variance = 0;
    double reference = 0;  // var_r, the noise of the reference; 0 when unknown
};
/// in:      x      R arrays
/// in:      var_x  of x[0], used for R = 1; empty: unknown, bias2 and variance are then NaN
/// in:      var_r  empty: unknown, taken as 0
Decomposition decompose(std::span<const std::vector<float>> x, std::span<const float> var_x, std::span<const float> r,
                        std::span<const float> var_r);

}  // namespace loom::compare
