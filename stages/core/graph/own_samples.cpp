#include "stages/core/graph/own_samples.h"

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

/// MIS weight of the technique that found a light against the other one.
float mis_weight(bool next_event, float pdf_nee_w, float pdf_bsdf_w, Heuristic heuristic) {
    const float pdf = next_event ? pdf_nee_w : pdf_bsdf_w, other = next_event ? pdf_bsdf_w : pdf_nee_w;
    return heuristic == Heuristic::power ? power_heuristic(pdf, other) : pdf / (pdf + other);
}

}  // namespace

Spectrum own_light(const Spectrum& f_cos, const Spectrum& Li, bool next_event, float pdf_nee_w, float pdf_bsdf_w,
                   float pdf_w, Heuristic heuristic) {
    return f_cos * Li * (mis_weight(next_event, pdf_nee_w, pdf_bsdf_w, heuristic) / (next_event ? pdf_nee_w : pdf_w));
}

Spectrum own_light(const GraphReader& reader, const ShadingPoint& at, std::size_t j, std::size_t k,
                   Heuristic heuristic) {
    const PathGraph& g = reader.graph();
    const auto& e = g.light_edges;
    const Vector3f wi = reader.light_direction(at.p, k);
    const bool next_event = LightTechnique(e.technique[k]) == LightTechnique::next_event;
    const Spectrum Li = rgb(e.Li, k);
    if (next_event || !is_delta(Lobe(g.vertices.lobe[j])))
        return own_light(f_cos_pdf(at, wi).f_cos, Li, next_event, e.pdf_nee_w[k], e.pdf_bsdf_w[k], g.vertices.pdf_w[j],
                         heuristic);
    return own_continuation(reader, at, j, wi) * Li *
           mis_weight(next_event, e.pdf_nee_w[k], e.pdf_bsdf_w[k], heuristic);
}

std::size_t first_light_edge(const PathGraph& graph, std::size_t j) {
    const auto vertices = graph.light_edges.vertex.values();
    return std::size_t(std::lower_bound(vertices.begin(), vertices.end(), j) - vertices.begin());
}

}  // namespace loom
