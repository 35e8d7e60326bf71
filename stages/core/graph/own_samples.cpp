#include "stages/core/graph/own_samples.h"

#include <algorithm>

namespace loom {

std::size_t first_light_edge(const PathGraph& graph, std::size_t j) {
    const auto vertices = graph.light_edges.vertex.values();
    return std::size_t(std::lower_bound(vertices.begin(), vertices.end(), j) - vertices.begin());
}

}  // namespace loom
