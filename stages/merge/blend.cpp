#include "stages/merge/blend.h"

#include <algorithm>
#include <cmath>
#include <optional>

#include "stages/core/math/vector.h"
#include "stages/core/stats/moments.h"

namespace loom::merge {
namespace {

/// Window in which bias is tested, and the number of standard errors that it must exceed. Noise from rare paths is
/// missing in most windows of that size, which then look biased and quiet. Noise is therefore measured over a wider
/// window as well.
struct Test {
    int radius;
    double standard_errors;
    int noise_radius;
};
constexpr Test direct_against_own{3, 0.5, 3};
constexpr Test against_own{3, 0.5, 27};   // own samples against the cluster's: noise of a few samples
constexpr Test against_path{6, 0.5, 54};  // whole paths against both

/// Returns the mean over the window, as far as it lies inside the image. A window is the end of one block of its length
/// and the start of the next. Its sum therefore has two terms for any size, and small values are not lost beside far
/// larger ones.
std::vector<double> window_mean(const std::vector<double>& values, int width, int height, int radius) {
    const auto along = [length = 2 * radius + 1, radius](const std::vector<double>& in, int n, int stride, int n_lines,
                                                         int line_stride) {
        std::vector<double> out(in.size()), from_block_begin(std::size_t(n) + 1), to_block_end(std::size_t(n) + 1);
        for (int line = 0; line < n_lines; ++line) {
            const std::size_t first = std::size_t(line) * line_stride;
            for (int i = 0; i < n; ++i)
                from_block_begin[i] = in[first + std::size_t(i) * stride] + (i % length ? from_block_begin[i - 1] : 0);
            for (int i = n; i-- > 0;)
                to_block_end[i] = in[first + std::size_t(i) * stride] + ((i + 1) % length ? to_block_end[i + 1] : 0);
            for (int i = 0; i < n; ++i) {
                const int begin = std::max(i - radius, 0), last = std::min(i + radius, n - 1);
                double sum = begin % length ? to_block_end[begin] : from_block_begin[last];
                if (last / length > begin / length) sum += from_block_begin[last];
                out[first + std::size_t(i) * stride] = sum / (last + 1 - begin);
            }
        }
        return out;
    };
    return along(along(values, width, 1, height, width), height, width, width, 1);
}

using Luminances = std::vector<double>;

Luminances luminances(const std::vector<float>& rgb) {
    Luminances y(rgb.size() / 3);
    for (std::size_t i = 0; i < y.size(); ++i) {
        y[i] = luminance(Rgb<double>{rgb[3 * i], rgb[3 * i + 1], rgb[3 * i + 2]});
        if (!std::isfinite(y[i])) y[i] = 0;  // counted and reported in the result
    }
    return y;
}

/// Returns the mean over the window of estimates that may be negative, minus some of its standard errors, at least 0.
std::vector<double> significant(const std::vector<double>& estimate, int width, int height, const Test& test) {
    std::vector<double> squares(estimate.size());
    for (std::size_t i = 0; i < estimate.size(); ++i) squares[i] = sqr(estimate[i]);
    std::vector<double> mean = window_mean(estimate, width, height, test.radius);
    squares = window_mean(squares, width, height, test.radius);
    for (std::size_t i = 0; i < mean.size(); ++i) {
        const double error = std::sqrt(std::max(squares[i] - sqr(mean[i]), 0.0)) / (2 * test.radius + 1);
        mean[i] = std::max(mean[i] - test.standard_errors * error, 0.0);
    }
    return mean;
}

/// Test of bias: whether a blend differs from the paths' own unbiased estimate A by more than noise explains, in
/// windows of 7 x 7 or 13 x 13 pixels.
///
/// The noise of A makes the test hard: a window that rare bright paths have missed looks quiet. The size of such paths,
/// v = var / mean, is therefore taken from a wide window. Let light of mean f come in events of size v. The probability
/// that n samples of it have mean a is at most exp(-(n f / v) h(a / f)), by Chernoff's bound of a Poisson number. Below
/// exp(-7), one in 1100, the blend is refused. Before, f is moved towards a by three standard errors of the blend,
/// whose noise counts as common to 16 pixels, about the extent of clusters.
///   h(r) = r ln r - r + 1                                                                  [Boucheron2013] 2.2
/// Power: with four passes (two in the testing half) a relative bias of 0.33 sqrt(v / f) over a 13 x 13 window is
/// detected with probability 0.99. That is 16 % of light whose passes have a relative variance of 1/4, 3 % for 1/100.
struct Distrust {
    static constexpr double log_odds = 7, blend_errors = 3;
    static constexpr int wide_radius = 27, common_pixels = 16;

