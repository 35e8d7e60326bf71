#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "stages/core/math/vector.h"
#include "stages/frames/frames.h"

namespace loom::frames {

double luminance_of(const TransientCube& cube, std::size_t pixel, std::size_t bin) {
    const float* rgb = cube.radiance.data() + 3 * (pixel * cube.time.n_bins + bin);
    return luminance(Rgb<double>(rgb[0], rgb[1], rgb[2]));
}

double time_of(const TransientCube& cube, double bin) {
    return cube.in_unit(cube.time.start_opl + bin * cube.time.bin_width_opl + cube.time.gate_opl / 2);
}

std::string time_unit(const TransientCubeHeader& header) {
    return header.time.unit == "ns" ? "ns" : header.time.metres_per_unit == 1 ? "m" : "units of the scene";
}

std::string time_words(const TransientCubeHeader& header) {
    return (header.time.unit == "ns" ? "time of flight (" : "optical path length (") + time_unit(header) + ")";
}

double luminance_quantile(const TransientCube& cube, double share) {
    std::vector<float> lit;
    for (std::size_t pixel = 0; pixel < cube.n_pixels(); ++pixel)
        for (std::size_t bin = 0; bin < cube.time.n_bins; ++bin)
            if (const double Y = luminance_of(cube, pixel, bin); Y > 0 && std::isfinite(Y)) lit.push_back(float(Y));
    if (lit.empty()) return 0;
    const auto at = lit.begin() + std::ptrdiff_t(share * double(lit.size() - 1));
    std::nth_element(lit.begin(), at, lit.end());
    return double(*at);
}

std::vector<float> peak_times(const TransientCube& cube) {
    const std::size_t n = cube.n_pixels(), bins = cube.time.n_bins;
    std::vector<float> times(n, std::numeric_limits<float>::quiet_NaN());
    std::vector<double> sums(n);
    constexpr std::array<double, 5> weights{1, 4, 6, 4, 1};
    for (std::size_t pixel = 0; pixel < n; ++pixel) {
        double most = 0;
        for (std::size_t bin = 0; bin < bins; ++bin) {
            sums[pixel] += luminance_of(cube, pixel, bin);
            double smooth = 0;
            for (std::size_t k = 0; k < weights.size(); ++k)
                if (bin + k >= 2 && bin + k < bins + 2) smooth += weights[k] * luminance_of(cube, pixel, bin + k - 2);
            if (smooth > most) {
                most = smooth;
                times[pixel] = float(time_of(cube, double(bin)));
            }
        }
    }
    std::vector<double> lit;
    for (double sum : sums)
        if (sum > 0) lit.push_back(sum);
    if (lit.empty()) return times;
    const auto median = lit.begin() + std::ptrdiff_t(lit.size() / 2);
    std::nth_element(lit.begin(), median, lit.end());
    for (std::size_t pixel = 0; pixel < n; ++pixel)
        if (!(sums[pixel] > 0.01 * *median)) times[pixel] = std::numeric_limits<float>::quiet_NaN();
    return times;
}

std::vector<std::size_t> strip_bins(const TransientCube& cube, std::size_t count) {
    const std::size_t bins = cube.time.n_bins;
    std::vector<double> light(bins);
    for (std::size_t pixel = 0; pixel < cube.n_pixels(); ++pixel) {
        double sum = 0;
        for (std::size_t bin = 0; bin < bins; ++bin) sum += luminance_of(cube, pixel, bin);
        if (!(sum > 0) || !std::isfinite(sum)) continue;
        for (std::size_t bin = 0; bin < bins; ++bin) light[bin] += luminance_of(cube, pixel, bin) / sum;
    }
    double all = 0;
    for (double l : light) all += l;
    std::size_t first = 0, last = bins - 1;
    double seen = 0;
    for (std::size_t bin = 0; bin < bins && all > 0; ++bin) {
        if (seen < 0.005 * all) first = bin;
        if (seen < 0.9 * all) last = bin;
        seen += light[bin];
    }
    count = std::clamp<std::size_t>(count, 1, last - first + 1);
    std::vector<std::size_t> chosen;
    for (std::size_t i = 0; i < count; ++i)
        chosen.push_back(first + (count == 1 ? 0 : (i * (last - first) + (count - 1) / 2) / (count - 1)));
    return chosen;
}

}  // namespace loom::frames
