#include "stages/core/transport/own_samples.h"

#include <algorithm>

namespace loom {

Spectrum own_continuation(const GraphReader& reader, const ShadingPoint& at, std::size_t j, const Vector3f& wi) {
    const auto& v = reader.graph().vertices;
    const Lobe lobe = Lobe(v.lobe[j]);
    if (!is_delta(lobe)) return f_cos_pdf(at, wi).f_cos * (1 / v.pdf_w[j]);
    Spectrum value = delta_value(at.bsdf, at.wo_local, lobe) * (1 / v.pdf_w[j]);
    if (at.perturbed && lobe != Lobe::null) value *= bump_shadowing(at, wi, at.frame.to_local(wi).z);
    return value;
}

namespace {

/// Of the technique that found edge k against the other one.
float mis_weight(const PathGraph& graph, std::size_t k, Heuristic heuristic) {
    const auto& e = graph.light_edges;
    const bool next_event = LightTechnique(e.technique[k]) == LightTechnique::next_event;
    const float pdf = next_event ? e.pdf_nee_w[k] : e.pdf_bsdf_w[k], other = next_event ? e.pdf_bsdf_w[k] : e.pdf_nee_w[k];
    return heuristic == Heuristic::power ? power_heuristic(pdf, other) : pdf / (pdf + other);
}

}  // namespace

Spectrum own_light(const PathGraph& graph, const Spectrum& f_cos, std::size_t j, std::size_t k, Heuristic heuristic) {
    const auto& e = graph.light_edges;
    const bool next_event = LightTechnique(e.technique[k]) == LightTechnique::next_event;
    const float pdf = next_event ? e.pdf_nee_w[k] : graph.vertices.pdf_w[j];
    return f_cos * rgb(e.Li, k) * (mis_weight(graph, k, heuristic) / pdf);
}

Spectrum own_light(const GraphReader& reader, const ShadingPoint& at, std::size_t j, std::size_t k, Heuristic heuristic) {
    const PathGraph& g = reader.graph();
    const Vector3f wi = reader.light_direction(at.p, k);
    const bool next_event = LightTechnique(g.light_edges.technique[k]) == LightTechnique::next_event;
    if (next_event || !is_delta(Lobe(g.vertices.lobe[j]))) return own_light(g, f_cos_pdf(at, wi).f_cos, j, k, heuristic);
    return own_continuation(reader, at, j, wi) * rgb(g.light_edges.Li, k) * mis_weight(g, k, heuristic);
}

std::size_t first_light_edge(const PathGraph& graph, std::size_t j) {
    const auto vertices = graph.light_edges.vertex.values();
    return std::size_t(std::lower_bound(vertices.begin(), vertices.end(), j) - vertices.begin());
}

}  // namespace loom
