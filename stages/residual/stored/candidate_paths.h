#pragma once
// Which paths of a graph an edit may touch, by boxes around what it changes: what is left over need not be asked for.

#include <algorithm>
#include <cstdint>
#include <span>
#include <vector>

#include "formats/path_graph.h"
#include "stages/core/edit/edit_reach.h"
#include "stages/core/tracing/segment_columns.h"

namespace loom::residual {

/// First of the rows [begin, end) that belongs to vertex j or a later one; `end` if there is none.
inline std::size_t first_row(std::span<const std::uint32_t> vertex, std::size_t j, std::size_t begin, std::size_t end) {
    return std::size_t(
        std::lower_bound(vertex.begin() + std::ptrdiff_t(begin), vertex.begin() + std::ptrdiff_t(end), j) -
        vertex.begin());
}
inline std::size_t first_row(std::span<const std::uint32_t> vertex, std::size_t j, std::size_t begin = 0) {
    return first_row(vertex, j, begin, vertex.size());
}

/// Reads the rows of a graph one after the other and nothing of scene or random numbers, so that a path costs as little
/// as its bytes. One belongs to one thread.
class CandidatePaths {
  public:
    CandidatePaths(const Scene& old_scene, const EditReach& reach, const PathGraph& graph);

    /// False: all paths count as candidates, for the graph has no misses and the edit asks for them.
    bool tells() const { return tells_; }
    /// in:      begin, end  paths of the graph
    /// out:     may         by path, 0: TouchedPaths would find that the edit does not touch it
    void find(std::size_t begin, std::size_t end, std::uint8_t* may);
    /// After find(), for a row of its vertices: 0 if neither the vertex nor what leaves it or leads to it need be
    /// looked at.
    bool may_touch(std::size_t vertex) const { return !tells_ || met_[vertex - first_] != 0; }
    /// Row of misses of a vertex whose light sample was not seen, if the graph has them and may_touch().
    std::size_t miss_of(std::size_t vertex) const { return miss_of_[vertex - first_]; }

  private:
    void arrivals(std::size_t begin, std::size_t end);
    void light_edges(std::size_t last_vertex);
    void misses(std::size_t last_vertex);
    /// Segments to y[4 i], y[4 i + 1], ... of vertex[i], i < n, or along it where y[4 i + 3] is 0.
    void fill(std::size_t n, const std::uint32_t* vertex, const float* y);
    /// Asks for the first n segments.
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
    std::vector<std::uint32_t> vertices_;  // by segment: its vertex in the block
    std::size_t first_ = 0;                // vertex of the block
    std::vector<std::uint8_t> met_;        // by vertex of the block
    std::vector<std::uint32_t> miss_of_;   // by vertex of the block: the first of its misses
};

}  // namespace loom::residual
