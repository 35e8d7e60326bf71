#pragma once
// The edges that the vertices of a cluster can share, each with the density with which the whole cluster would have
// sampled it:                          PG Eqs. (7) to (12)
//
//   indirect   rho(w) = sum_k q_k p_k(w)                      over k that attempted a BSDF sample
//   direct     rho(w) = sum_k [p_k^NEE(w) + q_k p_k(w)]       over k that attempted each
//
// The sum over all edges of f_j cos_j / rho times the light of the edge is then an estimate at each vertex j of the
// cluster. Attempts count, not successes. A failed technique (an occluded light sample, a ray ended by roulette) must
// add to the densities too; without it the sum is 1 / P(success) too bright. Samples of delta lobes belong to their own
// vertex alone and are skipped.

#include "stages/core/clusters/cluster_shading.h"
#include "stages/core/graph/own_samples.h"

namespace loom {

/// The part of a continuation that a neighbour reuses.
enum class Reuse {
    directions,  // its direction; incoming light is taken as equal along it
    points,      // its end point; reconnected, without a visibility test
};

struct SharingOptions {
    Reuse reuse = Reuse::directions;
    /// Uses the equations as printed: densities over successes only; next-event estimation and BSDF sampling pooled
    /// separately, each light weighted by the power heuristic at its source. Too bright; for comparison only.
    bool as_printed = false;
};

/// Returns the first light edge of each vertex, plus one final entry.
std::vector<std::uint32_t> light_edge_offsets(const PathGraph& graph);

inline bool continues_shared(const PathGraph& graph, std::size_t j) {
    return (graph.vertices.flags[j] & vertex_flag::continued) && !is_delta(Lobe(graph.vertices.lobe[j]));
}

/// Returns the normal at vertex j, on the side that light leaves from.
Normal3f facing_normal(const PathGraph& graph, std::size_t j);

/// Returns the cluster's density for the direction of a continuation that `shading` has evaluated. Where the
/// continuation ends at a vertex without a cluster, like a mirror, vertices whose own continuation must end there are
/// no technique. They cannot sample its light.
inline float continuation_density(const ClusterShading& shading, const VertexRow& row) {
    if (!(row.bits & vertex_bit::ends_alone) || !shading.has_last_steps()) return shading.pdf_bsdf_sum();
    if (row.dead_end()) return 0;
    float rho = 0;
    for (int k = 0; k < shading.size(); ++k)
        if (!(shading.row(k).bits & vertex_bit::last_step)) rho += shading.pdf_bsdf(k);
    return rho;
}

/// Calls sink(lane, vertex, inv_rho) for each continuation, which ends at `vertex`; `shading` has then evaluated its
/// light. An edge has inv_rho 0 when its density is 0 by rounding, or when it carries no light (dead_end).
template <class Sink>
void for_each_indirect_edge(ClusterShading& shading, const PathGraph& graph, const SharingOptions& options,
                            Sink&& sink) {
    for (int lane = 0; lane < shading.size(); ++lane) {
        const std::size_t j = shading.vertex(lane);
        const VertexRow& row = shading.row(lane);
        if (!row.continues_shared()) continue;
        if (options.reuse == Reuse::points) {
            const float* y = graph.vertices.p.data() + 3 * (j + 1);
            shading.light_point({y[0], y[1], y[2]}, facing_normal(graph, j + 1));
        } else {
            shading.light_direction(row.next);
        }
        float rho = options.as_printed ? 0 : continuation_density(shading, row);
        if (options.as_printed) {
            for (int k = 0; k < shading.size(); ++k)
                if (shading.row(k).bits & vertex_flag::continued) rho += shading.pdf_bsdf(k);
        }
        sink(lane, std::uint32_t(j + 1), rho > 0 ? 1 / rho : 0.0f);
    }
}

/// Calls sink(lane, vertex, inv_rho) as above, for Reuse::directions; results are split into base and coat.
template <class Sink>
void for_each_direction(ClusterShading& shading, Sink&& sink) {
    for (int lane = 0; lane < shading.size(); ++lane) {
        if (!shading.row(lane).continues_shared()) continue;
        shading.light_lobes(shading.row(lane).next);
        const float rho = continuation_density(shading, shading.row(lane));
        sink(lane, std::uint32_t(shading.vertex(lane) + 1), rho > 0 ? 1 / rho : 0.0f);
    }
}

/// Calls sink(lane, edge, light, inv_rho) for each light edge; `shading` has then evaluated its light. `light` is the
/// radiance of the edge in the measure that the cluster shares. inv_rho as above.
/// in:      lights(shading, lane)  LightRows of a lane
template <class Lights, class Sink>
void for_each_light_edge(ClusterShading& shading, const SharingOptions& options, Lights&& lights, Sink&& sink) {
    // As printed: lanes whose own attempt found a light.
    bool found_nee[max_lanes], found_bsdf[max_lanes];
    if (options.as_printed)
        for (int k = 0; k < shading.size(); ++k) {
            found_nee[k] = found_bsdf[k] = false;
            for (const LightRow& e : lights(shading, k))
                (e.technique == LightTechnique::next_event ? found_nee : found_bsdf)[k] = true;
        }
    for (int lane = 0; lane < shading.size(); ++lane) {
        const VertexRow& row = shading.row(lane);
        for (const LightRow& e : lights(shading, lane)) {
            const bool next_event = e.technique == LightTechnique::next_event;
            if (!next_event && (row.bits & vertex_bit::delta)) continue;
            Spectrum light = e.Li;
            float pdf_nee = e.pdf_nee;
            bool delta = false;
            switch (e.kind) {
                case EmitterKind::area: {
                    // Convert to the area measure of the emitter, which all vertices of the cluster share.
                    const Vector3f d = e.y - row.p;
                    const auto unit = unit_from_octahedral(std::int16_t(e.n & 0xffffu), std::int16_t(e.n >> 16));
                    Normal3f n{unit[0], unit[1], unit[2]};
                    if (dot(n, d) > 0) n = -n;
                    const float d2 = length2(d);
                    pdf_nee *= -dot(n, d) / (d2 * std::sqrt(d2));
                    shading.light_point(e.y, n);
                    break;
                }
                case EmitterKind::point:
                case EmitterKind::spot:
                case EmitterKind::projector:
                case EmitterKind::laser_spot:
                    light *= length2(e.y - row.p);
                    delta = true;
                    shading.light_delta_point(e.y);
                    break;
                case EmitterKind::directional:
                    delta = true;
                    [[fallthrough]];
                case EmitterKind::constant:
                case EmitterKind::envmap:
                    shading.light_direction(Vector3f(e.y));
                    break;
            }
            float rho = pdf_nee * float(shading.n_next_event()) + (delta ? 0.0f : shading.pdf_bsdf_sum());
            if (options.as_printed) {
                const float own = next_event ? e.pdf_nee : e.pdf_bsdf;
                light *= power_heuristic(own, next_event ? e.pdf_bsdf : e.pdf_nee);
                rho = 0;
                for (int k = 0; k < shading.size(); ++k)
                    if (next_event)
                        rho += found_nee[k] ? pdf_nee : 0.0f;
                    else
                        rho += found_bsdf[k] ? shading.pdf_bsdf(k) : 0.0f;
            }
            sink(lane, e, light, rho > 0 ? 1 / rho : 0.0f);
        }
    }
}

/// Makes the rows from the graph, vertex by vertex; the sink receives the edge by its index.
/// in:      offsets  of light edges, by vertex
template <class Sink>
void for_each_light_edge(ClusterShading& shading, const PathGraph&, std::span<const std::uint32_t> offsets,
                         const SharingOptions& options, Sink&& sink) {
    std::vector<LightRow> rows;
    const auto lights = [&](const ClusterShading& at, int lane) -> std::span<const LightRow> {
        const std::size_t j = at.vertex(lane);
        rows.clear();
        for (std::uint32_t i = offsets[j]; i < offsets[j + 1]; ++i) rows.push_back(at.make_row().light(i));
        return rows;
    };
    for_each_light_edge(shading, options, lights,
                        [&](int lane, const LightRow& edge, const Spectrum& light, float inv_rho) {
                            sink(lane, edge.edge, light, inv_rho);
                        });
}

}  // namespace loom
