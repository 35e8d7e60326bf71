#pragma once
#include <cstdint>
#include <limits>
#include <span>
#include <vector>

#include "stages/cluster/metric.h"

namespace loom::cluster {

inline constexpr float infinite_spread = std::numeric_limits<float>::infinity();

struct Splits {
    std::uint32_t k = 16;                   // largest piece
    float normal_spread = infinite_spread;  // widest piece along each axis of the normals' half, in its units (w)
    std::uint64_t seed = 0;                 // where the larger half goes when a split cannot be even
};

/// Cuts points into pieces of at most k, each cut across the axis in which the set is widest.
/// Across positions, so that the pieces on both sides get equal sizes (k or one less). Across normals, in the middle
/// of the range and not at the median: surfaces that meet at an edge come apart exactly there, however many points
/// each has; so pieces at edges can be smaller. A piece with k points or fewer is still cut while it is wider than
/// normal_spread.
/// in/out:  points  reordered: piece by piece, neighbouring pieces close together
/// out:     sizes   size of each piece, appended
/// Ties are broken by vertex, so that the pieces depend on the set alone and not on its order.
void split_by_medians(std::span<Point> points, const Splits& splits, std::vector<std::uint32_t>& sizes);

/// The same cuts, found on a subset and then applied to all points: pieces of about equal size that are worked on
/// one after another. Piece i of the tree is before i + 1 in space as far as a line can say.
class Buckets {
  public:
    /// in: subset  reordered
    Buckets(std::span<Point> subset, std::uint32_t subset_per_bucket, std::uint64_t seed);

    std::size_t size() const { return n_buckets_; }
    std::uint32_t of(const Point& point) const {
        std::int32_t at = 0;
        while (at >= 0) {
            const Cut& cut = cuts_[std::size_t(at)];
            at = cut.side[point.x[cut.axis] < cut.at ? 0 : 1];
        }
        return std::uint32_t(~at);
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
