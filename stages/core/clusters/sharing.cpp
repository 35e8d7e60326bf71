#include "stages/core/clusters/sharing.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "stages/core/scattering/bsdf_model.h"

namespace loom {
namespace {

constexpr float wide = std::numeric_limits<float>::infinity();

bool has_alpha(BsdfKind kind) {
    return kind == BsdfKind::rough_conductor || kind == BsdfKind::rough_dielectric || kind == BsdfKind::ward;
}

/// n = 2 / alpha^2 - 2                                              [Walter2007] section 5.2
float phong_width(float exponent) {
    return std::sqrt(2 / (exponent + 2));
}

/// Returns the width of the narrowest smooth lobe as a microfacet alpha; 0 when there is no smooth lobe. Plastics share
/// what their diffuse component reflects, even with a narrow coat: in the densities of a cluster the coat's directions
/// belong to the vertex that sampled them.
float narrowest_lobe(const PathGraph::Materials& m, std::size_t i) {
    switch (BsdfKind(m.kind[i])) {
        case BsdfKind::diffuse:
        case BsdfKind::rough_diffuse:
        case BsdfKind::plastic:
        case BsdfKind::rough_plastic:
            return wide;
        case BsdfKind::rough_conductor:
        case BsdfKind::rough_dielectric:
        case BsdfKind::ward:
            return std::min(m.alpha[2 * i], m.alpha[2 * i + 1]);
        case BsdfKind::phong:
            return phong_width(m.exponent[i]);
        case BsdfKind::conductor:
        case BsdfKind::dielectric:
        case BsdfKind::thin_dielectric:
        case BsdfKind::null:
            return 0;
    }
    return 0;
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
    if ((textured & textured_parameter::exponent) != 0) return phong_width(v.exponent[j]) >= limit_;
    if ((textured & textured_parameter::alpha) == 0 || !has_alpha(BsdfKind(graph_.materials.kind[i]))) return true;
    // The column has half precision: a texture value equal to the limit must not fall below it.
    const float limit = float_from_half(half_from_float(limit_));
    return float_from_half(v.alpha[2 * j]) >= limit && float_from_half(v.alpha[2 * j + 1]) >= limit;
}

}  // namespace loom
