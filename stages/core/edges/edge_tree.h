#pragma once
// A tree over edges that lists the silhouettes within a shaft.

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "stages/core/edges/edges.h"
#include "stages/core/edges/shaft.h"

namespace loom {

/// Part of a silhouette within a shaft.
struct EdgeSegment {
    double s0 = 0, s1 = 0;  // by the parameter of the edge, s0 < s1
    std::uint32_t edge_idx = 0;
    float length = 0;  // m
};

/// Four-wide tree of boxes and cones of normals. A node is skipped where its box is outside of the shaft, or where the
/// cone shows that all its edges have both faces towards the eye, or both away. A cone needs no more than lines: the
/// normals of an edge may both be reversed without a change of its silhouette, so the two sides of a thin sheet share a
/// narrow cone.                                        [Johnson2001] "Spatialized Normal Cone Hierarchies"
class EdgeTree {
  public:
    EdgeTree() = default;
    /// Reorders the edges; the result depends on them and their order only.
    explicit EdgeTree(EdgeSet set);

    const EdgeSet& set() const { return set_; }
    const Edge& edge(std::uint32_t edge_idx) const { return set_.edges[edge_idx]; }
    std::size_t n_edges() const { return set_.edges.size(); }

    /// Lists the silhouettes, as seen from the apex of a shaft, clipped to it. Thread-safe; reuse `found`, which then
    /// needs no allocation.
    /// out:     found  replaced; ascending by edge
    void collect(const Shaft& shaft, std::vector<EdgeSegment>& found) const;

    static constexpr int width = 4;

  private:
    using Lanes = std::array<float, width>;
    struct Node {
        alignas(16) std::array<Lanes, 3> center, half;  // boxes of the children, m
        alignas(16) std::array<Lanes, 3> axis;          // unit
        // Normals n are within an angle of the axis or its reverse: its cosine, and the square of its sine. Over all
        // edge points a, n . (a - center) <= above, -n . (a - center) <= below, m.
        alignas(16) Lanes cos, sin2, above, below;
        std::array<std::uint32_t, width> child;
        int n_children = 0;
    };
    /// Edges [4 i, 4 i + 4) for the test of silhouettes.
    struct Block {
        alignas(16) std::array<Lanes, 3> a, n0, n1;
    };
    struct Query;
    struct Builder;

    static unsigned open_children(const Node& node, const Query& query);
    static unsigned possible_silhouettes(const Block& block, const Query& query);

    static constexpr std::uint32_t is_block = 1u << 31;
    static constexpr std::size_t stack_size = 256;

    EdgeSet set_;
    std::vector<Node> nodes_;  // a child: an index, or that of a block with the bit is_block
    std::vector<Block> blocks_;
    std::uint32_t root_ = 0;
};

}  // namespace loom
