#include "stages/core/clusters/cluster_edges.h"

namespace loom {

std::vector<std::uint32_t> light_edge_offsets(const PathGraph& graph) {
    const auto& vertex = graph.light_edges.vertex;
    std::vector<std::uint32_t> offsets(graph.n_vertices() + 1);
    std::size_t edge = 0;
    for (std::size_t j = 0; j < offsets.size(); ++j) {
        while (edge < vertex.size() && vertex[edge] < j) ++edge;
        offsets[j] = std::uint32_t(edge);
    }
    return offsets;
}

Normal3f facing_normal(const PathGraph& graph, std::size_t j) {
    return facing(geometric_normal(graph, j), outgoing(graph, j));
}

}  // namespace loom