    double n_parts;
    std::vector<double> a, var_a, f, var_f;  // means over parts; variances of one part

    Distrust(std::size_t n_pixels, double n) : n_parts(n), a(n_pixels), var_a(n_pixels), f(n_pixels), var_f(n_pixels) {}

    void set(std::size_t i, double mean_a, double mean_a2, double mean_f, double mean_f2) {
        const double to_sample = n_parts / (n_parts - 1);
        a[i] = mean_a, var_a[i] = std::max(mean_a2 - sqr(mean_a), 0.0) * to_sample;
        f[i] = mean_f, var_f[i] = std::max(mean_f2 - sqr(mean_f), 0.0) * to_sample;
    }

    /// Returns 1 where the blend is refused, else 0.
    std::vector<double> pixels(int width, int height) const {
        const std::vector<double> wide_var = window_mean(var_a, width, height, wide_radius),
                                  wide_mean = window_mean(a, width, height, wide_radius);
        std::vector<double> out(a.size());
        for (const int radius : {3, 6}) {
            const std::vector<double> A = window_mean(a, width, height, radius),
                                      F = window_mean(f, width, height, radius),
                                      F_var = window_mean(var_f, width, height, radius);
            for (std::size_t i = 0; i < out.size(); ++i) {
                const int x = int(i) % width, y = int(i) / width;
                const double n_pixels = double(std::min(x + radius, width - 1) - std::max(x - radius, 0) + 1) *
                                        (std::min(y + radius, height - 1) - std::max(y - radius, 0) + 1);
                const double n = n_pixels * n_parts, v = wide_mean[i] > 0 ? wide_var[i] / wide_mean[i] : 0.0;
                const double noise =
                    blend_errors * std::sqrt(F_var[i] * std::min(common_pixels / n_pixels, 1.0) / n_parts);
                const double f = std::abs(A[i] - F[i]) <= noise ? A[i] : F[i] + (A[i] > F[i] ? noise : -noise);
                // A difference by rounding is no bias; light where the blend has none is one.
                if (std::abs(A[i] - f) <= 1e-6 * std::abs(F[i])) continue;
                const double r = A[i] / f, h = f <= 0 ? INFINITY : r > 0 ? r * std::log(r) - r + 1 : 1.0;
                if (v <= 0 || n * f / v * h > log_odds) out[i] = 1;
            }
        }
        return out;
    }
};

/// Two estimates A and B = A - d in one half of the parts: sums of their luminance, [pixel].
struct PairSums {
    double n = 0;
    std::vector<double> d, d2, b, b2, bd;

    explicit PairSums(std::size_t n_pixels) : d(n_pixels), d2(n_pixels), b(n_pixels), b2(n_pixels), bd(n_pixels) {}

    void add(const Luminances& A, const Luminances& B) {
        ++n;
        for (std::size_t i = 0; i < d.size(); ++i) {
            const double difference = A[i] - B[i];
            d[i] += difference;
            d2[i] += sqr(difference);
            b[i] += B[i];
            b2[i] += sqr(B[i]);
            bd[i] += B[i] * difference;
        }
    }

    /// Returns the pixels where B + t (A - B) is refused.
    std::vector<double> distrust(const std::vector<double>& t, int width, int height) const {
        Distrust guard(d.size(), n);
        for (std::size_t i = 0; i < d.size(); ++i)
            guard.set(i, (b[i] + d[i]) / n, (b2[i] + 2 * bd[i] + d2[i]) / n, (b[i] + t[i] * d[i]) / n,
                      (b2[i] + 2 * t[i] * bd[i] + sqr(t[i]) * d2[i]) / n);
        return guard.pixels(width, height);
    }

