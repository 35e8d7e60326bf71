#pragma once
#include <cstdint>

namespace loom {

/// Running mean and sum of squared deviations; numerically stable.      [Welford1962]
struct Moments {
    double mean = 0, m2 = 0;
    std::uint64_t n = 0;

    void add(double x) {
        ++n;
        const double delta = x - mean;
        mean += delta / double(n);
        m2 += delta * (x - mean);
    }
    double var_sample() const { return n > 1 ? m2 / double(n - 1) : 0; }
    double var_mean() const { return n > 1 ? var_sample() / double(n) : 0; }
};

}  // namespace loom
