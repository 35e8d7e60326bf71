#include "stages/compare/metrics.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "formats/image.h"
#include "stages/core/stats/moments.h"

namespace loom::compare {
namespace {

constexpr double unknown = std::numeric_limits<double>::quiet_NaN();

double squared(double x) {
    return x * x;
}

double squared_relative(float x, float r) {
    return squared(double(x) - double(r)) / (squared(r) + relative_floor);
}

template <class Error>
double mean_of(std::span<const float> x, std::span<const float> r, Error&& error) {
    double sum = 0;
    for (std::size_t i = 0; i < x.size(); ++i) sum += error(x[i], r[i]);
    return sum / double(x.size());
}

/// Gaussian blur along both axes; its window is cut at the borders.
class Blur {
  public:
    Blur(std::size_t width, std::size_t height) : width_(width), height_(height) {
        for (int k = -radius; k <= radius; ++k)
            weights_[std::size_t(k + radius)] = std::exp(-k * k / (2 * sigma * sigma));
    }
    std::vector<double> operator()(const std::vector<double>& image) const {
        std::vector<double> across(image.size()), out(image.size());
        for (std::size_t y = 0; y < height_; ++y) line(&image[y * width_], &across[y * width_], width_, 1);
        for (std::size_t x = 0; x < width_; ++x) line(&across[x], &out[x], height_, width_);
        return out;
    }

  private:
    static constexpr int radius = 5;
    static constexpr double sigma = 1.5;

    void line(const double* in, double* out, std::size_t n, std::size_t step) const {
        for (std::ptrdiff_t i = 0; i < std::ptrdiff_t(n); ++i) {
            double sum = 0, weight = 0;
            for (std::ptrdiff_t k = std::max<std::ptrdiff_t>(-radius, -i);
                 k <= std::min<std::ptrdiff_t>(radius, std::ptrdiff_t(n) - 1 - i); ++k) {
                sum += weights_[std::size_t(k + radius)] * in[std::size_t(i + k) * step];
                weight += weights_[std::size_t(k + radius)];
            }
            out[std::size_t(i) * step] = sum / weight;
        }
    }

