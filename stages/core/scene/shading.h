#pragma once
// A vertex of a path, ready to be asked for its BSDF in world directions: by the tracer at the point that
// it has hit, and by every later stage at a vertex (its own or a neighbour's) read from a path graph.

#include "stages/core/math/frame.h"
#include "stages/core/scattering/bsdf.h"
#include "stages/core/scene/ray.h"

namespace loom {

struct ShadingPoint {
    Point3f p;
    Vector3f wo;        // world, towards where the light leaves
    Vector3f wo_local;  // the same in `frame`
    Framef frame;
    Normal3f ng;
    float hit_error = 0;  // of its shape, m; what lies between the point and its rays' origins
    Normal3f n_side;      // shading normal before a bump or normal map; equals frame.n without one
    bool perturbed = false;
    Bsdf<float> bsdf;

    RayEnd end() const { return {p, ng, hit_error}; }
};

/// Shadowing of a bump or normal map for light from wi, so that the darkening at the terminator of the
/// bumps is smooth; 1 where the material switches it off.       [Estevez2019] "A Microfacet-Based Shadowing Function to
/// Solve the Bump
///                        Terminator Problem", section 3.2; 0 when wi lies on different sides of the two normals
inline float bump_shadowing(const ShadingPoint& at, const Vector3f& wi, float cos_perturbed) {
    const float cos_side = dot(at.n_side, wi);
    if (!(cos_side * cos_perturbed > 0)) return 0;
    if (!at.bsdf.model->bump_shadowing) return 1;
    const float cos_n = dot(at.n_side, at.frame.n);
    const float tan2_n = std::max(1 - sqr(cos_n), 0.0f) / sqr(cos_n);
    const float alpha2 = std::min(0.125f * tan2_n, 1.0f);
    const float tan2_i = std::max(1 - sqr(cos_side), 0.0f) / sqr(cos_side);
    return 2 / (1 + std::sqrt(1 + alpha2 * tan2_i));
}

/// f |cos| for light from wi (world) and the density of BSDF sampling for wi (sr^-1).
inline BsdfValue<float> f_cos_pdf(const ShadingPoint& at, const Vector3f& wi) {
    const Vector3f wi_local = at.frame.to_local(wi);
    BsdfValue<float> value = f_cos_pdf(at.bsdf, at.wo_local, wi_local);
    if (at.perturbed) value.f_cos *= bump_shadowing(at, wi, wi_local.z);
    return value;
}

/// Power heuristic of two densities.                            [Veach1995] eq. (9.13) of the thesis
inline float power_heuristic(float pdf, float other) {
    const float ratio = other / pdf;
    return pdf > 0 ? 1 / (1 + ratio * ratio) : 0.0f;
}

}  // namespace loom
