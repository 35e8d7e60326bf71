#include "stages/fit/equations.h"

#include <algorithm>
#include <cmath>

namespace loom::fit {
namespace {

/// Histograms of a cube, pixel by pixel and channel by channel.
class Histograms {
  public:
    explicit Histograms(const TransientCube& measured)
        : width_(measured.film.width), height_(measured.film.height), n_bins_(measured.time.n_bins), grey_(true) {
        for (std::size_t i = 0; i < measured.radiance.size() && grey_; i += 3)
            for (std::size_t c = 1; c < 3; ++c)
                grey_ &= measured.radiance[i] == measured.radiance[i + c] &&
                         measured.var_mean[i] == measured.var_mean[i + c];
    }

    std::size_t width() const { return width_; }
    std::size_t height() const { return height_; }
    std::size_t n_channels() const { return grey_ ? 1 : 3; }
    std::size_t size() const { return width_ * height_ * n_channels(); }

    /// Copies the bins of histogram h of `values` [y, x, bin, channel].
    void bins(std::span<const float> values, std::size_t h, std::span<double> out) const {
        const float* at = values.data() + h / n_channels() * n_bins_ * 3;
        if (!grey_) {
            for (std::size_t k = 0; k < n_bins_; ++k) out[k] = double(at[3 * k + h % 3]);
            return;
        }
        for (std::size_t k = 0; k < n_bins_; ++k)
            out[k] = (double(at[3 * k]) + double(at[3 * k + 1]) + double(at[3 * k + 2])) / 3;
    }
    /// Copies variances; of a mean of channels at most this, since they have their paths in common.
    void variances(std::span<const float> values, std::size_t h, std::span<double> out) const {
        if (!grey_) return bins(values, h, out);
        const float* at = values.data() + h * n_bins_ * 3;
        for (std::size_t k = 0; k < n_bins_; ++k) {
            double sum = 0;
            for (std::size_t c = 0; c < 3; ++c) sum += std::sqrt(double(at[3 * k + c]));
            out[k] = sum * sum / 9;
        }
    }

