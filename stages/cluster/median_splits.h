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
    std::uint32_t k = 16;                    // largest piece
    float normal_spread = infinite_spread;   // widest piece along each axis of the normals' half, in its units (w)
    std::uint64_t seed = 0;                  // where the larger half goes when a split cannot be even
    std::uint32_t second_graph = no_second;  // vertices from here on are of another graph than those before

    static constexpr std::uint32_t no_second = 0xffffffffu;
};

/// Cuts points into pieces of at most k, each cut across the axis in which the set is widest.
/// Across positions, so that the pieces on both sides get equal sizes (k or one less). Across normals, in the middle
/// of the range and not at the median: surfaces that meet at an edge come apart exactly there, however many points
/// each has; so pieces at edges can be smaller. A piece with k points or fewer is still cut while it is wider than
/// normal_spread.
/// in/out:  points  reordered: piece by piece, neighbouring pieces close together
/// out:     sizes   size of each piece, appended
/// Ties are broken by vertex, so that the pieces depend on the set alone and not on its order.
/// Of two graphs a piece has at most k points of either, and points at one place are in one piece, as far as no piece
/// would become too large; so what a path of one graph shares with its twin of the other is all in the same pieces.
void split_by_medians(std::span<Point> points, const Splits& splits, std::vector<std::uint32_t>& sizes);

/// The same cuts, found on a subset and then applied to all points: pieces of about equal size that are worked on
/// one after another. Piece i of the tree is before i + 1 in space as far as a line can say.
class Buckets {
  public:
    /// in: subset  reordered
    Buckets(std::span<Point> subset, std::uint32_t subset_per_bucket, std::uint64_t seed);

    std::size_t size() const { return n_buckets_; }
    /// Buckets of several points at once: each waits for its own next cut, so they wait together.
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
