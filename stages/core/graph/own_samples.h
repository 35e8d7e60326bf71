#pragma once
// Contribution of a stored path by its own samples alone, as in path tracing. Stages start from this estimate, compare
// with it, or fall back on it.

#include <concepts>

#include "stages/core/graph/graph_reader.h"

namespace loom {

/// MIS heuristic between next-event estimation and BSDF sampling.       [Veach1995]
enum class Heuristic { power, balance };

/// MIS weight of the technique that found a light against the other one.
inline float mis_weight(bool next_event, float pdf_nee_w, float pdf_bsdf_w, Heuristic heuristic) {
    const float pdf = next_event ? pdf_nee_w : pdf_bsdf_w, other = next_event ? pdf_bsdf_w : pdf_nee_w;
    return heuristic == Heuristic::power ? power_heuristic(pdf, other) : pdf / (pdf + other);
}

/// f cos / pdf of the BSDF sample that leads from vertex j (`at`) along wi, roulette folded in.
/// The density is that of the stored path, a constant over a Dual (detached sampling).
template <class T>
Rgb<T> own_continuation(const GraphReader& reader, const ShadingPointOf<T>& at, std::size_t j, const Vector3<T>& wi) {
    const auto& v = reader.graph().vertices;
    const Lobe lobe = Lobe(v.lobe[j]);
    const T inv_pdf(1 / v.pdf_w[j]);
    if (!is_delta(lobe)) return f_cos_pdf(at, wi).f_cos * inv_pdf;
    Rgb<T> value = delta_value(at.bsdf, at.wo_local, lobe) * inv_pdf;
    if (at.perturbed && lobe != Lobe::null) value *= bump_shadowing(at, wi, at.frame.to_local(wi).z);
    return value;
}

/// f cos Li w / pdf of a light edge, given its numbers; densities and MIS weight are constants.
/// in:      pdf_w  density of the vertex's BSDF sample; used unless next-event estimation found the light
/// needs:   the edge was not found by a delta lobe
template <class T>
Rgb<T> own_light(const Rgb<T>& f_cos, const Rgb<T>& Li, bool next_event, float pdf_nee_w, float pdf_bsdf_w, float pdf_w,
                 Heuristic heuristic) {
    return f_cos * Li * T(mis_weight(next_event, pdf_nee_w, pdf_bsdf_w, heuristic) / (next_event ? pdf_nee_w : pdf_w));
}

/// f cos Li w / pdf of light edge k of vertex j (`at`).
/// in:      wi, Li  direction and radiance of the edge, where they move with a parameter
template <class T>
Rgb<T> own_light(const GraphReader& reader, const ShadingPointOf<T>& at, std::size_t j, std::size_t k,
                 const Vector3<T>& wi, const Rgb<T>& Li, Heuristic heuristic = Heuristic::power) {
    const PathGraph& g = reader.graph();
    const auto& e = g.light_edges;
    const bool next_event = LightTechnique(e.technique[k]) == LightTechnique::next_event;
    if (next_event || !is_delta(Lobe(g.vertices.lobe[j])))
        return own_light(f_cos_pdf(at, wi).f_cos, Li, next_event, e.pdf_nee_w[k], e.pdf_bsdf_w[k], g.vertices.pdf_w[j],
                         heuristic);
    return own_continuation(reader, at, j, wi) * Li *
           T(mis_weight(next_event, e.pdf_nee_w[k], e.pdf_bsdf_w[k], heuristic));
}
inline Spectrum own_light(const GraphReader& reader, const ShadingPoint& at, std::size_t j, std::size_t k,
                          Heuristic heuristic = Heuristic::power) {
    return own_light(reader, at, j, k, reader.light_direction(at.p, k), rgb(reader.graph().light_edges.Li, k),
                     heuristic);
}

/// Returns the first light edge at or after vertex j.
std::size_t first_light_edge(const PathGraph& graph, std::size_t j);

/// Returns the unit direction in which vertex j continues.
/// needs:   the vertex is continued
inline Vector3f continuation_direction(const PathGraph& graph, std::size_t j) {
    return -outgoing(graph, j + 1);
}

/// Source of stored paths for walk_vertices(). Vertices and light edges are rows of graph(); a weight is an Rgb<T>.
///   vertex(j)           what both weights of a vertex share, evaluated once
///   continuation(j, v)  f cos / pdf of the BSDF sample that leads to vertex j + 1
///   light(j, v, k)      f cos Li w / pdf of light edge k
template <class Source, class T>
concept PathSource = requires(const Source& source, std::size_t row) {
    { source.graph() } -> std::same_as<const PathGraph&>;
    Rgb<T>(source.continuation(row, source.vertex(row)));
    Rgb<T>(source.light(row, source.vertex(row), row));
};

/// Paths as traced, each with its own samples.
class OwnSamples {
  public:
    explicit OwnSamples(const GraphReader& reader, Heuristic heuristic = Heuristic::power)
        : reader_(reader), heuristic_(heuristic) {}
    const PathGraph& graph() const { return reader_.graph(); }
    ShadingPoint vertex(std::size_t j) const { return reader_.vertex(j); }
    Spectrum continuation(std::size_t j, const ShadingPoint& at) const {
        return own_continuation(reader_, at, j, continuation_direction(graph(), j));
    }
    Spectrum light(std::size_t j, const ShadingPoint& at, std::size_t k) const {
        return own_light(reader_, at, j, k, heuristic_);
    }

  private:
    const GraphReader& reader_;
    Heuristic heuristic_;
};

/// Rows of one path, or of a part of it.
struct VertexRange {
    std::size_t begin, end;
};
inline VertexRange vertices_of(const PathGraph& graph, std::size_t path) {
    return {graph.paths.first_vertex[path], graph.paths.first_vertex[path + 1]};
}

/// Walks along vertices of one path: calls on_vertex(j, vertex) at each, then on_light(j, k, beta * light) for each of
/// its light edges k. T is the number of weights: float, double or Dual.
///   beta_(j+1) = beta_j continuation_j
/// in:      beta  throughput to the first vertex, from the camera or from another start of the walk
///          edge  first light edge of the first vertex
/// out:     throughput to the vertex after the last, if the path has one; edge: the first one after those of the walk
template <class T, PathSource<T> Source, class OnVertex, class OnLight>
Rgb<T> walk_vertices(const Source& source, VertexRange rows, std::size_t path_end, Rgb<T> beta, std::size_t& edge,
                     OnVertex&& on_vertex, OnLight&& on_light) {
    const auto& edges = source.graph().light_edges.vertex;
    for (std::size_t j = rows.begin; j < rows.end; ++j) {
        const auto at = source.vertex(j);
        on_vertex(j, at);
        for (; edge < edges.size() && edges[edge] == j; ++edge)
            on_light(j, edge, beta * Rgb<T>(source.light(j, at, edge)));
        if (j + 1 < path_end) beta *= Rgb<T>(source.continuation(j, at));
    }
    return beta;
}

/// Walks along a whole path; on_light gets the radiance that reaches the camera. Excludes the directly visible emitter
/// (paths/Le).
/// in:      edge  first light edge of the path; out: that of the next path
template <class T = float, PathSource<T> Source, class OnVertex, class OnLight>
void walk_path(const Source& source, std::size_t path, std::size_t& edge, OnVertex&& on_vertex, OnLight&& on_light) {
    const VertexRange rows = vertices_of(source.graph(), path);
    walk_vertices<T>(source, rows, rows.end, Rgb<T>(T(1)), edge, on_vertex, on_light);
}

}  // namespace loom
