#include "stages/core/clusters/sharing.h"

#include "stages/core/scattering/lobe_width.h"

namespace loom {
namespace {

bool has_alpha(BsdfKind kind) {
    return kind == BsdfKind::rough_conductor || kind == BsdfKind::rough_dielectric || kind == BsdfKind::ward;
}

/// In the densities of a cluster the directions of a plastic's narrow coat belong to the vertex that sampled them.
float narrowest_lobe(const PathGraph::Materials& m, std::size_t i) {
    return loom::narrowest_lobe(BsdfKind(m.kind[i]), m.alpha[2 * i], m.alpha[2 * i + 1], m.exponent[i]);
}

}  // namespace

SharingRule::SharingRule(const PathGraph& graph, float private_roughness) : graph_(graph), limit_(private_roughness) {
    const auto& m = graph.materials;
    for (std::size_t i = 0; i < m.kind.size(); ++i) {
        const bool textured_alpha = (m.textured[i] & textured_parameter::alpha) != 0 && has_alpha(BsdfKind(m.kind[i]));
        const bool textured_exponent = (m.textured[i] & textured_parameter::exponent) != 0;
        const bool textured_width = textured_alpha || textured_exponent;
        const bool textured_opacity = (m.textured[i] & textured_parameter::opacity) != 0;
        const float alpha = narrowest_lobe(m, i);
        const bool solitary =
            (!textured_width && (alpha == 0 || alpha < limit_)) || (!textured_opacity && !(m.opacity[i] > 0));
        kinds_.push_back(solitary                             ? Kind::solitary
                         : textured_width || textured_opacity ? Kind::asks_vertex
                                                              : Kind::shares);
    }
}

bool SharingRule::shares_by_own_parameters(std::size_t j) const {
    const auto& v = graph_.vertices;
    const std::size_t i = v.material[j];
    const std::uint8_t textured = graph_.materials.textured[i];
    if ((textured & textured_parameter::opacity) != 0 && !(float_from_half(v.opacity[j]) > 0)) return false;
    if ((textured & textured_parameter::exponent) != 0)
        return loom::narrowest_lobe(BsdfKind::phong, 0, 0, v.exponent[j]) >= limit_;
    if ((textured & textured_parameter::alpha) == 0 || !has_alpha(BsdfKind(graph_.materials.kind[i]))) return true;
    // The column has half precision: a texture value equal to the limit must not fall below it.
    const float limit = float_from_half(half_from_float(limit_));
    return float_from_half(v.alpha[2 * j]) >= limit && float_from_half(v.alpha[2 * j + 1]) >= limit;
}

}  // namespace loom
