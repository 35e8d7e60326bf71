#pragma once
#include <vector>

#include "formats/path_graph.h"
#include "stages/core/transport/shading.h"

namespace loom {

/// Vertices of a path graph as shading points, the very ones that the tracer had. The graph is borrowed.
class GraphReader {
  public:
    explicit GraphReader(const PathGraph& graph);

    const PathGraph& graph() const { return graph_; }
    ShadingPoint vertex(std::size_t j) const;
    /// Unit direction from vertex position p to light point k.
    Vector3f light_direction(const Point3f& p, std::size_t k) const;
    const BsdfModel& model(std::size_t material) const { return models_[material]; }

  private:
    const PathGraph& graph_;
    std::vector<BsdfModel> models_;
};

}  // namespace loom
