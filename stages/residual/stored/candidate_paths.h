#pragma once
// Candidates among a graph's paths that an edit may touch, by boxes around its changes. The others need no further
// test.

#include <algorithm>
#include <cstdint>
#include <span>
#include <vector>

#include "formats/path_graph.h"
#include "stages/core/edit/edit_reach.h"
#include "stages/core/tracing/segment_columns.h"

namespace loom::residual {

/// Returns the first of the rows [begin, end) that belongs to vertex j or a later one; `end` if there is none.
inline std::size_t first_row(std::span<const std::uint32_t> vertex, std::size_t j, std::size_t begin, std::size_t end) {
    return std::size_t(
        std::lower_bound(vertex.begin() + std::ptrdiff_t(begin), vertex.begin() + std::ptrdiff_t(end), j) -
        vertex.begin());
}
inline std::size_t first_row(std::span<const std::uint32_t> vertex, std::size_t j, std::size_t begin = 0) {
    return first_row(vertex, j, begin, vertex.size());
}

/// Reads the rows of a graph sequentially, without scene or random streams, so that a path costs only the reading of
/// its bytes. State of one thread.
class CandidatePaths {
  public:
    CandidatePaths(const Scene& old_scene, const EditReach& reach, const PathGraph& graph);

    /// False when all paths are candidates, because the graph stores no misses and the edit requires them.
    bool tells() const { return tells_; }
    /// in:      begin, end  paths of the graph
    /// out:     may         [path] 0: TouchedPaths would find that the edit does not touch it
    void find(std::size_t begin, std::size_t end, std::uint8_t* may);
    /// After find(), for a row of its vertices: false if the vertex, its arriving and its leaving rays need no test.
    bool may_touch(std::size_t vertex) const { return !tells_ || met_[vertex - first_] != 0; }
    /// The same, false also where only its light or the end of its last ray has changed.
    bool may_meet(std::size_t vertex) const { return !tells_ || (met_[vertex - first_] & meets) != 0; }
    /// Returns the row of misses of a vertex with a failed light sample, if the graph has misses and may_touch().
    std::size_t miss_of(std::size_t vertex) const { return miss_of_[vertex - first_]; }

  private:
    static constexpr std::uint8_t meets = 1, other_light = 2;  // bits of met_
    void arrivals(std::size_t begin, std::size_t end);
    void light_edges(std::size_t last_vertex);
    void misses(std::size_t last_vertex);
    /// Sets segments from vertex[i] to y[4 i], y[4 i + 1], ..., or along that direction where y[4 i + 3] is 0; i < n.
    void fill(std::size_t n, const std::uint32_t* vertex, const float* y);
    /// Tests the first n segments.
    void answer(std::size_t n, const Obstacles& obstacles);
    void mark(std::size_t n) {
        for (std::size_t i = 0; i < n; ++i) met_[vertices_[i]] |= segments_.met[i];
    }
    void room(std::size_t n);

    const EditReach& reach_;
    const PathGraph& graph_;
    Point3f camera_;
    bool any_shape_ = false, tells_ = true;
    SegmentColumns segments_{0};
    std::vector<std::uint32_t> vertices_;  // [segment] vertex in the block
    std::size_t first_ = 0;                // first vertex of the block
    std::vector<std::uint8_t> met_;        // [vertex of the block]
    std::vector<std::uint32_t> miss_of_;   // [vertex of the block] the first of its misses
};

}  // namespace loom::residual
