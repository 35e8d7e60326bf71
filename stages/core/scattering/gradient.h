#pragma once
// Gradients of BSDF values with respect to the directions. A stored path is contracted with any number of parameters
// afterwards, so that each vertex is differentiated once.

#include <array>

#include "stages/core/scattering/bsdf_model.h"

namespace loom {

/// Below this cosine gradients are 0: those of Ward's lobe would overflow.
inline constexpr float grazing_cosine = 1e-10f;

/// BSDF times |cos(theta_i)| (sr^-1) and its gradient with respect to the components of both directions. Directions
/// are unit vectors: only the parts of by_wo and by_wi that are orthogonal to wo and wi have a meaning.
struct DirectionGradient {
    Spectrum f_cos;
    std::array<Spectrum, 3> by_wo, by_wi;  // [component x, y, z]
};

/// Returns the value of f_cos_pdf() and its gradient. Both are 0 where no light is scattered. The gradient is also 0
/// where a cosine is below 1e-10, which avoids overflow.
/// in:      wo, wi  unit, local
DirectionGradient f_cos_gradient(const Bsdf<float>& bsdf, const Vector3f& wo, const Vector3f& wi);

/// f_cos_gradient() of a diffuse BSDF, whose gradient is along the normal alone.
struct DiffuseGradient {
    Spectrum f_cos, by_wi_z;
};

/// Returns the values of f_cos_gradient(), bit for bit.
/// in:      wo_z, wi_z  cosines of wo and wi
/// needs:   bsdf is of kind diffuse
inline DiffuseGradient diffuse_gradient(const Bsdf<float>& bsdf, float wo_z, float wi_z) {
    const bool behind = bsdf.model->two_sided && wo_z < 0;
    const float out = behind ? -wo_z : wo_z, in = behind ? -wi_z : wi_z;
    if (!(out > 0 && in > 0)) return {};
    const Spectrum f_cos = bsdf.diffuse * (in * inv_pi<float>)*bsdf.opacity;
    if (!(out > grazing_cosine && in > grazing_cosine)) return {f_cos, {}};
    return {f_cos, bsdf.diffuse * ((behind ? -bsdf.opacity : bsdf.opacity) * inv_pi<float>)};
}

/// Reflectance or transmittance of a delta lobe and its gradient with respect to the components of wo. The direction
/// wi follows wo as the lobe's direction.
struct DeltaGradient {
    Spectrum value;
    std::array<Spectrum, 3> by_wo;  // [component x, y, z]
};

/// Returns the value of delta_value() and its gradient. Both are 0 where there is no such lobe.
/// in:      wo  unit, local
DeltaGradient delta_value_gradient(const Bsdf<float>& bsdf, const Vector3f& wo, Lobe lobe);

}  // namespace loom
