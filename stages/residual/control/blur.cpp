#include "stages/residual/control/blur.h"

#include <algorithm>
#include <cmath>
#include <cstdint>

namespace loom::residual {
namespace {

constexpr double deviation = 2;
constexpr int reach = 5;

}  // namespace

std::vector<double> blurred(const Sensor& sensor, const std::vector<double>& values, bool without_own) {
    const auto width = std::size_t(sensor.width), height = std::size_t(sensor.height);
    double weights[2 * reach + 1];
    for (int d = -reach; d <= reach; ++d) weights[d + reach] = std::exp(-0.5 * (d / deviation) * (d / deviation));
    // Sums of the kernel over the existing pixels along a line of n.
    const auto norms = [&](std::size_t n) {
        std::vector<double> all(n);
        for (std::size_t i = 0; i < n; ++i)
            for (int d = -reach; d <= reach; ++d)
                if (std::int64_t(i) + d >= 0 && std::int64_t(i) + d < std::int64_t(n)) all[i] += weights[d + reach];
        return all;
    };
    const std::vector<double> norm_x = norms(width), norm_y = norms(height);
    const auto along = [&](const std::vector<double>& in, std::size_t n, std::size_t step, std::size_t n_lines,
                           std::size_t line_step, const std::vector<double>& norm) {
        std::vector<double> out(in.size());
        for (std::size_t line = 0; line < n_lines; ++line)
            for (std::size_t i = 0; i < n; ++i) {
                double sum = 0;
                const int first = -int(std::min<std::size_t>(i, reach)),
                          last = int(std::min<std::size_t>(n - 1 - i, reach));
                for (int d = first; d <= last; ++d)
                    sum += weights[d + reach] * in[line * line_step + std::size_t(std::int64_t(i) + d) * step];
                out[line * line_step + i * step] = sum / norm[i];
            }
        return out;
    };
    std::vector<double> out = along(along(values, width, 1, height, width, norm_x), height, width, width, 1, norm_y);
    if (!without_own) return out;
    for (std::size_t y = 0; y < height; ++y)
        for (std::size_t x = 0; x < width; ++x) {
            const std::size_t p = y * width + x;
            const double own = 1 / (norm_x[x] * norm_y[y]);
            out[p] = own < 1 ? std::max((out[p] - own * values[p]) / (1 - own), 0.0) : 0;
        }
    return out;
}

}  // namespace loom::residual