    std::size_t width_, height_;
    std::array<double, 2 * radius + 1> weights_;
};

}  // namespace

double mean_squared(std::span<const float> x, std::span<const float> r) {
    return mean_of(x, r, [](float a, float b) { return squared(double(a) - double(b)); });
}

double mean_squared_relative(std::span<const float> x, std::span<const float> r) {
    return mean_of(x, r, squared_relative);
}

double trimmed_mean_squared_relative(std::span<const float> x, std::span<const float> r, std::size_t n_channels,
                                     double share) {
    std::vector<double> errors(x.size() / n_channels);
    for (std::size_t i = 0; i < x.size(); ++i) errors[i / n_channels] += squared_relative(x[i], r[i]);
    // NaN cannot be ordered, and must not be trimmed away.
    for (double error : errors)
        if (std::isnan(error)) return unknown;
    const std::size_t kept = errors.size() - std::size_t(share * double(errors.size()));
    std::nth_element(errors.begin(), errors.begin() + std::ptrdiff_t(kept - 1), errors.end());
    double sum = 0;
    for (std::size_t i = 0; i < kept; ++i) sum += errors[i];
    return sum / double(kept * n_channels);
}

double mean_absolute_relative(std::span<const float> x, std::span<const float> r) {
    return mean_of(x, r, [](float a, float b) {
        return std::abs(double(a) - double(b)) / (std::abs(double(b)) + relative_floor);
    });
}

std::vector<float> displayed(std::span<const float> x, double exposure_ev) {
    const double gain = std::exp2(exposure_ev);
    std::vector<float> shown(x.size());
    std::transform(x.begin(), x.end(), shown.begin(),
                   [&](float v) { return std::isnan(v) ? v : float(srgb_from_linear(gain * double(v))); });
    return shown;
}

double psnr_db(std::span<const float> x, std::span<const float> r) {
    return -10 * std::log10(mean_squared(x, r));
}

std::vector<float> luma(std::span<const float> rgb) {
    std::vector<float> y(rgb.size() / 3);
    for (std::size_t i = 0; i < y.size(); ++i)
        y[i] = 0.2126f * rgb[3 * i] + 0.7152f * rgb[3 * i + 1] + 0.0722f * rgb[3 * i + 2];
    return y;
}

double ssim(std::span<const float> x, std::span<const float> r, std::size_t width, std::size_t height) {
    constexpr double c1 = 0.01 * 0.01, c2 = 0.03 * 0.03;
    std::vector<double> a(x.begin(), x.end()), b(r.begin(), r.end()), aa(x.size()), bb(x.size()), ab(x.size());
    for (std::size_t i = 0; i < x.size(); ++i) {
        aa[i] = a[i] * a[i];
        bb[i] = b[i] * b[i];
        ab[i] = a[i] * b[i];
    }
    const Blur blur(width, height);
    a = blur(a), b = blur(b), aa = blur(aa), bb = blur(bb), ab = blur(ab);
    double sum = 0;
    for (std::size_t i = 0; i < x.size(); ++i) {
        const double var_a = aa[i] - a[i] * a[i], var_b = bb[i] - b[i] * b[i], covariance = ab[i] - a[i] * b[i];
        sum +=
            (2 * a[i] * b[i] + c1) * (2 * covariance + c2) / ((a[i] * a[i] + b[i] * b[i] + c1) * (var_a + var_b + c2));
    }
    return sum / double(x.size());
}

Correlation error_correlation(std::span<const float> x, std::span<const float> r, std::size_t width, std::size_t height,
                              std::size_t n_channels) {
    const std::size_t n = width * height;
    std::vector<std::vector<double>> e(n_channels, std::vector<double>(n));
    double variance = 0;
    for (std::size_t c = 0; c < n_channels; ++c) {
        Moments moments;
        for (std::size_t i = 0; i < n; ++i) {
            const double ref = double(r[i * n_channels + c]);
            e[c][i] = (double(x[i * n_channels + c]) - ref) / std::sqrt(ref * ref + relative_floor);
            moments.add(e[c][i]);
        }
        for (double& value : e[c]) value -= moments.mean;
        variance += moments.m2 / double(n);
    }
    const auto rho = [&](std::size_t dx, std::size_t dy) {
        if (dx >= width || dy >= height || !(variance > 0)) return unknown;
        double sum = 0;
        for (const auto& channel : e)
            for (std::size_t y = 0; y + dy < height; ++y)
                for (std::size_t i = y * width; i < (y + 1) * width - dx; ++i)
                    sum += channel[i] * channel[i + dy * width + dx];
        return sum / double((width - dx) * (height - dy)) / variance;
    };
    Correlation correlation{rho(1, 0), rho(0, 1), 0};
    for (std::size_t k = 2; k <= 8; ++k) correlation.near += (rho(k, 0) + rho(0, k)) / 14;
    return correlation;
}

Decomposition decompose(std::span<const std::vector<float>> x, std::span<const float> var_x, std::span<const float> r,
                        std::span<const float> var_r) {
    const bool spread = x.size() > 1;
    Decomposition sum;
    for (std::size_t i = 0; i < r.size(); ++i) {
        Moments moments;
        for (const auto& replicate : x) moments.add(double(replicate[i]));
        const double var_one = spread ? moments.var_sample() : var_x.empty() ? unknown : double(var_x[i]);
        const double var_reference = var_r.empty() ? 0 : double(var_r[i]);
        const double scale = 1 / (squared(r[i]) + relative_floor);
        sum.variance += var_one * scale;
        sum.reference += var_reference * scale;
        sum.bias2 += (squared(moments.mean - double(r[i])) - var_one / double(x.size()) - var_reference) * scale;
    }
    const double n = double(r.size());
    return {sum.bias2 / n, sum.variance / n, sum.reference / n};
}

}  // namespace loom::compare
