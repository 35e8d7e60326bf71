#pragma once
// What a vertex of a path graph estimates from its own samples alone, as path tracing does; shared by the
// stages that start from that estimate, compare with it, or fall back on it.

#include "stages/core/graph/graph_reader.h"

namespace loom {

/// How next-event estimation and BSDF sampling are weighted against each other.       [Veach1995]
enum class Heuristic { power, balance };

/// f cos / pdf of the BSDF sample that leads from vertex j (`at`) along wi, roulette folded in.
Spectrum own_continuation(const GraphReader& reader, const ShadingPoint& at, std::size_t j, const Vector3f& wi);

/// f cos Li w / pdf of light edge k of vertex j (`at`).
Spectrum own_light(const GraphReader& reader, const ShadingPoint& at, std::size_t j, std::size_t k,
                   Heuristic heuristic = Heuristic::power);

/// The same, everything given.
/// in:      pdf_w  of the BSDF sample that may have found the light, for what is not found by next-event estimation
/// needs:   the edge was not found by a delta lobe
Spectrum own_light(const Spectrum& f_cos, const Spectrum& Li, bool next_event, float pdf_nee_w, float pdf_bsdf_w,
                   float pdf_w, Heuristic heuristic);

/// Walks along a path: on_vertex(j, at) at each of its vertices, then on_light(j, k, L) for each light edge k of that
/// vertex, with the radiance that the camera gets along it. What is seen directly (paths/Le) is not among it.
/// in: first light edge of the path; out: that of the next path
template <class OnVertex, class OnLight>
void walk_path(const GraphReader& reader, std::size_t path, std::size_t& edge, OnVertex&& on_vertex,
               OnLight&& on_light);

/// First light edge at or after vertex j.
std::size_t first_light_edge(const PathGraph& graph, std::size_t j);

/// Unit direction in which vertex j continues.
/// needs:   the vertex is continued
inline Vector3f continuation_direction(const PathGraph& graph, std::size_t j) {
    const float* wo = graph.vertices.wo.data() + 3 * (j + 1);
    return {-wo[0], -wo[1], -wo[2]};
}

template <class OnVertex, class OnLight>
void walk_path(const GraphReader& reader, std::size_t path, std::size_t& edge, OnVertex&& on_vertex,
               OnLight&& on_light) {
    const PathGraph& g = reader.graph();
    const auto& e = g.light_edges;
    Spectrum beta(1);
    const std::uint64_t begin = g.paths.first_vertex[path], end = g.paths.first_vertex[path + 1];
    for (std::uint64_t j = begin; j < end; ++j) {
        const ShadingPoint at = reader.vertex(j);
        on_vertex(j, at);
        for (; edge < e.vertex.size() && e.vertex[edge] == j; ++edge)
            on_light(j, edge, beta * own_light(reader, at, j, edge));
        if (j + 1 < end) beta *= own_continuation(reader, at, j, continuation_direction(g, j));
    }
}

}  // namespace loom
