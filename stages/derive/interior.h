#pragma once
// Derivatives of the light of stored paths, without tracing: the interior terms.               [TR Eqs. 9-15, 19-23]
//
// Each light edge brings L = product of factors. Densities and MIS weights are held at the present values of the
// parameters. A vertex moves with its shape (a material point, with the Jacobian of its area), except where the camera
// or a delta lobe determines the ray that reaches it: there it slides over its surface with that ray.

#include <functional>
#include <memory>
#include <span>

#include "formats/path_graph.h"
#include "stages/core/scene/shading.h"
#include "stages/derive/surface_motion.h"
#include "stages/derive/whole_lights.h"

namespace loom::derive {

/// Largest number of parameters of one run.
inline constexpr int max_parameters = 64;

/// Returns the first light edge after a path.
/// in:      edge  first light edge of the path
std::size_t next_path_edge(const PathGraph& graph, std::size_t path, std::size_t edge);

/// Rows of one light edge or path; arrays by parameter.
struct InteriorRow {
    std::uint32_t row;          // light edge, or path
    std::span<const float> dL;  // [parameter, rgb]
    std::span<const float> dopl;
};

/// State of one vertex of a stored path for boundary terms.
struct VertexState {
    std::size_t vertex = 0;
    const ShadingPoint* at = nullptr;
    Rgb<double> beta;                           // throughput from the camera to the vertex
    double opl = 0;                             // from the camera, phase indices
    double camera_opl = 0;                      // its share up to the first vertex
    std::span<const Vector3<double>> velocity;  // [parameter], m per unit
    std::span<const Vector3<double>> turn;      // [parameter]: angular velocity of the shading frame, rad per unit
};

/// Walks along stored paths with their derivatives. Borrows all arguments of the constructor; one per thread.
class InteriorWalker {
  public:
    InteriorWalker(const PathGraph& graph, const Scene& scene, const SceneTangents& tangents,
                   const Attached& attached = {}, const WholeLightOptions& whole = {});
    ~InteriorWalker();
    InteriorWalker(InteriorWalker&&) noexcept;

    using OnRow = std::function<void(const InteriorRow&)>;
    using OnVertex = std::function<void(const VertexState&)>;
    /// Whether anything that a path touches depends on a parameter.
    bool touches(std::size_t path) const;
    /// in:      edge  first light edge of the path; out: that of the next path
    void walk(std::size_t path, std::size_t& edge, const OnRow& on_edge, const OnRow& on_seen) const;
    /// Writes InteriorRows one after the other.
    struct RowWriter {
        std::uint32_t* row;
        float *dL, *dopl;
        std::size_t n = 0;  // rows written
    };
    /// Writes points of lights that are seen wholly.
    struct PointWriter {
        RowWriter rows;  // of light edges
        float *to_light, *L;
    };
    /// walk() of the touched paths of [begin, end).
    /// in:      touched  [path] result of touches()
    ///          points   null without WholeLightOptions
    /// needs:   memory for a row of each light edge and of each path that is touched, and for the points of an edge of
    ///          each such path
    void walk_all(std::size_t begin, std::size_t end, std::span<const std::uint8_t> touched, RowWriter& edges,
                  RowWriter& seen, PointWriter* points) const;
    /// An InteriorRow without rounding, with the light itself.
    struct ExactRow {
        std::size_t row;
        Rgb<double> L;
        std::span<const Rgb<double>> dL;  // [parameter]
        std::span<const double> dopl;
        double to_light;  // of a point of a light that is seen wholly: from the vertex; negative: the stored edge
    };
    using OnExactRow = std::function<void(const ExactRow&)>;
    /// walk() in double precision.
    void walk_exactly(std::size_t path, std::size_t& edge, const OnExactRow& on_edge, const OnExactRow& on_seen) const;
    /// Calls on_vertex at every vertex, in order.
    void walk_vertices(std::size_t path, const OnVertex& on_vertex) const;

  private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

/// The primitive column that a graph must have for these parameters, and the column of media; empty: it has them.
/// out:     what is missing and the command that stores it
std::string missing_columns(const PathGraph& graph, const Scene& scene, const SceneTangents& tangents,
                            const Attached& attached = {});

}  // namespace loom::derive
