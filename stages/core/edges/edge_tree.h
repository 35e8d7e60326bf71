#pragma once
// A tree over edges that lists the silhouettes within a shaft.

#include <algorithm>
#include <array>
#include <cstdint>
#include <functional>
#include <optional>
#include <span>
#include <vector>

#include "stages/core/edges/edges.h"
#include "stages/core/edges/shaft.h"

namespace loom {

/// All p with n . p + offset >= 0.
struct HalfSpace {
    Vector3<double> n;
    double offset = 0;
};

/// Some edges, seen from afar.
struct EdgeCluster {
    Point3<double> center;
    double half2 = 0;               // square of half the diagonal of their box, m^2
    double length = 0, motion = 0;  // sums of length, m, and of length times speed

    /// Returns about the sum of length times speed over squared distance.
    /// in:      end_speed  added to the speed of each edge
    double motion_around(const Point3<double>& eye, double end_speed) const {
        const double sum = motion + end_speed * length;
        return sum > 0 ? sum / std::max(length2(center - eye), half2) : 0;
    }
};

/// Part of a silhouette within a shaft.
struct EdgeSegment {
    double s0 = 0, s1 = 0;  // by the parameter of the edge, s0 < s1
    std::uint32_t edge_idx = 0;
    float length = 0;  // m
    float share = 1;   // probability to be listed
};

/// Four-wide tree of boxes and cones of normals. A node is skipped where its box is outside of the shaft, or where the
/// cone shows that all its edges have both faces towards the eye, or both away. A cone needs no more than lines: the
/// normals of an edge may both be reversed without a change of its silhouette, so the two sides of a thin sheet share a
/// narrow cone.                                        [Johnson2001] "Spatialized Normal Cone Hierarchies"
class EdgeTree {
  public:
    EdgeTree() = default;
    /// Reorders the edges; the result depends on the arguments and their order only.
    /// in:      speeds  by edge, of any unit, for collect_some(); empty: all at rest
    explicit EdgeTree(EdgeSet set, std::span<const float> speeds = {});

    const EdgeSet& set() const { return set_; }
    const Edge& edge(std::uint32_t edge_idx) const { return set_.edges[edge_idx]; }
    std::size_t n_edges() const { return set_.edges.size(); }

    /// Lists the silhouettes, as seen from the apex of a shaft, clipped to it. Thread-safe; reuse `found`, which then
    /// needs no allocation.
    /// in:      most  number of nodes and blocks after which to give up
    /// out:     found  replaced; ascending by edge. Returns the number of nodes and blocks visited: more than `most` where
    ///                 segments are missing
    std::size_t collect(const Shaft& shaft, std::vector<EdgeSegment>& found, std::size_t most = SIZE_MAX) const;
    /// Lists a random part of the silhouettes: about those of `n_blocks` blocks, which it reaches by dividing their number
    /// between the open children of each node. Four fifths are divided in proportion to length times speed over squared
    /// distance, the rest to length over squared distance, for what is behind an edge may move, too. A child whose part
    /// is below 1 is entered with that probability, systematically, so that siblings exclude each other. Takes
    /// O(n_blocks log n).
    /// in:      end_speed  of the ends of lines of sight, added to that of each edge
    ///          seed       of its random numbers
    /// out:     as collect(); EdgeSegment::share is set, and sums of values / share are unbiased
    std::size_t collect_some(const Shaft& shaft, double n_blocks, double end_speed, std::uint64_t seed,
                             std::vector<EdgeSegment>& found) const;

    /// EdgeCluster::motion_around() of all edges, from a few clusters.
    double motion_around(const Point3<double>& eye, double end_speed) const;

    /// Whether a part of any edge, silhouette or not, lies in all of some half-spaces. Also true where that is not known
    /// after as many nodes and blocks as `most`.
    bool any_inside(std::span<const HalfSpace> region, std::size_t most) const;
    /// Returns an edge, silhouette or not, that a point is near to, if it is wanted.
    std::optional<std::uint32_t> find_near(const Point3<double>& p, double distance,
                                           const std::function<bool(std::uint32_t)>& wanted) const;

    static constexpr int width = 4;

  private:
    using Lanes = std::array<float, width>;
    struct Node {
        alignas(16) std::array<Lanes, 3> center, half;  // boxes of the children, m
        alignas(16) std::array<Lanes, 3> axis;          // unit
        // Normals n are within an angle of the axis or its reverse: its cosine, and the square of its sine. Over all
        // edge points a, n . (a - center) <= above, -n . (a - center) <= below, m.
        alignas(16) Lanes cos, sin2, above, below;
        Lanes edge_length, edge_motion;  // sums over the edges of length, and length times speed
        std::array<std::uint32_t, width> child;
        int n_children = 0;
    };
    /// Edges [4 i, 4 i + 4) for the test of silhouettes within a shaft.
    struct Block {
        alignas(16) std::array<Lanes, 3> a, b, n0, n1;
    };
    /// A child of a node, or all edges.
    struct Part {
        EdgeCluster edges;
        std::uint32_t at = 0;
    };
    struct Query;
    struct Builder;

    void split_part(std::uint32_t node_idx);
    /// Splits the one part that holds all edges.
    void find_parts();

    /// Whether any edge is wanted, of those in nodes that are not apart; also true after `most` nodes and blocks.
    template <class Apart, class IsWanted>
    bool any_edge(Apart&& apart, IsWanted&& is_wanted, std::size_t most = SIZE_MAX) const;
    static unsigned open_children(const Node& node, const Query& query);
    static unsigned possible_silhouettes(const Block& block, const Query& query);
    void list(std::uint32_t block_idx, const Shaft& shaft, const Query& query, float share,
              std::vector<EdgeSegment>& found) const;

    static constexpr std::uint32_t is_block = 1u << 31;
    static constexpr std::size_t stack_size = 256;

    EdgeSet set_;
    std::vector<Node> nodes_;  // a child: an index, or that of a block with the bit is_block
    std::vector<Block> blocks_;
    std::uint32_t root_ = 0;
    std::vector<Part> parts_;  // a few that hold all edges
};

}  // namespace loom