    /// Returns the weight of A, [pixel].
    std::vector<double> weights(const std::vector<double>& importance, int width, int height, const Test& test) const {
        std::vector<double> bias2(d.size()), var_a(d.size()), var_b(d.size()), cov(d.size());
        for (std::size_t i = 0; i < d.size(); ++i) {
            const double mean = d[i] / n, scale = importance[i] / (n - 1);
            const double of_d = std::max(d2[i] / n - sqr(mean), 0.0), of_b = std::max(b2[i] / n - sqr(b[i] / n), 0.0),
                         with_b = bd[i] / n - mean * b[i] / n;
            bias2[i] = sqr(mean) * importance[i] - of_d * scale;
            var_b[i] = of_b * scale;
            cov[i] = (of_b + with_b) * scale;
            var_a[i] = std::max(of_d + 2 * with_b + of_b, 0.0) * scale;
        }
        bias2 = significant(bias2, width, height, test);
        const std::vector<double> wide = window_mean(var_a, width, height, test.noise_radius);
        var_a = window_mean(var_a, width, height, test.radius);
        var_b = window_mean(var_b, width, height, test.radius);
        cov = window_mean(cov, width, height, test.radius);
        for (std::size_t i = 0; i < d.size(); ++i) {
            const double with_a = std::max(var_a[i], wide[i]) - cov[i], with_b = bias2[i] + var_b[i] - cov[i],
                         under = with_a + with_b;
            bias2[i] = under > 0 ? std::clamp(with_b / under, 0.0, 1.0) : 0.0;
        }
        return bias2;
    }
};

/// Three estimates: whole paths, the own sample of refined radiance, the cluster.
struct TripleSums {
    PairSums own;                       // own sample against the cluster
    std::vector<double> u, u2, uv, ub;  // u = path - cluster, v = own - cluster, b = cluster

    explicit TripleSums(std::size_t n_pixels) : own(n_pixels), u(n_pixels), u2(n_pixels), uv(n_pixels), ub(n_pixels) {}

    void add(const Luminances& path, const Luminances& own_sample, const Luminances& cluster) {
        own.add(own_sample, cluster);
        for (std::size_t i = 0; i < u.size(); ++i) {
            const double difference = path[i] - cluster[i];
            u[i] += difference;
            u2[i] += sqr(difference);
            uv[i] += difference * (own_sample[i] - cluster[i]);
            ub[i] += difference * cluster[i];
        }
    }

    /// Compares whole paths with the blend cluster + t (own - cluster).
    PairSums against_blend(const std::vector<double>& t) const {
        PairSums pair(u.size());
        pair.n = own.n;
        for (std::size_t i = 0; i < u.size(); ++i) {
            pair.d[i] = u[i] - t[i] * own.d[i];
            pair.d2[i] = u2[i] - 2 * t[i] * uv[i] + sqr(t[i]) * own.d2[i];
            pair.b[i] = own.b[i] + t[i] * own.d[i];
            pair.b2[i] = own.b2[i] + 2 * t[i] * own.bd[i] + sqr(t[i]) * own.d2[i];
            pair.bd[i] = ub[i] - t[i] * own.bd[i] + t[i] * uv[i] - sqr(t[i]) * own.d2[i];
        }
        return pair;
    }
};

/// Direct light of the cluster in one half of the parts: sums of its luminance, [pixel].
struct SharedDirect {
    double n = 0;
    std::vector<double> b, b2;

    explicit SharedDirect(std::size_t n_pixels) : b(n_pixels), b2(n_pixels) {}

    void add(const Luminances& emitted, const Luminances& direct) {
        ++n;
        for (std::size_t i = 0; i < b.size(); ++i) {
            b[i] += emitted[i] + direct[i];
            b2[i] += sqr(emitted[i] + direct[i]);
        }
    }

