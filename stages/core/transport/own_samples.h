#pragma once
// What a vertex of a path graph estimates from its own samples alone, as path tracing does; shared by the
// stages that start from that estimate, compare with it, or fall back on it.

#include "stages/core/transport/graph_reader.h"

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
Spectrum own_light(const Spectrum& f_cos, const Spectrum& Li, bool next_event, float pdf_nee_w, float pdf_bsdf_w, float pdf_w,
                   Heuristic heuristic);

/// First light edge at or after vertex j.
std::size_t first_light_edge(const PathGraph& graph, std::size_t j);

/// Unit direction in which vertex j continues.
/// needs:   the vertex is continued
inline Vector3f continuation_direction(const PathGraph& graph, std::size_t j) {
    const float* wo = graph.vertices.wo.data() + 3 * (j + 1);
    return {-wo[0], -wo[1], -wo[2]};
}

}  // namespace loom
