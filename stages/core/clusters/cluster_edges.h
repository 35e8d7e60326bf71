#pragma once
// The edges that the vertices of a cluster can share, each with the density with which the cluster as a whole would
// have sampled it:                          PG Eqs. (7) to (12)
//
//   indirect   rho(w) = sum_k q_k p_k(w)                      over k that attempted a BSDF sample
//   direct     rho(w) = sum_k [p_k^NEE(w) + q_k p_k(w)]       over k that attempted each
//
// so that f_j cos_j / rho, times the light of the edge, summed over all edges, is an estimate at each vertex j of the
// cluster. Counted are attempts, not successes: a technique that failed (an occluded light, a ray that was ended by
// roulette) must weigh on the others' densities too, or the sum is 1 / P(success) too bright. Samples of delta lobes
// belong to their own vertex alone and are not visited.

#include "stages/core/clusters/cluster_shading.h"
#include "stages/core/graph/own_samples.h"

namespace loom {

/// What a neighbour takes over from a continuation.
enum class Reuse {
    directions,  // its direction: incoming light is taken as equal along it
    points,      // its end point: reconnected, without a test of visibility
};

struct SharingOptions {
    Reuse reuse = Reuse::directions;
    /// The equations as they are printed: densities over successes only; next-event estimation and BSDF sampling
    /// pooled apart, each light weighted by the power heuristic at its source. Too bright; for comparison.
    bool as_printed = false;
};

/// First light edge of each vertex, and one more entry.
std::vector<std::uint32_t> light_edge_offsets(const PathGraph& graph);

inline bool continues_shared(const PathGraph& graph, std::size_t j) {
    return (graph.vertices.flags[j] & vertex_flag::continued) && !is_delta(Lobe(graph.vertices.lobe[j]));
}

/// Normal at vertex j, on the side that light leaves from.
Normal3f facing_normal(const PathGraph& graph, std::size_t j);

/// Density of the cluster for the direction of a continuation, of which shading answers. Where it ends at a vertex
/// without a cluster, like a mirror, vertices whose own continuation must end there are no technique: they cannot bring
/// its light.
inline float continuation_density(const ClusterShading& shading, const VertexRow& row) {
    if (!(row.bits & vertex_bit::ends_alone) || !shading.has_last_steps()) return shading.pdf_bsdf_sum();
    if (row.dead_end()) return 0;
    float rho = 0;
    for (int k = 0; k < shading.size(); ++k)
        if (!(shading.row(k).bits & vertex_bit::last_step)) rho += shading.pdf_bsdf(k);
    return rho;
}

/// Calls sink(lane, vertex, inv_rho) for each continuation, whose end is `vertex`; shading then answers for its light.
/// An edge that nobody could have sampled, by rounding, or that brings no light (dead_end), has inv_rho 0.
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

/// The same of directions, with answers as base and coat.
template <class Sink>
void for_each_direction(ClusterShading& shading, Sink&& sink) {
    for (int lane = 0; lane < shading.size(); ++lane) {
        if (!shading.row(lane).continues_shared()) continue;
        shading.light_lobes(shading.row(lane).next);
        const float rho = continuation_density(shading, shading.row(lane));
        sink(lane, std::uint32_t(shading.vertex(lane) + 1), rho > 0 ? 1 / rho : 0.0f);
    }
}

/// Calls sink(lane, edge, light, inv_rho) for each light edge, light being that of the edge in the measure that is
/// shared; shading then answers for it. inv_rho as above.
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
                    // To the measure of the light's area, in which all vertices of the cluster agree.
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

/// The same with rows made from the graph, vertex by vertex; the edge is given to the sink by its number.
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