    /// Returns the weight of an independent unbiased image `a` of variance var_a.
    std::vector<double> weights(const Luminances& a, const Luminances& var_a, const std::vector<double>& importance,
                                int width, int height, const Test& test) const {
        std::vector<double> bias2(b.size()), noise(b.size()), all(b.size());
        for (std::size_t i = 0; i < b.size(); ++i) {
            const double mean = b[i] / n, var_mean = std::max(b2[i] / n - sqr(mean), 0.0) / (n - 1);
            bias2[i] = (sqr(a[i] - mean) - var_a[i] - var_mean) * importance[i];
            noise[i] = var_mean * importance[i];
            all[i] = (var_a[i] + var_mean) * importance[i];
        }
        bias2 = significant(bias2, width, height, test);
        noise = window_mean(noise, width, height, test.radius);
        all = window_mean(all, width, height, test.radius);
        for (std::size_t i = 0; i < b.size(); ++i) {
            const double under = bias2[i] + all[i];
            bias2[i] = under > 0 ? (bias2[i] + noise[i]) / under : 0.0;
        }
        return bias2;
    }
};

/// Two estimates A and B of all parts: expected error of their best mixture.
struct Expectation {
    double n = 0;
    std::vector<double> a, b, aa, ab, bb;

    explicit Expectation(std::size_t n_pixels) : a(n_pixels), b(n_pixels), aa(n_pixels), ab(n_pixels), bb(n_pixels) {}

    void add(const Luminances& A, const Luminances& B) {
        ++n;
        for (std::size_t i = 0; i < a.size(); ++i) {
            a[i] += A[i], b[i] += B[i];
            aa[i] += sqr(A[i]), ab[i] += A[i] * B[i], bb[i] += sqr(B[i]);
        }
    }

    /// Errors over windows and relative to brightness, [pixel].
    struct Errors {
        std::vector<double> bias2_b, var_a, var_b, best;
    };
    Errors errors(const std::vector<double>& importance, int width, int height, const Test& test) const {
        const std::size_t n_pixels = a.size();
        Errors e{std::vector<double>(n_pixels), std::vector<double>(n_pixels), std::vector<double>(n_pixels),
                 std::vector<double>(n_pixels)};
        std::vector<double> cov(n_pixels);
        const auto co = [&](double xy, double x, double y) { return (xy / n - x / n * y / n) / (n - 1); };
        for (std::size_t i = 0; i < n_pixels; ++i) {
            e.var_a[i] = std::max(co(aa[i], a[i], a[i]), 0.0) * importance[i];
            e.var_b[i] = std::max(co(bb[i], b[i], b[i]), 0.0) * importance[i];
            cov[i] = co(ab[i], a[i], b[i]) * importance[i];
            e.bias2_b[i] = sqr((a[i] - b[i]) / n) * importance[i] - (e.var_a[i] - 2 * cov[i] + e.var_b[i]);
        }
        e.bias2_b = significant(e.bias2_b, width, height, test);
        e.var_a = window_mean(e.var_a, width, height, test.radius);
        e.var_b = window_mean(e.var_b, width, height, test.radius);
        cov = window_mean(cov, width, height, test.radius);
        for (std::size_t i = 0; i < n_pixels; ++i) {
            const double with_a = e.var_a[i] - cov[i], with_b = e.bias2_b[i] + e.var_b[i] - cov[i],
                         under = with_a + with_b;
            const double t = under > 0 ? std::clamp(with_b / under, 0.0, 1.0) : 0.0;
            e.best[i] = sqr(t) * e.var_a[i] + sqr(1 - t) * (e.bias2_b[i] + e.var_b[i]) + 2 * t * (1 - t) * cov[i];
        }
        return e;
    }
};

/// Returns the mean without the largest 0.1 %.
double trimmed_mean(std::vector<double> values) {
    const std::size_t kept = values.size() - values.size() / 1000;
    std::nth_element(values.begin(), values.begin() + std::ptrdiff_t(kept - 1), values.end());
    std::sort(values.begin(), values.begin() + std::ptrdiff_t(kept));  // equal sum with any standard library
    double sum = 0;
    for (std::size_t i = 0; i < kept; ++i) sum += values[i];
    return sum / double(kept);
}

/// Weights of one half of the parts, estimated from the other half.
struct Weights {
    std::vector<double> direct, own, path;
    std::vector<double> distrust;  // 1 where the blend of direct or of indirect light is refused