  private:
    std::size_t width_, height_, n_bins_;
    bool grey_;
};

/// Replaces variances of values by means over their neighbours, of the same channel, in three pixels by three and three
/// values, so that a weight depends little on the noise of its own value. None is below a thousandth of the mean of all.
std::vector<float> smoothed(const std::vector<float>& variance, const Histograms& of, std::size_t n_values) {
    std::vector<float> out(variance.size());
    const std::ptrdiff_t w = std::ptrdiff_t(of.width()), h = std::ptrdiff_t(of.height()), n = std::ptrdiff_t(n_values),
                         channels = std::ptrdiff_t(of.n_channels());
    double all = 0;
    for (const float v : variance) all += double(v);
    const double least = 1e-3 * all / double(std::max<std::size_t>(variance.size(), 1));
    for (std::ptrdiff_t y = 0; y < h; ++y)
        for (std::ptrdiff_t x = 0; x < w; ++x)
            for (std::ptrdiff_t c = 0; c < channels; ++c)
                for (std::ptrdiff_t k = 0; k < n; ++k) {
                    double sum = 0, count = 0;
                    for (std::ptrdiff_t j = std::max<std::ptrdiff_t>(y - 1, 0); j < std::min(y + 2, h); ++j)
                        for (std::ptrdiff_t i = std::max<std::ptrdiff_t>(x - 1, 0); i < std::min(x + 2, w); ++i)
                            for (std::ptrdiff_t l = std::max<std::ptrdiff_t>(k - 1, 0); l < std::min(k + 2, n); ++l) {
                                sum += double(variance[std::size_t(((j * w + i) * channels + c) * n + l)]);
                                ++count;
                            }
                    out[std::size_t(((y * w + x) * channels + c) * n + k)] = float(std::max(sum / count, least));
                }
    return out;
}

}  // namespace

Equations normal_equations(const TransientCube& measured, std::span<const TransientCube, 2> evaluated,
                           const TimeTransform& transform) {
    const Histograms histograms(measured);
    const std::size_t n = evaluated[0].n_parameters(), n_bins = transform.n_bins(), n_values = transform.n_values(),
                      cube_size = measured.radiance.size();
    Equations out(n);
    std::vector<double> bins(n_bins);
    const auto values_of = [&](std::span<const float> of, std::size_t h, std::span<double> to) {
        histograms.bins(of, h, bins);
        transform.apply(bins, to);
    };
    const auto variances_of = [&](std::span<const float> of, std::size_t h, std::span<double> to) {
        histograms.variances(of, h, bins);
        transform.apply(bins, to);
    };

    // Weights.
    std::vector<double> var_m(n_values), var_a(n_values), var_b(n_values);
    std::vector<float> variance(histograms.size() * n_values);
    for (std::size_t h = 0; h < histograms.size(); ++h) {
        variances_of(measured.var_mean, h, var_m);
        variances_of(evaluated[0].var_mean, h, var_a);
        variances_of(evaluated[1].var_mean, h, var_b);
        for (std::size_t k = 0; k < n_values; ++k) {
            const double v = var_m[k] + (var_a[k] + var_b[k]) / 4;
            variance[h * n_values + k] = std::isfinite(v) ? float(v) : 0.0f;
        }
    }
    variance = smoothed(variance, histograms, n_values);

    // Sums over values.
    std::vector<double> m(n_values), a(n_values), b(n_values), weight(n_values), back(n_values), m_variance(n_bins);
    std::vector<std::vector<double>> j_a(n, std::vector<double>(n_values)), j_b = j_a,
                                                                            by_bins(n, std::vector<double>(n_bins));
    std::vector<double> of_pixel(n), slope(n),
        diagonal(n);  // J^T W (A - B) / 2, gradient, diagonal of normal
    for (std::size_t h = 0; h < histograms.size(); ++h) {
        values_of(measured.radiance, h, m);
        values_of(evaluated[0].radiance, h, a);
        values_of(evaluated[1].radiance, h, b);
        variances_of(evaluated[0].var_mean, h, var_a);
        variances_of(evaluated[1].var_mean, h, var_b);
        variances_of(measured.var_mean, h, var_m);
        histograms.variances(measured.var_mean, h, m_variance);
        for (std::size_t p = 0; p < n; ++p) {
            values_of(evaluated[0].derivative.bins.row(p, cube_size), h, j_a[p]);
            values_of(evaluated[1].derivative.bins.row(p, cube_size), h, j_b[p]);
        }
        if (h % histograms.n_channels() == 0)
            for (std::vector<double>* sums : {&of_pixel, &slope, &diagonal}) std::fill(sums->begin(), sums->end(), 0.0);
        for (std::size_t k = 0; k < n_values; ++k) {
            bool finite = std::isfinite(m[k] + a[k] + b[k] + var_a[k] + var_b[k] + var_m[k]);
            for (std::size_t p = 0; p < n; ++p) finite &= std::isfinite(j_a[p][k] + j_b[p][k]);
            const double v = double(variance[h * n_values + k]);
            weight[k] = finite && v > 0 ? 1 / v : 0;
            if (!finite) ++out.n_ignored;
            if (weight[k] == 0) {
                // Zero times infinity is no number.
                m[k] = a[k] = b[k] = var_a[k] = var_b[k] = var_m[k] = 0;
                for (std::size_t p = 0; p < n; ++p) j_a[p][k] = j_b[p][k] = 0;
                continue;
            }
            ++out.n_values;
            const double w = weight[k], r_a = m[k] - a[k], r_b = m[k] - b[k];
            out.loss += w * r_a * r_b;
            out.loss_variance += w * w * (std::max(r_a * r_b, 0.0) * (var_a[k] + var_b[k]) + var_a[k] * var_b[k]);
            out.expected_loss += w * var_m[k];
            out.expected_variance +=
                w * w * (2 * var_m[k] * var_m[k] + var_m[k] * (var_a[k] + var_b[k]) + var_a[k] * var_b[k]);
            for (std::size_t p = 0; p < n; ++p) {
                diagonal[p] += w * j_a[p][k] * j_b[p][k];
                slope[p] += w * (j_a[p][k] * r_b + j_b[p][k] * r_a) / 2;
                of_pixel[p] += w * (j_a[p][k] + j_b[p][k]) * (a[k] - b[k]) / 4;
                for (std::size_t q = 0; q <= p; ++q) {
                    out.normal[p * n + q] += w * (j_a[p][k] * j_b[q][k] + j_b[p][k] * j_a[q][k]) / 2;
                    out.curvature[p * n + q] += w * (j_a[p][k] + j_b[p][k]) * (j_a[q][k] + j_b[q][k]) / 4;
                }
            }
        }
        // Noise of the measurement, bin by bin.
        for (std::size_t p = 0; p < n; ++p) {
            for (std::size_t k = 0; k < n_values; ++k) back[k] = weight[k] * (j_a[p][k] + j_b[p][k]) / 2;
            transform.adjoint(back, by_bins[p]);
        }
        for (std::size_t k = 0; k < n_bins; ++k) {
            if (!std::isfinite(m_variance[k])) continue;
            for (std::size_t p = 0; p < n; ++p)
                for (std::size_t q = 0; q <= p; ++q)
                    out.measured_noise[p * n + q] += m_variance[k] * by_bins[p][k] * by_bins[q][k];
        }
        if ((h + 1) % histograms.n_channels() != 0) continue;
        for (std::size_t p = 0; p < n; ++p) {
            out.gradient[p] += slope[p];
            out.normal_variance[p] += diagonal[p] * diagonal[p];
            for (std::size_t q = 0; q <= p; ++q) {
                out.noise[p * n + q] += of_pixel[p] * of_pixel[q];
                out.scatter[p * n + q] += slope[p] * slope[q];
            }
        }
    }
    out.n_pixels = histograms.width() * histograms.height();
    if (out.n_pixels > n)
        for (double& x : out.scatter) x *= double(out.n_pixels) / double(out.n_pixels - n);
    for (std::size_t p = 0; p < n; ++p) {
        const double sum = out.normal[p * n + p];
        out.normal_variance[p] = std::max(out.normal_variance[p] - sum * sum / double(out.n_pixels), 0.0);
    }
    for (std::size_t i = 0; i < n * n; ++i) out.noise[i] += out.measured_noise[i];
    for (Matrix* matrix : {&out.normal, &out.curvature, &out.measured_noise, &out.noise, &out.scatter})
        for (std::size_t p = 0; p < n; ++p)
            for (std::size_t q = p + 1; q < n; ++q) (*matrix)[p * n + q] = (*matrix)[q * n + p];
    return out;
}

}  // namespace loom::fit
