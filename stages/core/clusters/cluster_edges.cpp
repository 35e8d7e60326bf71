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
    const auto& v = graph.vertices;
    const Normal3f n = unit_vector<Normal3f>(v.ng.empty() ? v.ns : v.ng, j);
    return dot(n, Vector3f{v.wo[3 * j], v.wo[3 * j + 1], v.wo[3 * j + 2]}) < 0 ? -n : n;
}

}  // namespace loom