    /// Uses the paths alone where their blend is refused.
    void trust_paths(std::vector<double>& weight, const std::vector<double>& where) {
        for (std::size_t p = 0; p < where.size(); ++p)
            if (where[p] > 0) weight[p] = distrust[p] = 1;
    }
};

/// Means of the layers that are no estimates.
struct LayerMeans {
    Image result;

    explicit LayerMeans(std::size_t n_parts) : n_parts_(double(n_parts)) {}

    void add(const Image& image) {
        if (sums_.empty()) {
            result.width = image.width;
            result.height = image.height;
            const auto estimate = [](const Image::Channel& channel) {
                return std::ranges::any_of(estimate_layers, [&](const char* layer) {
                    return channel.name.starts_with(std::string(layer) + ".");
                });
            };
            for (const Image::Channel& channel : image.channels)
                if (!estimate(channel)) result.channels.push_back({channel.name, {}});
            sums_.assign(result.channels.size(), std::vector<double>(image.n_pixels()));
        }
        result.samples += image.samples;
        for (std::size_t k = 0; k < sums_.size(); ++k) {
            const auto values = image.find(result.channels[k].name);
            for (std::size_t p = 0; p < values.size(); ++p) sums_[k][p] += double(values[p]);
        }
    }

    /// Returns R, G, B and VarMean from moments over parts, [y, x, rgb].
    Image finish(const std::vector<Moments>& moments) && {
        for (std::size_t k = 0; k < sums_.size(); ++k) {
            auto& values = result.channels[k].values;
            values.resize(sums_[k].size());
            for (std::size_t p = 0; p < values.size(); ++p) values[p] = float(sums_[k][p] / n_parts_);
        }
        std::vector<float> mean(moments.size()), var_mean(moments.size());
        for (std::size_t k = 0; k < mean.size(); ++k) {
            mean[k] = float(moments[k].mean);
            var_mean[k] = float(moments[k].var_mean());
        }
        result.set_layer("", "RGB", mean);
        result.set_layer("VarMean", "RGB", var_mean);
        return std::move(result);
    }

  private:
    double n_parts_;
    std::vector<std::vector<double>> sums_;
};

/// An independent image of emission and direct light.
struct DirectImage {
    std::vector<float> rgb, var_mean;
    Luminances y, var_y;

    explicit DirectImage(const Image& image)
        : rgb(image.interleaved("")), var_mean(image.interleaved("VarMean")), y(luminances(rgb)) {
        // Channels rise and fall together: their standard deviations add up.
        std::vector<float> deviation(var_mean.size());
        for (std::size_t k = 0; k < deviation.size(); ++k) deviation[k] = std::sqrt(var_mean[k]);
        var_y = luminances(deviation);
        for (double& v : var_y) v = sqr(v);
    }
};

/// Sums of the estimates, by half of the parts.
struct HalfSums {
    std::vector<double> luminance;  // of both halves
    std::vector<PairSums> direct;   // without an image of direct light
    std::vector<SharedDirect> shared_direct;
    std::vector<TripleSums> indirect;

    HalfSums(std::size_t n_pixels, bool has_direct_image) : luminance(n_pixels) {
        if (has_direct_image)
            shared_direct.assign(2, SharedDirect(n_pixels));
        else
            direct.assign(2, PairSums(n_pixels));
        indirect.assign(2, TripleSums(n_pixels));
    }

    void add(std::size_t half, const Image& image) {
        const auto layer = [&](const char* name) { return luminances(image.interleaved(name)); };
        const Luminances y = layer("");
        for (std::size_t p = 0; p < y.size(); ++p) luminance[p] += y[p];
        if (direct.empty())
            shared_direct[half].add(layer("Emitted"), layer("DirectCluster"));
        else
            direct[half].add(layer("DirectOwn"), layer("DirectCluster"));
        indirect[half].add(layer("IndirectPath"), layer("IndirectOwn"), layer("IndirectCluster"));
    }

