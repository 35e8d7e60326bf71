#include "stages/cluster/median_splits.h"

#include <algorithm>
#include <array>

#include "stages/core/sampling/sampler.h"

namespace loom::cluster {
namespace {

struct Extent {
    std::array<float, 6> low, high;
    float width(int axis) const { return high[std::size_t(axis)] - low[std::size_t(axis)]; }
    int widest(int begin, int end) const {
        int best = begin;
        for (int axis = begin + 1; axis < end; ++axis)
            if (width(axis) > width(best)) best = axis;
        return best;
    }
};

Extent extent_of(std::span<const Point> points) {
    Extent e{points[0].x, points[0].x};
    for (const Point& p : points) {
        for (std::size_t c = 0; c < 6; ++c) {
            e.low[c] = std::min(e.low[c], p.x[c]);
            e.high[c] = std::max(e.high[c], p.x[c]);
        }
    }
    return e;
}

/// Moves the points with the n_left smallest coordinates to the front. The range is binned, so that only points of one
/// bin are compared, and points are moved without a branch.
class Divider {
  public:
    void operator()(std::span<Point> points, int axis, std::size_t n_left, float low, float high) {
        const auto c = std::size_t(axis);
        if (points.size() <= compared || !(high - low > 1e-30f)) {
            select(points, c, n_left);
            return;
        }
        bins_.resize(points.size());
        std::array<std::uint32_t, n_bins> counts{};
        const float scale = float(n_bins) / (high - low);
        for (std::size_t i = 0; i < points.size(); ++i) {
            bins_[i] = std::uint8_t(std::min(int((points[i].x[c] - low) * scale), n_bins - 1));
            ++counts[bins_[i]];
        }
        std::size_t bin = 0, below = 0;
        while (below + counts[bin] <= n_left) below += counts[bin++];
        spare_.assign(points.begin(), points.end());
        std::array<std::size_t, 3> next{0, below, below + counts[bin]};
        for (std::size_t i = 0; i < points.size(); ++i)
            points[next[std::size_t(bins_[i] >= bin) + std::size_t(bins_[i] > bin)]++] = spare_[i];
        select(points.subspan(below, counts[bin]), c, n_left - below);
    }

  private:
    static constexpr int n_bins = 256;
    static constexpr std::size_t compared = 48;  // below this number of points comparing is faster than counting

    static void select(std::span<Point> points, std::size_t c, std::size_t n_left) {
        std::nth_element(points.begin(), points.begin() + std::ptrdiff_t(n_left), points.end(),
                         [c](const Point& a, const Point& b) {
                             return a.x[c] < b.x[c] || (a.x[c] == b.x[c] && a.vertex < b.vertex);
                         });
    }

    std::vector<Point> spare_;
    std::vector<std::uint8_t> bins_;
};
/// Kept by each thread, because a new one per bucket would first-touch as many pages as the bucket has.
thread_local Divider divide;

/// Moves the points below the middle of the range to the front; neither side is empty.
std::size_t divide_range(std::span<Point> points, int axis, float low, float high) {
    const auto c = std::size_t(axis);
    float middle = low + (high - low) * 0.5f;
    if (!(middle < high)) middle = low;  // adjacent floats
    const auto right = std::partition(points.begin(), points.end(), [=](const Point& p) { return p.x[c] <= middle; });
    return std::size_t(right - points.begin());
}

/// Moves a cut to the nearest change of value, so that points at one position stay together.
/// needs: sorted sides: each of the first n_left is at most as large as the others
/// out: n_left; unchanged where all values are equal
std::size_t off_ties(std::span<Point> points, std::size_t c, std::size_t n_left) {
    float at = points[n_left].x[c];
    for (const Point& p : points.subspan(n_left)) at = std::min(at, p.x[c]);
    const auto not_left = std::partition(points.begin(), points.end(), [=](const Point& p) { return p.x[c] < at; });
    const auto right = std::partition(not_left, points.end(), [=](const Point& p) { return p.x[c] == at; });
    const auto below = std::size_t(not_left - points.begin()), through = std::size_t(right - points.begin());
    if (below == 0 && through == points.size()) return n_left;
    if (below == 0) return through;
    if (through == points.size()) return below;
    return n_left - below <= through - n_left ? below : through;
}

class Splitter {
  public:
    Splitter(const Splits& splits, std::vector<std::uint32_t>& sizes) : splits_(splits), sizes_(sizes) {}

