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

Spectrum own_light(const GraphReader& reader, const ShadingPoint& at, std::size_t j, std::size_t k, Heuristic heuristic) {
    const auto& e = reader.graph().light_edges;
    const Vector3f wi = reader.light_direction(at.p, k);
    const Spectrum Li{e.Li[3 * k], e.Li[3 * k + 1], e.Li[3 * k + 2]};
    const float pdf_nee = e.pdf_nee_w[k], pdf_bsdf = e.pdf_bsdf_w[k];
    const auto weight = [heuristic](float pdf, float other) {
        return heuristic == Heuristic::power ? power_heuristic(pdf, other) : pdf / (pdf + other);
    };
    if (LightTechnique(e.technique[k]) == LightTechnique::next_event)
        return f_cos_pdf(at, wi).f_cos * Li * (weight(pdf_nee, pdf_bsdf) / pdf_nee);
    return own_continuation(reader, at, j, wi) * Li * weight(pdf_bsdf, pdf_nee);
}

std::size_t first_light_edge(const PathGraph& graph, std::size_t j) {
    const auto vertices = graph.light_edges.vertex.values();
    return std::size_t(std::lower_bound(vertices.begin(), vertices.end(), j) - vertices.begin());
}

}  // namespace loom