    /// Weights from the sums of one half.
    Weights weights(std::size_t half, const DirectImage* image, const std::vector<double>& importance, int width,
                    int height, bool test_bias) const {
        Weights w;
        w.direct =
            image ? shared_direct[half].weights(image->y, image->var_y, importance, width, height, direct_against_own)
                  : direct[half].weights(importance, width, height, direct_against_own);
        w.own = indirect[half].own.weights(importance, width, height, against_own);
        const PairSums path = indirect[half].against_blend(w.own);
        w.path = path.weights(importance, width, height, against_path);
        w.distrust.assign(w.path.size(), 0);
        if (!test_bias) return w;
        w.trust_paths(w.path, path.distrust(w.path, width, height));
        if (!image) w.trust_paths(w.direct, direct[half].distrust(w.direct, width, height));
        return w;
    }
};

/// Adds the blend of one part.
void add_blend(const Image& image, const Weights& w, const DirectImage* direct_image, std::vector<Moments>& moments) {
    const auto emitted = image.interleaved("Emitted"), direct_own = image.interleaved("DirectOwn"),
               direct_cluster = image.interleaved("DirectCluster"), path = image.interleaved("IndirectPath"),
               own = image.interleaved("IndirectOwn"), cluster = image.interleaved("IndirectCluster");
    for (std::size_t p = 0; p < w.own.size(); ++p)
        for (std::size_t k = 3 * p; k < 3 * p + 3; ++k) {
            const double shared = cluster[k] + w.own[p] * (double(own[k]) - cluster[k]);
            const double straight = emitted[k] + direct_cluster[k];
            const double other = direct_image ? direct_image->rgb[k] : emitted[k] + direct_own[k];
            moments[k].add(straight + w.direct[p] * (other - straight) + shared + w.path[p] * (path[k] - shared));
        }
}

/// Stores the mean weights as layers.
void add_weights(const Weights (&weights)[2], std::size_t n_parts, Image& result) {
    const double even = double((n_parts + 1) / 2) / double(n_parts);
    const auto add = [&](const char* layer, std::vector<double> Weights::*of) {
        const auto values = result.add(layer);
        for (std::size_t p = 0; p < values.size(); ++p)
            values[p] = float(lerp(1 - even, (weights[0].*of)[p], (weights[1].*of)[p]));
    };
    add("Blend.Direct", &Weights::direct);
    add("Blend.Own", &Weights::own);
    add("Blend.Path", &Weights::path);
    add("Blend.Distrust", &Weights::distrust);
}

/// The image of direct light is the same in all parts: its own noise does not show between them.
void add_variance(const DirectImage& direct_image, Image& result) {
    const auto direct_weight = result.find("Blend.Direct");
    for (int c = 0; c < 3; ++c) {
        const auto var_mean = result.add(std::string("VarMean.") + "RGB"[c]);
        for (std::size_t p = 0; p < var_mean.size(); ++p)
            var_mean[p] += float(sqr(double(direct_weight[p])) * direct_image.var_mean[3 * p + c]);
    }
}

}  // namespace

bool has_estimates(const Image& image) {
    return std::ranges::all_of(estimate_layers,
                               [&](const char* layer) { return !image.find(std::string(layer) + ".R").empty(); });
}

Image blend_images(std::size_t n_parts, const std::function<Image(std::size_t)>& part, const Image* direct,
                   bool test_bias) {
    // Sum the parts.
    LayerMeans layers(n_parts);
    std::optional<HalfSums> sums;
    for (std::size_t i = 0; i < n_parts; ++i) {
        const Image image = part(i);
        layers.add(image);
        if (i == 0) sums.emplace(image.n_pixels(), direct != nullptr);
        sums->add(i % 2, image);
    }

    // Find the weights of each half by the other.
    const int width = int(layers.result.width), height = int(layers.result.height);
    std::vector<double> importance = window_mean(sums->luminance, width, height, against_own.radius);
    for (double& y : importance) y = 1 / (sqr(y / double(n_parts)) + 0.01);  // errors count relative to brightness
    std::optional<DirectImage> direct_image;
    if (direct) direct_image.emplace(*direct);
    const DirectImage* const shared = direct_image ? &*direct_image : nullptr;
    const Weights weights[2] = {sums->weights(1, shared, importance, width, height, test_bias),
                                sums->weights(0, shared, importance, width, height, test_bias)};

    // Blend each part.
    std::vector<Moments> moments(3 * layers.result.n_pixels());
    for (std::size_t i = 0; i < n_parts; ++i) add_blend(part(i), weights[i % 2], shared, moments);
    Image result = std::move(layers).finish(moments);
    add_weights(weights, n_parts, result);
    if (shared) add_variance(*shared, result);
    return result;
}

DirectPlan plan_direct(std::size_t n_parts, const std::function<Image(std::size_t)>& part, double cost) {
    std::vector<Expectation> direct, own, path;
    std::vector<double> luminance_sum;
    double n_samples = 0;
    int width = 0, height = 0;
    for (std::size_t i = 0; i < n_parts; ++i) {
        const Image image = part(i);
        if (i == 0) {
            width = int(image.width), height = int(image.height);
            luminance_sum.resize(image.n_pixels());
            for (auto* pair : {&direct, &own, &path}) pair->emplace_back(image.n_pixels());
        }
        n_samples += double(image.samples);
        const auto layer = [&](const char* name) { return luminances(image.interleaved(name)); };
        const Luminances y = layer(""), emitted = layer("Emitted"), cluster = layer("IndirectCluster");
        Luminances direct_own = layer("DirectOwn"), direct_cluster = layer("DirectCluster");
        for (std::size_t p = 0; p < y.size(); ++p) {
            luminance_sum[p] += y[p];
            direct_own[p] += emitted[p], direct_cluster[p] += emitted[p];
        }
        direct[0].add(direct_own, direct_cluster);
        own[0].add(layer("IndirectOwn"), cluster);
        path[0].add(layer("IndirectPath"), cluster);
    }
    std::vector<double> importance = window_mean(luminance_sum, width, height, against_own.radius);
    for (double& y : importance) y = 1 / (sqr(y / double(n_parts)) + 0.01);

    const auto d = direct[0].errors(importance, width, height, direct_against_own);
    std::vector<double> indirect = own[0].errors(importance, width, height, against_own).best;
    const std::vector<double> by_path = path[0].errors(importance, width, height, against_path).best;
    for (std::size_t p = 0; p < indirect.size(); ++p) indirect[p] = std::min(indirect[p], by_path[p]);

    DirectPlan plan;
    plan.indirect = trimmed_mean(std::move(indirect));
    plan.direct = plan.direct_with = trimmed_mean(d.best);
    double least = 0.95 * (plan.indirect + plan.direct) * n_samples;
    for (double m = n_samples / 4; m <= 16 * n_samples; m *= 2) {
        if (m < 2 || m != std::floor(m)) continue;  // noise cannot be estimated from one sample
        std::vector<double> error(d.best.size());
        for (std::size_t p = 0; p < error.size(); ++p) {
            const double a = d.var_a[p] * n_samples / m, b = d.bias2_b[p] + d.var_b[p];
            error[p] = a + b > 0 ? a * b / (a + b) : 0.0;
        }
        const double with = trimmed_mean(std::move(error)), product = (plan.indirect + with) * (n_samples + cost * m);
        if (product >= least) continue;
        least = product;
        plan.samples = std::uint64_t(m);
        plan.direct_with = with;
    }
    return plan;
}

Image average_images(std::size_t n_parts, const std::function<Image(std::size_t)>& part) {
    LayerMeans layers(n_parts);
    std::vector<Moments> moments;
    for (std::size_t i = 0; i < n_parts; ++i) {
        const Image image = part(i);
        layers.add(image);
        const std::vector<float> rgb = image.interleaved("");
        moments.resize(rgb.size());
        for (std::size_t k = 0; k < rgb.size(); ++k) moments[k].add(rgb[k]);
    }
    return std::move(layers).finish(moments);
}

}  // namespace loom::merge
