#include "stages/merge/blend.h"

#include <algorithm>
#include <cmath>

#include "stages/core/math/vector.h"
#include "stages/core/stats/moments.h"

namespace loom::merge {
namespace {

constexpr int window_radius = 3, window_pixels = (2 * window_radius + 1) * (2 * window_radius + 1);

/// Mean over the window, as far as it lies within the image.
std::vector<double> window_mean(const std::vector<double>& values, int width, int height) {
    const auto along = [](const std::vector<double>& in, int n, int stride, int n_lines, int line_stride) {
        std::vector<double> out(in.size());
        for (int line = 0; line < n_lines; ++line)
            for (int i = 0; i < n; ++i) {
                double sum = 0;
                const int begin = std::max(i - window_radius, 0), end = std::min(i + window_radius + 1, n);
                for (int k = begin; k < end; ++k) sum += in[std::size_t(line) * line_stride + std::size_t(k) * stride];
                out[std::size_t(line) * line_stride + std::size_t(i) * stride] = sum / (end - begin);
            }
        return out;
    };
    return along(along(values, width, 1, height, width), height, width, width, 1);
}

/// Two estimates of one part of the light, and what is known of their luminance in one half of the parts.
struct HalfSums {
    double n = 0;
    std::vector<double> d, d2, b, bd;  // d = A - B

    explicit HalfSums(std::size_t n_pixels) : d(n_pixels), d2(n_pixels), b(n_pixels), bd(n_pixels) {}

    void add(const std::vector<float>& A, const std::vector<float>& B) {
        ++n;
        for (std::size_t i = 0; i < d.size(); ++i) {
            const double y_a = luminance(Rgb<double>{A[3 * i], A[3 * i + 1], A[3 * i + 2]});
            const double y_b = luminance(Rgb<double>{B[3 * i], B[3 * i + 1], B[3 * i + 2]});
            if (!std::isfinite(y_a - y_b)) continue;  // counted and reported in the result
            const double difference = y_a - y_b;
            d[i] += difference;
            d2[i] += difference * difference;
            b[i] += y_b;
            bd[i] += y_b * difference;
        }
    }

