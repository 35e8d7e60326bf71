#pragma once
// Next-event samples of first hits on lights that are seen wholly: points all over the light in place of one, without
// a ray. Most noise of the derivative of a histogram is that of L S' opl', which has both signs: light moves from bin to
// bin. Its mean over a light is much smaller than its values.
//
// Where no silhouette lies between a point and a light, the light is seen wholly or not at all; a stored edge to one of
// its points says which. If next-event estimation would then store an edge for every point of the light, the mean over
// the light replaces that of the stored point.

#include <array>
#include <optional>
#include <span>
#include <vector>

#include "stages/core/edges/edge_tree.h"
#include "stages/core/graph/graph_reader.h"
#include "stages/core/scene/scene.h"
#include "stages/core/scene/shading.h"
#include "stages/derive/clear_cells.h"

namespace loom::derive {

/// How lights that are seen wholly are sampled. Borrows the scene and the edges.
struct WholeLightOptions {
    const EdgeTree* edges = nullptr;  // of all shapes; null: stored points alone
    int points_per_side = 1;          // of a grid over the light
    std::uint64_t seed = 0;
    std::vector<char> lights = {};  // [emitter] usable_lights(); empty: they are found again

    int n_points() const { return points_per_side * points_per_side; }
    bool on() const { return edges != nullptr && points_per_side > 1; }
};

/// A point of a light.
struct WholeLightPoint {
    Point3<double> y;
    Normal3<double> n;
    Rgb<double> Li;
    double weight = 0;  // MIS weight / density / number of points
};

/// Returns the corners of a light that is a parallelogram, or of a square around one that is a disk.
std::array<Point3f, 4> corners_of_flat_light(const Shape& shape);
/// Returns, by emitter, whether a first hit may see it wholly: a rectangle, disk or ball without texture, which no surface
/// cuts. What cuts a light hides a part of it without a silhouette in front.
std::vector<char> usable_lights(const Scene& scene);

/// Finds such lights and draws their points. State of one thread.
class WholeLights {
  public:
    WholeLights(const Scene& scene, const WholeLightOptions& options);

    /// Draws points of the light of a stored next-event edge.
    /// in:      vertex     of the graph: its random numbers
    ///          shape_idx  of the vertex
    ///          pdf_bsdf_w, wi  of the stored edge: what is folded into the density of BSDF sampling
    /// out:     empty where the light may be partly hidden
    std::span<const WholeLightPoint> points(std::size_t vertex, std::uint32_t shape_idx, const ShadingPoint& at,
                                            std::size_t emitter_idx, float pdf_bsdf_w, const Vector3f& wi);

  private:
    bool is_seen(const ShadingPoint& at, std::uint32_t shape_idx, std::size_t emitter_idx);

    const Scene& scene_;
    WholeLightOptions options_;
    std::vector<std::array<Point3f, 4>> corners_;  // [emitter] corners_of_flat_light(), of usable ones
    std::vector<RoundBounds> rounds_;
    std::optional<ClearCells> cells_;
    std::vector<EdgeSegment> found_;
    std::vector<WholeLightPoint> points_;
};

}  // namespace loom::derive
