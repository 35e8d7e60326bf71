#pragma once
// Cells of flat surfaces with no edge between them and a flat light: from each of their points, no silhouette hides a part
// of it. One look serves all points of a cell.

#include <array>
#include <cstdint>
#include <unordered_map>
#include <vector>

#include "stages/core/edges/edge_tree.h"
#include "stages/core/scene/scene.h"

namespace loom::derive {

/// Nodes and blocks of edges to look at before a light counts as perhaps hidden.
inline constexpr std::size_t most_visits = 256;

/// A ball around a sphere or disk.
struct RoundBounds {
    std::uint32_t shape_idx;
    Point3<double> center;
    double radius;
};

/// Cells of the planes of shapes with few triangles: squares of a grid in the two coordinates that they are flattest in.
/// State of one thread; the answers do not depend on the questions before.
class ClearCells {
  public:
    /// in:      edges    of all shapes
    ///          rounds   bounds of all shapes without triangles
    ClearCells(const Scene& scene, const EdgeTree& edges, std::vector<RoundBounds> rounds);

    /// in:      p, ng      a point of a shape and its unit normal, on the side of the light
    ///          corners    of the light, a parallelogram
    /// out:     true: no silhouette lies between the point's cell and the light; false: one may do so
    bool is_clear(const Point3f& p, const Normal3f& ng, std::uint32_t shape_idx, std::uint32_t light_shape_idx,
                  const std::array<Point3f, 4>& corners);

  private:
    struct Cell {
        std::uint32_t shape_idx, light_shape_idx;
        Normal3f ng;
        std::int32_t axis;                  // that is nearest to the normal
        std::array<std::int32_t, 3> place;  // along the other two axes, and along the normal

        bool operator==(const Cell&) const = default;
    };
    struct Hash {
        std::size_t operator()(const Cell& cell) const;
    };
    /// The corners of the cell, which bound all of its points.
    std::array<Point3<double>, 8> corners_of(const Cell& cell) const;
    bool look(const Cell& cell, const std::array<Point3f, 4>& light) const;

    const EdgeTree& edges_;
    std::vector<RoundBounds> rounds_;
    std::vector<char> has_cells_;  // [shape]
    double size_, thickness_;
    std::unordered_map<Cell, bool, Hash> known_;
};

}  // namespace loom::derive