    /// Weight of A by pixel.
    std::vector<double> weights(const std::vector<double>& importance, int width, int height) const {
        std::vector<double> bias2(d.size()), var(d.size()), cov(d.size());
        for (std::size_t i = 0; i < d.size(); ++i) {
            const double mean = d[i] / n;
            const double var_mean = std::max(d2[i] / n - mean * mean, 0.0) / (n - 1);
            bias2[i] = (mean * mean - var_mean) * importance[i];
            var[i] = var_mean * importance[i];
            cov[i] = (bd[i] / n - mean * b[i] / n) / (n - 1) * importance[i];
        }
        std::vector<double> squares(bias2.size());
        for (std::size_t i = 0; i < d.size(); ++i) squares[i] = sqr(bias2[i]);
        bias2 = window_mean(bias2, width, height);
        squares = window_mean(squares, width, height);
        var = window_mean(var, width, height);
        cov = window_mean(cov, width, height);
        for (std::size_t i = 0; i < d.size(); ++i) {
            const double error = std::sqrt(std::max(squares[i] - sqr(bias2[i]), 0.0) / window_pixels);
            const double squared_bias = std::max(bias2[i] - error, 0.0), under = squared_bias + var[i];
            bias2[i] = under > 0 ? std::clamp((squared_bias - cov[i]) / under, 0.0, 1.0) : 0.0;
        }
        return bias2;
    }
};

}  // namespace

bool has_estimates(const Image& image) {
    return std::ranges::all_of(estimate_layers, [&](const char* layer) { return !image.find(std::string(layer) + ".R").empty(); });
}

Image blend_images(std::size_t n_parts, const std::function<Image(std::size_t)>& part) {
    Image result;
    std::vector<std::vector<double>> layer_sums;  // of channels that are no estimates
    std::vector<double> luminance_sum;
    std::vector<HalfSums> direct, indirect;
    for (std::size_t i = 0; i < n_parts; ++i) {
        const Image image = part(i);
        if (i == 0) {
            result.width = image.width;
            result.height = image.height;
            for (const Image::Channel& channel : image.channels)
                if (std::ranges::none_of(estimate_layers, [&](const char* layer) { return channel.name.starts_with(std::string(layer) + "."); }))
                    result.channels.push_back({channel.name, {}});
            layer_sums.assign(result.channels.size(), std::vector<double>(image.n_pixels()));
            luminance_sum.resize(image.n_pixels());
            direct.assign(2, HalfSums(image.n_pixels()));
            indirect = direct;
        }
        result.samples += image.samples;
        for (std::size_t k = 0; k < result.channels.size(); ++k) {
            const auto values = image.find(result.channels[k].name);
            for (std::size_t p = 0; p < values.size(); ++p) layer_sums[k][p] += double(values[p]);
        }
        const std::vector<float> rgb = image.interleaved("");
        for (std::size_t p = 0; p < luminance_sum.size(); ++p) {
            const double y = luminance(Rgb<double>{rgb[3 * p], rgb[3 * p + 1], rgb[3 * p + 2]});
            if (std::isfinite(y)) luminance_sum[p] += y;
        }
        direct[i % 2].add(image.interleaved("DirectOwn"), image.interleaved("DirectCluster"));
        indirect[i % 2].add(image.interleaved("IndirectPath"), image.interleaved("IndirectCluster"));
    }

    const int width = int(result.width), height = int(result.height);
    std::vector<double> importance = window_mean(luminance_sum, width, height);
    for (double& y : importance) y = 1 / (sqr(y / double(n_parts)) + 0.01);  // errors count relative to brightness
    std::vector<double> t_direct[2], t_indirect[2];
    for (int half = 0; half < 2; ++half) {
        t_direct[half] = direct[1 - half].weights(importance, width, height);
        t_indirect[half] = indirect[1 - half].weights(importance, width, height);
    }

    const std::size_t n_pixels = result.n_pixels();
    std::vector<Moments> moments(3 * n_pixels);
    for (std::size_t i = 0; i < n_parts; ++i) {
        const Image image = part(i);
        const auto emitted = image.interleaved("Emitted"), direct_own = image.interleaved("DirectOwn"),
                   direct_cluster = image.interleaved("DirectCluster"), path = image.interleaved("IndirectPath"),
                   cluster = image.interleaved("IndirectCluster");
        for (std::size_t p = 0; p < n_pixels; ++p) {
            const double td = t_direct[i % 2][p], ti = t_indirect[i % 2][p];
            for (std::size_t k = 3 * p; k < 3 * p + 3; ++k)
                moments[k].add(emitted[k] + direct_cluster[k] + td * (direct_own[k] - direct_cluster[k]) + cluster[k] +
                               ti * (path[k] - cluster[k]));
        }
    }
    for (std::size_t k = 0; k < result.channels.size(); ++k) {
        auto& values = result.channels[k].values;
        values.resize(n_pixels);
        for (std::size_t p = 0; p < n_pixels; ++p) values[p] = float(layer_sums[k][p] / double(n_parts));
    }
    std::vector<float> mean(3 * n_pixels), var_mean(3 * n_pixels);
    for (std::size_t k = 0; k < mean.size(); ++k) {
        mean[k] = float(moments[k].mean);
        var_mean[k] = float(moments[k].var_mean());
    }
    result.set_layer("", "RGB", mean);
    result.set_layer("VarMean", "RGB", var_mean);
    const auto even = double((n_parts + 1) / 2), odd = double(n_parts / 2);
    for (const auto& [name, t] : {std::pair{"Blend.Direct", t_direct}, {"Blend.Indirect", t_indirect}}) {
        const auto values = result.add(name);
        for (std::size_t p = 0; p < n_pixels; ++p) values[p] = float((t[0][p] * even + t[1][p] * odd) / (even + odd));
    }
    return result;
}

}  // namespace loom::merge
