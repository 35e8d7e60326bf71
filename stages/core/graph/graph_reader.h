#pragma once
#include <map>
#include <string>
#include <vector>

#include "formats/io/octahedral.h"
#include "formats/path_graph.h"
#include "stages/core/scene/shading.h"

namespace loom {

struct Scene;

/// Refuses a graph of another scene.
/// throws:  InputError when the graph was traced in another scene, or with other values of its parameters
void require_scene_of(const PathGraph& graph, const std::string& graph_file, const Scene& scene,
                      const std::string& scene_file);

/// Returns row i of a column of colours.
inline Spectrum rgb(const Column<float>& column, std::size_t i) {
    return {column[3 * i], column[3 * i + 1], column[3 * i + 2]};
}

/// Returns row i of a column of octahedral unit vectors.
template <class V>
V unit_vector(const Column<std::int16_t>& column, std::size_t i) {
    const auto unit = unit_from_octahedral(column[2 * i], column[2 * i + 1]);
    return {unit[0], unit[1], unit[2]};
}

/// Whether rows i and j of a column of octahedral unit vectors, or of an absent one, are the same.
inline bool same_vector(const Column<std::int16_t>& column, std::size_t i, std::size_t j) {
    return column.empty() || (column[2 * i] == column[2 * j] && column[2 * i + 1] == column[2 * j + 1]);
}

/// Returns the stored position of vertex j.
template <class T = float>
Point3<T> position(const PathGraph& graph, std::size_t j) {
    const float* p = graph.vertices.p.data() + 3 * j;
    return {p[0], p[1], p[2]};
}

/// Returns the direction in which light leaves vertex j towards the camera.
inline Vector3f outgoing(const PathGraph& graph, std::size_t j) {
    const float* wo = graph.vertices.wo.data() + 3 * j;
    return {wo[0], wo[1], wo[2]};
}

inline Normal3f shading_normal(const PathGraph& graph, std::size_t j) {
    return unit_vector<Normal3f>(graph.vertices.ns, j);
}

inline Normal3f geometric_normal(const PathGraph& graph, std::size_t j) {
    return unit_vector<Normal3f>(graph.vertices.ng.empty() ? graph.vertices.ns : graph.vertices.ng, j);
}

/// Returns the normal or its opposite, whichever is on the side of wo.
inline Normal3f facing(const Normal3f& n, const Vector3f& wo) {
    return dot(n, wo) < 0 ? -n : n;
}

/// Returns the origin of the camera ray of a path: the pinhole, or a point on an orthographic sensor; never on the near
/// plane.
template <class T = float>
Point3<T> camera_origin(const PathGraph& graph, std::size_t path) {
    if (graph.paths.origin.empty())
        return {T(graph.sensor.origin[0]), T(graph.sensor.origin[1]), T(graph.sensor.origin[2])};
    const float* o = graph.paths.origin.data() + 3 * path;
    return {o[0], o[1], o[2]};
}

/// Reads vertices of a path graph as shading points, equal to those of the tracer. The graph is borrowed.
class GraphReader {
  public:
    explicit GraphReader(const PathGraph& graph);
    GraphReader(const GraphReader&) = delete;
    GraphReader(GraphReader&&) = default;

    const PathGraph& graph() const { return graph_; }
    ShadingPoint vertex(std::size_t j) const {
        ShadingPoint at;
        read_vertex(j, at);
        return at;
    }
    /// Overwrites all members of a point but hit_error with those of vertex(j).
    /// in:      before  the point already holds this vertex, whose frame is kept where it is the same; no_vertex: none
    void read_vertex(std::size_t j, ShadingPoint& at, std::size_t before = no_vertex) const;
    static constexpr std::size_t no_vertex = ~std::size_t{0};
    /// Returns the BSDF of a vertex.
    Bsdf<float> bsdf(std::size_t j) const {
        Bsdf<float> b;
        read_bsdf(j, b);
        return b;
    }
    /// Returns the unit direction from vertex position p to light point k.
    Vector3f light_direction(const Point3f& p, std::size_t k) const;
    const BsdfModel& model(std::size_t material) const { return models_[material]; }
    /// Computes what formulas over a Dual need where roughness or index of a material depend on a parameter; see
    /// prepare_coat_slopes().
    void prepare_slopes(std::size_t material);

  private:
    void read_bsdf(std::size_t j, Bsdf<float>& b) const;

    const PathGraph& graph_;
    std::vector<BsdfModel> models_;
    std::vector<Bsdf<float>> bsdfs_;           // [material], without textures
    std::map<std::size_t, RoughCoats> coats_;  // [material]; models borrow
};

}  // namespace loom
