#pragma once
#include <algorithm>
#include <array>
#include <cstdint>
#include <limits>
#include <span>
#include <vector>

#include "stages/cluster/metric.h"

namespace loom::cluster {

inline constexpr float infinite_spread = std::numeric_limits<float>::infinity();

struct Splits {
    std::uint32_t k = 16;                    // largest number of points in a piece
    float normal_spread = infinite_spread;   // largest extent of a piece along each normal axis, in units of w
    std::uint64_t seed = 0;                  // decides which side gets the larger half of an uneven split
    std::uint32_t second_graph = no_second;  // vertices from this index on belong to the second graph

    static constexpr std::uint32_t no_second = 0xffffffffu;
};

/// Cuts points into pieces of at most k, each cut across the axis of largest extent.
///
/// A cut across positions gives both sides equal sizes (pieces of k or one less). A cut across normals is in the middle
/// of the range, not at the median: surfaces that share an edge are separated exactly there, at any ratio of their
/// points. Pieces at edges can therefore be smaller. A piece of k points or fewer is still cut while its extent exceeds
/// normal_spread. Ties are broken by vertex, so that the pieces depend on the set alone and not on its order.
///
/// For two graphs, a piece has at most k points of either. Points at one position are in one piece, unless it would
/// become too large. A path vertex of one graph and its counterpart in the other then share with the same pieces.
/// in/out:  points  reordered: piece by piece, neighbouring pieces close together
/// out:     sizes   size of each piece, appended
void split_by_medians(std::span<Point> points, const Splits& splits, std::vector<std::uint32_t>& sizes);

/// Cuts found on a subset and then applied to all points: buckets of about equal size, processed one after another.
/// Consecutive buckets are neighbours in space as far as a linear order allows.
class Buckets {
  public:
    /// in: subset  reordered in place
    Buckets(std::span<Point> subset, std::uint32_t subset_per_bucket, std::uint64_t seed);

    std::size_t size() const { return n_buckets_; }
    /// Finds the buckets of several points at once, so that the cache misses of their cuts overlap.
    static constexpr std::size_t batch = 16;
    void of(const std::array<Point, batch>& points, std::array<std::uint32_t, batch>& buckets) const {
        std::array<std::int32_t, batch> at{};
        std::int32_t any_inside = 0;
        while (any_inside >= 0) {
            any_inside = -1;
            for (std::size_t i = 0; i < batch; ++i) {
                const Cut& cut = cuts_[std::size_t(std::max(at[i], 0))];
                const std::int32_t next = cut.side[points[i].x[cut.axis] < cut.at ? 0 : 1];
                at[i] = at[i] < 0 ? at[i] : next;
                any_inside &= at[i];
            }
        }
        for (std::size_t i = 0; i < batch; ++i) buckets[i] = std::uint32_t(~at[i]);
    }

  private:
    struct Cut {
        float at;
        std::uint32_t axis;
        std::int32_t side[2];  // next cut, or ~bucket
    };
    std::int32_t cut(std::span<Point> points, std::uint32_t per_bucket, std::uint64_t key);

    std::vector<Cut> cuts_;
    std::size_t n_buckets_ = 0;
};

}  // namespace loom::cluster
