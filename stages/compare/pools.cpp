#include "stages/compare/pools.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

#include "stages/compare/significance.h"

namespace loom::compare {
namespace {

constexpr double infinite = std::numeric_limits<double>::infinity();

/// Returns the pixels along a Z-order curve.
std::vector<std::uint32_t> z_order(std::size_t width, std::size_t height) {
    const auto spread = [](std::uint64_t v) {  // inserts a zero between two bits
        std::uint64_t out = 0;
        for (int bit = 0; bit < 32; ++bit) out |= (v >> bit & 1) << (2 * bit);
        return out;
    };
    std::vector<std::uint32_t> pixels(width * height);
    std::iota(pixels.begin(), pixels.end(), 0u);
    std::vector<std::uint64_t> key(pixels.size());
    for (std::size_t i = 0; i < key.size(); ++i) key[i] = spread(i % width) | spread(i / width) << 1;
    std::sort(pixels.begin(), pixels.end(), [&](std::uint32_t a, std::uint32_t b) { return key[a] < key[b]; });
    return pixels;
}

/// Returns the variance of x - r from the samples of both: together where they have one distribution.
double variance_by_all(double n_x, double var_x, double n_r, double var_r, Estimators estimators) {
    if (estimators == Estimators::different) return var_x + var_r;
    return (n_x * n_x * var_x + n_r * n_r * var_r) / (n_x + n_r) * (1 / n_x + 1 / n_r);
}

struct Pool {
    double difference = 0, variance = 0;  // of x - r, from both variances
    // Sum of the magnitudes of the bins, of all samples together; variance of the difference from all samples.
    double mean = 0, expected_variance = 0;
    std::size_t pixel = 0, bin = 0;  // of its first bin
    bool empty = true;

    void add(const Pool& other) {
        if (empty) pixel = other.pixel, bin = other.bin;
        empty = empty && other.empty;
        difference += other.difference, variance += other.variance;
        mean += other.mean, expected_variance += other.expected_variance;
    }
    bool is_enough(double relative_error) const {
        return mean != 0 && std::sqrt(expected_variance) <= relative_error * std::abs(mean);
    }
};

}  // namespace

PoolTests test_pools(const SampledCube& x, const SampledCube& r, std::size_t width, std::size_t height,
                     std::size_t n_bins, Pooling pooling, double relative_error, Estimators estimators) {
    PoolTests tests;
    tests.name = pooling == Pooling::pixels ? "pools of pixels" : "bins of the image";
    const std::vector<std::uint32_t> order = z_order(width, height);
    const double n_x = x.samples, n_r = r.samples > 0 ? r.samples : x.samples, n = n_x + n_r;
    double sum = 0, squares = 0;
    for (std::size_t c = 0; c < 3; ++c) {
        Pool open, last;
        const auto close = [&] {
            const double variance = std::max(last.variance, last.expected_variance);
            if (!last.empty && (variance > 0 || last.difference != 0)) {
                const double z =
                    variance > 0 ? last.difference / std::sqrt(variance) : std::copysign(infinite, last.difference);
                ++tests.n;
                sum += z, squares += z * z;
                if (!(std::abs(z) <= std::abs(tests.worst_z))) {
                    tests.worst_z = z;
                    tests.worst_x = last.pixel % width, tests.worst_y = last.pixel / width;
                    tests.worst_bin = last.bin, tests.worst_channel = c;
                }
            }
            last = {};
        };
        for (std::size_t bin = 0; bin < n_bins; ++bin) {
            for (const std::uint32_t pixel : order) {
                const std::size_t i = (pixel * n_bins + bin) * 3 + c;
                const double mx = x.mean[i], mr = r.mean[i], vx = x.var_mean[i], vr = r.var_mean[i];
                if (mx == 0 && mr == 0) continue;
                Pool one;
                one.empty = false, one.pixel = pixel, one.bin = bin;
                one.difference = mx - mr, one.variance = vx + vr;
                one.mean = std::abs(n_x * mx + n_r * mr) / n;
                one.expected_variance = variance_by_all(n_x, vx, n_r, vr, estimators);
                open.add(one);
                if (pooling == Pooling::pixels && open.is_enough(relative_error)) {
                    close();
                    last = open;
                    open = {};
                }
            }
            if (open.is_enough(relative_error)) {
                close();
                last = open;
                open = {};
            } else if (!open.empty && !last.empty && last.bin == bin && pooling == Pooling::pixels) {
                last.add(open);
                open = {};
            }
        }
        last.add(open);
        close();
    }
    if (tests.n > 0) {
        tests.mean_z = sum / double(tests.n);
        tests.rms_z = std::sqrt(squares / double(tests.n));
        tests.p = corrected_p(student_p_value(tests.worst_z, infinite), double(tests.n));
    }
    return tests;
}

double test_pixels(std::span<const std::vector<float>> sums, std::span<const float> var_sums, double n_x,
                   std::span<const float> reference, std::span<const float> var_reference, double n_r,
                   Estimators estimators) {
    const bool welch = sums.size() > 1;
    if (!(n_r > 0)) n_r = n_x;
    double least = 1;
    std::vector<double> values(sums.size());
    for (std::size_t i = 0; i < reference.size(); ++i) {
        for (std::size_t k = 0; k < sums.size(); ++k) values[k] = double(sums[k][i]);
        Estimate difference;
        const double var_r = double(var_reference[i]);
        if (welch) {
            const Estimate ours = estimate_of(values);
            difference = {ours.mean, std::hypot(ours.se, std::sqrt(var_r)), ours.dof};
        } else {
            const double var_x = double(var_sums[i]);
            difference = {values[0],
                          std::sqrt(std::max(var_x + var_r, variance_by_all(n_x, var_x, n_r, var_r, estimators))),
                          infinite};
        }
        difference.mean -= double(reference[i]);
        const double p = difference.se > 0      ? student_p_value(difference.mean / difference.se, difference.dof)
                         : difference.mean == 0 ? 1
                                                : 0;
        least = std::min(least, p);
    }
    return corrected_p(least, double(reference.size()));
}

}  // namespace loom::compare
