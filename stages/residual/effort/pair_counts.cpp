#include "stages/residual/effort/pair_counts.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>

#include "stages/core/sampling/streams.h"
#include "stages/residual/control/blur.h"

namespace loom::residual {
namespace {

constexpr std::uint32_t tile = 4;  // pixels per side
/// Pairs around a pixel that say as much of it as the mean of all pixels does; fewer say little, as most bring nothing.
constexpr double pairs_of_all = 4;

/// Calls visit(pixel) for all pixels, tile by tile.
template <class Visit>
void for_each_in_tiles(const Sensor& sensor, std::uint64_t seed, Visit&& visit) {
    std::array<std::pair<std::uint64_t, std::size_t>, tile * tile> order;
    for (std::uint32_t y0 = 0; y0 < sensor.height; y0 += tile)
        for (std::uint32_t x0 = 0; x0 < sensor.width; x0 += tile) {
            std::size_t n = 0;
            for (std::uint32_t y = y0; y < std::min(y0 + tile, sensor.height); ++y)
                for (std::uint32_t x = x0; x < std::min(x0 + tile, sensor.width); ++x) {
                    const std::size_t pixel = std::size_t(y) * sensor.width + x;
                    order[n++] = {streams::numbered(seed, pixel + 1), pixel};
                }
            std::sort(order.begin(), order.begin() + std::ptrdiff_t(n));
            for (std::size_t i = 0; i < n; ++i) visit(order[i].second);
        }
}

}  // namespace

std::uint64_t PairCounts::all() const {
    return std::accumulate(pairs.begin(), pairs.end(), std::uint64_t{0});
}

std::vector<std::uint32_t> dithered(const Sensor& sensor, const std::vector<double>& expected, std::uint64_t seed) {
    std::vector<std::uint32_t> pairs(expected.size());
    double carried = streams::selection(seed, 0);
    for_each_in_tiles(sensor, seed, [&](std::size_t pixel) {
        carried += expected[pixel];
        const double whole = std::floor(carried);
        pairs[pixel] = std::uint32_t(whole);
        carried -= whole;
    });
    return pairs;
}

PairCounts pairs_by_deviation(const Sensor& sensor, const std::vector<double>& variances, double mean,
                              std::uint64_t seed) {
    std::vector<double> deviations;
    for (const double v : variances) deviations.push_back(std::isfinite(v) && v > 0 ? std::sqrt(v) : 0);
    const double sum = std::accumulate(deviations.begin(), deviations.end(), 0.0);
    const std::vector<double> around = blurred(sensor, deviations, true);
    PairCounts counts;
    for (std::size_t p = 0; p < around.size(); ++p) {
        const double others = sum - deviations[p];
        counts.expected.push_back(around[p] > 0 && others > 0 ? mean * double(around.size() - 1) * around[p] / others
                                                              : 0);
    }
    counts.pairs = dithered(sensor, counts.expected, seed);
    return counts;
}

PairCounts pairs_by_size(const Sensor& sensor, const std::vector<double>& sums, const std::vector<std::uint32_t>& pairs,
                         const std::vector<std::uint8_t>& takes, double mean, std::uint64_t seed) {
    std::vector<double> sizes(sums.size()), n(sums.size());
    for (std::size_t p = 0; p < sums.size(); ++p) {
        if (!takes[p]) continue;
        sizes[p] = std::isfinite(sums[p]) ? sums[p] : 0;
        n[p] = double(pairs[p]);
    }
    const double all_sizes = std::accumulate(sizes.begin(), sizes.end(), 0.0),
                 all_n = std::accumulate(n.begin(), n.end(), 0.0);
    const std::vector<double> sizes_around = blurred(sensor, sizes, true), n_around = blurred(sensor, n, true);
    PairCounts counts;
    for (std::size_t p = 0; p < sums.size(); ++p) {
        const double other_sizes = all_sizes - sizes[p], other_n = all_n - n[p];
        if (!takes[p] || !(other_sizes > 0)) {
            counts.expected.push_back(takes[p] ? mean : 0);
            continue;
        }
        // The mean of all counts as much as so many pairs around.
        const double of_all = other_sizes / other_n;
        const double around =
            (blur_pixels * sizes_around[p] + pairs_of_all * of_all) / (blur_pixels * n_around[p] + pairs_of_all);
        counts.expected.push_back(mean * around / of_all);
    }
    counts.pairs = dithered(sensor, counts.expected, seed);
    return counts;
}

}  // namespace loom::residual