    void split(std::span<Point> points, std::uint64_t key) {
        const std::size_t n = points.size();
        if (n == 0) return;
        if (n == 1) {
            sizes_.push_back(1);
            return;
        }
        const Extent extent = extent_of(points);
        const int normal = extent.widest(3, 6);
        const std::size_t n_counted = counted(points);
        const bool small = n_counted <= splits_.k;
        if (small && !(extent.width(normal) > splits_.normal_spread)) {
            // In the order of the graph: equally random for the image, and better for caches.
            std::sort(points.begin(), points.end(), [](const Point& a, const Point& b) { return a.vertex < b.vertex; });
            sizes_.push_back(std::uint32_t(n));
            return;
        }
        const int position = extent.widest(0, 3);
        std::size_t n_left;
        if (small || extent.width(normal) > extent.width(position)) {
            n_left = divide_range(points, normal, extent.low[std::size_t(normal)], extent.high[std::size_t(normal)]);
        } else if (joint() && !(extent.width(position) > 0)) {
            n_left = divide_place(points);
        } else {
            const std::size_t n_pieces = (n_counted + splits_.k - 1) / splits_.k;
            const std::size_t left_pieces = (n_pieces + (mix64(key) & 1)) / 2;
            n_left = std::clamp<std::size_t>(n * left_pieces / n_pieces, 1, n - 1);
            divide(points, position, n_left, extent.low[std::size_t(position)], extent.high[std::size_t(position)]);
            if (joint()) n_left = off_ties(points, std::size_t(position), n_left);
        }
        split(points.first(n_left), 2 * key + 1);
        split(points.subspan(n_left), 2 * key + 2);
    }

  private:
    bool joint() const { return splits_.second_graph != Splits::no_second; }
    bool of_second(const Point& p) const { return p.vertex >= splits_.second_graph; }

    /// Returns the number of points of the graph that has more of them here.
    std::size_t counted(std::span<const Point> points) const {
        if (!joint()) return points.size();
        const auto n_second =
            std::size_t(std::ranges::count_if(points, [this](const Point& p) { return of_second(p); }));
        return std::max(n_second, points.size() - n_second);
    }

    /// Divides too many points at one position: half of each graph's, in its order.
    std::size_t divide_place(std::span<Point> points) {
        std::sort(points.begin(), points.end(), [](const Point& a, const Point& b) { return a.vertex < b.vertex; });
        const auto second = std::ranges::partition_point(points, [this](const Point& p) { return !of_second(p); });
        const auto n_first = second - points.begin(), n_second = points.end() - second;
        std::rotate(points.begin() + n_first / 2, second, second + n_second / 2);
        return std::size_t(n_first / 2 + n_second / 2);
    }

    const Splits& splits_;
    std::vector<std::uint32_t>& sizes_;
};

}  // namespace

void split_by_medians(std::span<Point> points, const Splits& splits, std::vector<std::uint32_t>& sizes) {
    Splitter(splits, sizes).split(points, splits.seed);
}

Buckets::Buckets(std::span<Point> subset, std::uint32_t subset_per_bucket, std::uint64_t seed) {
    if (subset.size() <= subset_per_bucket) {  // one bucket: a cut with equal sides
        cuts_.push_back({0, 0, {~0, ~0}});
        n_buckets_ = 1;
    } else {
        cut(subset, subset_per_bucket, seed);
    }
}

std::int32_t Buckets::cut(std::span<Point> points, std::uint32_t per_bucket, std::uint64_t key) {
    const std::size_t n = points.size();
    if (n <= per_bucket) return ~std::int32_t(n_buckets_++);
    const Extent extent = extent_of(points);
    const int normal = extent.widest(3, 6), position = extent.widest(0, 3);
    const bool by_normal = extent.width(normal) > extent.width(position);
    const auto axis = std::size_t(by_normal ? normal : position);
    std::size_t n_left;
    if (by_normal) {
        n_left = divide_range(points, normal, extent.low[axis], extent.high[axis]);
    } else {
        // Cut off the median by up to a tenth, so that borders of the largest pieces differ from pass to pass too.
        const double part = 0.4 + 0.2 * double(unit_float(std::uint32_t(mix64(key) >> 32)));
        n_left = std::clamp<std::size_t>(std::size_t(part * double(n)), 1, n - 1);
        divide(points, position, n_left, extent.low[axis], extent.high[axis]);
    }
    float at = points[n_left].x[axis];
    for (const Point& p : points.subspan(n_left)) at = std::min(at, p.x[axis]);
    const std::size_t mine = cuts_.size();
    cuts_.push_back({at, std::uint32_t(axis), {}});
    for (const int side : {0, 1}) {
        const auto part = side == 0 ? points.first(n_left) : points.subspan(n_left);
        const std::int32_t child = cut(part, per_bucket, 2 * key + 1 + std::uint64_t(side));
        cuts_[mine].side[side] = child;
    }
    return std::int32_t(mine);
}

}  // namespace loom::cluster
