#include "stages/compare/significance.h"

#include <cmath>
#include <limits>

namespace loom::compare {
namespace {

constexpr double infinite = std::numeric_limits<double>::infinity();
constexpr double unknown = std::numeric_limits<double>::quiet_NaN();

/// Returns the standard error of a region's mean from variances of its pixels.
double se_of(const Regions& variances, std::size_t channel, std::size_t region) {
    return std::sqrt(variances.sum[channel][region]) / variances.n[region];
}

/// Returns exp(log_ratio +- t se), two-sided 95 %.
Ratio interval(double ratio, double se_log, double dof) {
    const double reach = student_critical(0.05, dof) * se_log;
    return {ratio, ratio * std::exp(-reach), ratio * std::exp(reach)};
}

}  // namespace

double corrected_p(double p, double m) {
    return p < 1 ? -std::expm1(m * std::log1p(-p)) : 1;
}

std::size_t tile_of(std::size_t x, std::size_t y, std::size_t width, std::size_t height) {
    return y * n_tiles / height * n_tiles + x * n_tiles / width;
}

Regions regions_of(std::span<const float> rgb, std::size_t width, std::size_t height) {
    constexpr std::size_t n = 1 + n_tiles * n_tiles;
    Regions regions;
    regions.n.resize(n);
    for (auto& sum : regions.sum) sum.resize(n);
    for (std::size_t y = 0; y < height; ++y) {
        for (std::size_t x = 0; x < width; ++x) {
            const std::size_t tile = 1 + tile_of(x, y, width, height);
            ++regions.n[0], ++regions.n[tile];
            for (std::size_t c = 0; c < 3; ++c) {
                const double value = double(rgb[3 * (y * width + x) + c]);
                regions.sum[c][0] += value;
                regions.sum[c][tile] += value;
            }
        }
    }
    return regions;
}

Significance test_means(const Sampled& x, std::span<const float> reference, std::span<const float> var_reference,
                        std::size_t width, std::size_t height) {
    Significance result;
    const bool welch = x.pictures.size() > 1;
    result.kind = welch ? "Welch" : x.var_mean.empty() ? "none" : "Z";
    if (!welch && x.var_mean.empty()) {
        result.p_image = result.p_tiles = unknown;
        return result;
    }
    std::vector<Regions> ours;
    for (const auto& picture : x.pictures) ours.push_back(regions_of(picture, width, height));
    const Regions theirs = regions_of(reference, width, height);
    const Regions var_ours = welch ? Regions{} : regions_of(x.var_mean, width, height);
    const Regions var_theirs = var_reference.empty() ? Regions{} : regions_of(var_reference, width, height);

    double least_image = 1, least_tile = 1, tests = 0;
    for (std::size_t c = 0; c < 3; ++c) {
        result.tests[c].resize(theirs.n.size());
        for (std::size_t region = 0; region < theirs.n.size(); ++region) {
            if (theirs.n[region] == 0) continue;
            Estimate a{ours[0].mean(c, region), 0, infinite}, b{theirs.mean(c, region), 0, infinite};
            if (welch) {
                std::vector<double> means;
                for (const Regions& replicate : ours) means.push_back(replicate.mean(c, region));
                a = estimate_of(means);
            } else {
                a.se = se_of(var_ours, c, region);
            }
            if (!var_reference.empty()) b.se = se_of(var_theirs, c, region);
            const double difference = a.mean - b.mean, se = std::hypot(a.se, b.se);
            const double p = se > 0 ? student_p_value(difference / se, a.dof) : difference == 0 ? 1 : 0;
            result.tests[c][region] = {difference, se, p};
            double& least = region == 0 ? least_image : least_tile;
            if (region > 0) {
                ++tests;
                if (p < least) result.worst_tile = region - 1;
            }
            least = std::min(least, p);
        }
    }
    result.p_image = corrected_p(least_image, 3);
    result.p_tiles = corrected_p(least_tile, tests);
    return result;
}

Ratio ratio_of(std::span<const double> a, std::span<const double> b) {
    const auto mean = [](std::span<const double> x) {
        double sum = 0;
        for (double value : x) sum += value;
        return sum / double(x.size());
    };
    const double ratio = mean(a) / mean(b);
    if (a.size() < 2 || b.size() < 2) return {ratio, unknown, unknown};
    const Estimate ea = estimate_of(a), eb = estimate_of(b);
    const double va = std::pow(ea.se / ea.mean, 2), vb = std::pow(eb.se / eb.mean, 2), v = va + vb;
    if (!(v > 0)) return {ratio, ratio, ratio};
    return interval(ratio, std::sqrt(v), v * v / (va * va / ea.dof + vb * vb / eb.dof));
}

Ratio ratio_of_tiles(std::span<const double> a, std::span<const double> b) {
    double sum_a = 0, sum_b = 0, squares = 0;
    for (std::size_t t = 0; t < a.size(); ++t) sum_a += a[t], sum_b += b[t];
    const double ratio = sum_a / sum_b, n = double(a.size());
    if (n < 2) return {ratio, unknown, unknown};
    for (std::size_t t = 0; t < a.size(); ++t) squares += std::pow(a[t] - ratio * b[t], 2);
    return interval(ratio, std::sqrt(n / (n - 1) * squares) / sum_a, n - 1);
}

}  // namespace loom::compare
