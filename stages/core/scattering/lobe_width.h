#pragma once
#include <algorithm>
#include <cmath>
#include <limits>

#include "stages/core/scattering/bsdf_model.h"

namespace loom {

/// Width of the narrowest smooth lobe of a BSDF as a microfacet alpha; 0 when there is no smooth lobe. Plastics count as
/// wide, even with a narrow coat: their diffuse component reflects from all directions.
inline float narrowest_lobe(BsdfKind kind, float alpha_u, float alpha_v, float exponent) {
    switch (kind) {
        case BsdfKind::diffuse:
        case BsdfKind::rough_diffuse:
        case BsdfKind::plastic:
        case BsdfKind::rough_plastic:
            return std::numeric_limits<float>::infinity();
        case BsdfKind::rough_conductor:
        case BsdfKind::rough_dielectric:
        case BsdfKind::ward:
            return std::min(alpha_u, alpha_v);
        case BsdfKind::phong:
            return std::sqrt(2 / (exponent + 2));  // n = 2 / alpha^2 - 2     [Walter2007] section 5.2
        case BsdfKind::conductor:
        case BsdfKind::dielectric:
        case BsdfKind::thin_dielectric:
        case BsdfKind::null:
            return 0;
    }
    return 0;
}

/// Microfacet alpha of a BSDF's narrowest reflection, delta ones and coats included: 0 of a mirror or a smooth coat, 1
/// without any (diffuse), at most 1.
inline float specular_alpha(BsdfKind kind, float alpha_u, float alpha_v, float exponent) {
    switch (kind) {
        case BsdfKind::diffuse:
        case BsdfKind::rough_diffuse:
            return 1;
        case BsdfKind::plastic:
            return 0;
        case BsdfKind::rough_plastic:
            return std::min({alpha_u, alpha_v, 1.0f});
        default:
            return std::min(narrowest_lobe(kind, alpha_u, alpha_v, exponent), 1.0f);
    }
}

}  // namespace loom
