#pragma once
// A path vertex at which the BSDF can be evaluated in world directions: a hit point in the tracer, or in later stages a
// vertex (its own or a neighbour's) from a path graph.

#include "stages/core/math/frame.h"
#include "stages/core/scattering/bsdf.h"
#include "stages/core/scene/ray.h"

namespace loom {

/// T is float, or a Dual where vertices depend on a parameter.
template <class T>
struct ShadingPointOf {
    Point3<T> p;
    Vector3<T> wo;        // world, direction in which light leaves
    Vector3<T> wo_local;  // wo in `frame`
    Frame<T> frame;
    Normal3<T> ng;
    float hit_error = 0;  // Shape::hit_error, m
    Normal3<T> n_side;    // shading normal before a bump or normal map; equals frame.n without one
    bool perturbed = false;
    Bsdf<T> bsdf;

    ShadingPointOf() = default;
    /// Converts a point that depends on no parameter.
    template <class U>
    requires(!std::is_same_v<U, T>) explicit ShadingPointOf(const ShadingPointOf<U>& o)
        : p(o.p),
          wo(o.wo),
          wo_local(o.wo_local),
          frame(Vector3<T>(o.frame.s), Vector3<T>(o.frame.t), Normal3<T>(o.frame.n)),
          ng(o.ng),
          hit_error(o.hit_error),
          n_side(o.n_side),
          perturbed(o.perturbed),
          bsdf(o.bsdf) {}

    RayEnd end() const requires std::is_same_v<T, float> { return {p, ng, hit_error}; }
};
using ShadingPoint = ShadingPointOf<float>;

/// Factor of a bump or normal map on light from wi: smooths the darkening at the terminator of the bumps. 1 where the
/// material disables it, 0 where wi lies on different sides of the two normals.
///                [Estevez2019] "A Microfacet-Based Shadowing Function to Solve the Bump Terminator Problem", section 3.2
template <class T>
inline T bump_shadowing(const ShadingPointOf<T>& at, const Vector3<T>& wi, const T& cos_perturbed) {
    using std::sqrt;
    const T cos_side = dot(at.n_side, wi);
    if (!(cos_side * cos_perturbed > T(0))) return T(0);
    if (!at.bsdf.model->bump_shadowing) return T(1);
    const T cos_n = dot(at.n_side, at.frame.n);
    const T rest_n = T(1) - sqr(cos_n), rest_i = T(1) - sqr(cos_side);
    const T tan2_n = select(rest_n < T(0), T(0), rest_n) / sqr(cos_n);
    const T rough = T(0.125f) * tan2_n, alpha2 = select(T(1) < rough, T(1), rough);
    const T tan2_i = select(rest_i < T(0), T(0), rest_i) / sqr(cos_side);
    return T(2) / (T(1) + sqrt(T(1) + alpha2 * tan2_i));
}

/// Returns f |cos| for light from wi (world) and the density of BSDF sampling for wi (sr^-1).
template <class T>
inline BsdfValue<T> f_cos_pdf(const ShadingPointOf<T>& at, const Vector3<T>& wi) {
    const Vector3<T> wi_local = at.frame.to_local(wi);
    BsdfValue<T> value = f_cos_pdf(at.bsdf, at.wo_local, wi_local);
    if (at.perturbed) value.f_cos *= bump_shadowing(at, wi, wi_local.z);
    return value;
}

/// Power heuristic of two densities.                            [Veach1995] eq. (9.13) of the thesis
inline float power_heuristic(float pdf, float other) {
    const float ratio = other / pdf;
    return pdf > 0 ? 1 / (1 + ratio * ratio) : 0.0f;
}

}  // namespace loom
