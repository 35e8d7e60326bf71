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

#include "stages/core/transport/cluster_shading.h"
#include "stages/core/transport/own_samples.h"

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

/// Normal at the light point of an edge to an area light.
Normal3f light_normal(const PathGraph& graph, std::size_t edge);

/// Calls sink(lane, vertex, inv_rho) for each continuation, whose end is `vertex`; shading then answers for its light.
/// An edge that nobody could have sampled, by rounding, has inv_rho 0.
template <class Sink>
void for_each_indirect_edge(ClusterShading& shading, const PathGraph& graph, const SharingOptions& options, Sink&& sink) {
    for (int lane = 0; lane < shading.size(); ++lane) {
        const std::size_t j = shading.vertex(lane);
        if (!continues_shared(graph, j)) continue;
        if (options.reuse == Reuse::points) {
            const float* y = graph.vertices.p.data() + 3 * (j + 1);
            shading.light_point({y[0], y[1], y[2]}, facing_normal(graph, j + 1));
        } else {
            shading.light_direction(continuation_direction(graph, j));
        }
        float rho = shading.pdf_bsdf_sum();
        if (options.as_printed) {
            rho = 0;
            for (int k = 0; k < shading.size(); ++k)
                if (graph.vertices.flags[shading.vertex(k)] & vertex_flag::continued) rho += shading.pdf_bsdf(k);
        }
        sink(lane, std::uint32_t(j + 1), rho > 0 ? 1 / rho : 0.0f);
    }
}

/// Calls sink(lane, edge, light, inv_rho) for each light edge; shading then answers for its light. inv_rho as above.
template <class Sink>
void for_each_light_edge(ClusterShading& shading, const PathGraph& graph, std::span<const std::uint32_t> offsets,
                         const SharingOptions& options, Sink&& sink) {
    const auto& e = graph.light_edges;
    // As printed: lanes whose own attempt found a light.
    bool found_nee[max_lanes], found_bsdf[max_lanes];
    if (options.as_printed)
        for (int k = 0; k < shading.size(); ++k) {
            found_nee[k] = found_bsdf[k] = false;
            for (std::uint32_t i = offsets[shading.vertex(k)]; i < offsets[shading.vertex(k) + 1]; ++i)
                (LightTechnique(e.technique[i]) == LightTechnique::next_event ? found_nee : found_bsdf)[k] = true;
        }
    for (int lane = 0; lane < shading.size(); ++lane) {
        const std::size_t j = shading.vertex(lane);
        for (std::uint32_t i = offsets[j]; i < offsets[j + 1]; ++i) {
            const bool next_event = LightTechnique(e.technique[i]) == LightTechnique::next_event;
            if (!next_event && is_delta(Lobe(graph.vertices.lobe[j]))) continue;
            Spectrum light = rgb(e.Li, i);
            const Point3f y{e.y[4 * i], e.y[4 * i + 1], e.y[4 * i + 2]};
            const float* p = graph.vertices.p.data() + 3 * j;
            float pdf_nee = e.pdf_nee_w[i];
            bool delta = false;
            switch (EmitterKind(graph.emitters.kind[e.emitter[i]])) {
                case EmitterKind::area: {
                    // To the measure of the light's area, in which all vertices of the cluster agree.
                    const Vector3f d = y - Point3f{p[0], p[1], p[2]};
                    Normal3f n = light_normal(graph, i);
                    if (dot(n, d) > 0) n = -n;
                    const float d2 = length2(d);
                    pdf_nee *= -dot(n, d) / (d2 * std::sqrt(d2));
                    shading.light_point(y, n);
                    break;
                }
                case EmitterKind::point:
                case EmitterKind::spot:
                    light *= length2(y - Point3f{p[0], p[1], p[2]});
                    delta = true;
                    shading.light_delta_point(y);
                    break;
                case EmitterKind::directional: delta = true; [[fallthrough]];
                case EmitterKind::constant:
                case EmitterKind::envmap: shading.light_direction(Vector3f(y)); break;
            }
            float rho = pdf_nee * float(shading.n_next_event()) + (delta ? 0.0f : shading.pdf_bsdf_sum());
            if (options.as_printed) {
                const float own = next_event ? e.pdf_nee_w[i] : e.pdf_bsdf_w[i];
                light *= power_heuristic(own, next_event ? e.pdf_bsdf_w[i] : e.pdf_nee_w[i]);
                rho = 0;
                for (int k = 0; k < shading.size(); ++k)
                    if (next_event)
                        rho += found_nee[k] ? pdf_nee : 0.0f;
                    else
                        rho += found_bsdf[k] ? shading.pdf_bsdf(k) : 0.0f;
            }
            sink(lane, i, light, rho > 0 ? 1 / rho : 0.0f);
        }
    }
}

}  // namespace loom
