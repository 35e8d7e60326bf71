#pragma once
#include <map>
#include <string>
#include <vector>

#include "formats/io/octahedral.h"
#include "formats/path_graph.h"
#include "stages/core/scene/shading.h"

namespace loom {

struct Scene;

/// throws: InputError when the graph was traced in another scene, or with other values of its parameters
void require_scene_of(const PathGraph& graph, const std::string& graph_file, const Scene& scene,
                      const std::string& scene_file);

/// Row i of a column of colours.
inline Spectrum rgb(const Column<float>& column, std::size_t i) {
    return {column[3 * i], column[3 * i + 1], column[3 * i + 2]};
}

/// Row i of a column of octahedral unit vectors.
template <class V>
V unit_vector(const Column<std::int16_t>& column, std::size_t i) {
    const auto unit = unit_from_octahedral(column[2 * i], column[2 * i + 1]);
    return {unit[0], unit[1], unit[2]};
}

/// Vertices of a path graph as shading points, the very ones that the tracer had. The graph is borrowed.
class GraphReader {
  public:
    explicit GraphReader(const PathGraph& graph);
    GraphReader(const GraphReader&) = delete;
    GraphReader(GraphReader&&) = default;

    const PathGraph& graph() const { return graph_; }
    ShadingPoint vertex(std::size_t j) const;
    /// Its BSDF alone.
    Bsdf<float> bsdf(std::size_t j) const;
    /// Unit direction from vertex position p to light point k.
    Vector3f light_direction(const Point3f& p, std::size_t k) const;
    const BsdfModel& model(std::size_t material) const { return models_[material]; }

  private:
    const PathGraph& graph_;
    std::vector<BsdfModel> models_;
    std::map<std::size_t, RoughCoats> coats_;  // by material; models borrow
};

}  // namespace loom
