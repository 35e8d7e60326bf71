#pragma once
// Derivatives of the factors of microfacet models, written by hand. Factors are positive where they contribute, so that
// most derivatives here are logarithmic: the gradient of a product is its value times a sum.
// A formula that holds for unit directions may be differentiated in any form that is equal for unit directions.

#include "stages/core/scattering/fresnel.h"
#include "stages/core/scattering/microfacet.h"

namespace loom {

/// Gradient of a scalar with respect to the components of both directions.
struct DirectionCovector {
    Vector3f by_wo, by_wi;
};

/// Returns the gradient of log D(normalize(S)) with respect to S.
///   D is homogeneous of degree -4, thus m · ∇ log D = -4, and the part of ∇ log D along m is known.
/// in:      m           normal at which D > 0; S is a multiple of it
///          inv_length  1 / |S|, negative if S points into the surface
[[gnu::always_inline]] inline Vector3f log_D_gradient(const MicrofacetDistribution<float>& facets, const Vector3f& m,
                                                      float inv_length) {
    const float u2 = sqr(facets.alpha_u), v2 = sqr(facets.alpha_v);
    Vector3f by_m;
    if (facets.type == Microfacet::beckmann) {
        const float scale = -2 / (u2 * v2 * m.z * m.z);
        by_m.x = scale * v2 * m.x;
        by_m.y = scale * u2 * m.y;
        by_m.z = -(4 + m.x * by_m.x + m.y * by_m.y) / m.z;
    } else {
        const float area = u2 * v2;
        by_m = Vector3f{m.x * v2, m.y * u2, m.z * area} * (-4 / (m.x * m.x * v2 + m.y * m.y * u2 + m.z * m.z * area));
    }
    return (by_m + m * 4.0f) * inv_length;
}

/// Returns the gradient of log(G1(v) / |v.z|) with respect to v. G1 / |v.z| stays finite at grazing angles; its
/// derivative with respect to v.z would be lost in the difference of those of G1 and |v.z|.
[[gnu::always_inline]] inline Vector3f log_G1_over_z_gradient(const MicrofacetDistribution<float>& facets,
                                                              const Vector3f& v) {
    const float u2 = sqr(facets.alpha_u), v2 = sqr(facets.alpha_v);
    const float z = std::fabs(v.z);
    const float xy = sqr(facets.alpha_u * v.x) + sqr(facets.alpha_v * v.y);
    float by_z, by_xy;
    if (facets.type == Microfacet::ggx) {
        // G1 / z = 2 / (z + root), root² = z² + xy.
        const float root = std::sqrt(z * z + xy);
        const float inverse = 1 / (root * (z + root));
        by_z = -(z + root) * inverse;
        by_xy = -0.5f * inverse;
    } else {
        // G1 = a (c1 + c2 a) / (1 + a (c3 + c4 a)) for a = z / √xy < 1.6, else 1.
        const float some_xy = xy > 1e-20f ? xy : 1e-20f;
        const float inv_root = 1 / std::sqrt(some_xy);
        const float a = z * inv_root;
        if (a >= 1.6f) return {0, 0, -1 / v.z};
        const float by_a =
            2.181f / (3.535f + 2.181f * a) - (2.276f + 2 * 2.577f * a) / (1 + a * (2.276f + 2.577f * a));  // of G1 / a
        by_z = by_a * inv_root;
        by_xy = -0.5f * (by_a * a + 1) * sqr(inv_root);
    }
    return {2 * u2 * v.x * by_xy, 2 * v2 * v.y * by_xy, v.z < 0 ? -by_z : by_z};
}

/// Derivatives of the reflectance R of a dielectric interface with respect to the cosine of the incident direction.
///   R' = (η² - 1) (n_s d_p³ - n_p d_s³) / (d_s d_p)³ · 2 / (η cos_t), with n and d as in fresnel_dielectric()
///   1 - R = 2 η cos_i cos_t (d_s² + d_p²) / (d_s d_p)², without cancellation
struct FresnelSlope {
    float transmittance;  // 1 - R
    float by_cos;         // R'
    float log_R;          // R' / R
    float log_T;          // R' / (1 - R)
};

/// Differentiates the reflectance of a dielectric interface, given both cosines. Callers use some of the results; the
/// others cost nothing once this is inlined.
/// in:      cos_i, cos_t  of the incident and the refracted direction; only their magnitudes and the sign of cos_i
///                        matter; cos_t = 0 at total reflection, where all results are 0
///          eta_it        index on the far side over that on the near side
[[gnu::always_inline]] inline FresnelSlope fresnel_slope(float cos_i, float cos_t, float eta_it) {
    const float c = std::fabs(cos_i), t = std::fabs(cos_t);
    if (!(t > 0)) return {};
    const float d_s = c + eta_it * t, n_s = c - eta_it * t;
    const float d_p = t + eta_it * c, n_p = t - eta_it * c;
    const float s2 = d_s * d_s, p2 = d_p * d_p, both = d_s * d_p;
    const float numerator = (cos_i < 0 ? -2.0f : 2.0f) * (eta_it * eta_it - 1) * (n_s * p2 * d_p - n_p * s2 * d_s);
    const float reflected = 0.5f * (n_s * n_s * p2 + n_p * n_p * s2), passed = 2 * eta_it * c * t * (s2 + p2);
    const float denominator = eta_it * t * both;
    return {passed / (both * both), numerator / (denominator * both * both),
            reflected > 0 ? numerator / (denominator * reflected) : 0,
            passed > 0 ? numerator / (denominator * passed) : 0};
}
[[gnu::always_inline]] inline FresnelSlope fresnel_slope(float cos_i, float eta) {
    const FresnelDielectric<float> f = fresnel_dielectric(cos_i, eta);
    return fresnel_slope(cos_i, f.cos_t, f.eta_it);
}

/// Returns the derivative of log fresnel_conductor() with respect to cos_i; 0 where nothing is reflected.
[[gnu::always_inline]] inline float log_fresnel_conductor_slope(float cos_i, float eta, float k) {
    const float c2 = cos_i * cos_i;
    const float s2 = 1 - c2;
    const float difference = eta * eta - k * k - s2;
    const float a2_b2 = safe_sqrt(difference * difference + 4 * k * k * eta * eta);
    const float a = safe_sqrt(0.5f * (a2_b2 + difference));
    const float t1 = a2_b2 + c2;
    const float t2 = 2 * cos_i * a;
    const float t3 = a2_b2 * c2 + s2 * s2;
    const float t4 = t2 * s2;
    if (!(a2_b2 > 0 && t1 > t2)) return 0;
    // With respect to c2 the derivative of a2_b2 is difference / a2_b2, and that of a is a / (2 a2_b2).
    const float inv_a2_b2 = 1 / a2_b2;
    const float dt1 = 4 * cos_i * a * a * inv_a2_b2;
    const float dt2 = 2 * a * t1 * inv_a2_b2;
    const float dt3 = 2 * cos_i * (difference * c2 * inv_a2_b2 + a2_b2 - 2 * s2);
    const float dt4 = dt2 * s2 - 2 * cos_i * t2;
    // (t1 - t2) / (t1 + t2) and t3 / (t3 + t4).
    return 2 * (dt1 * t2 - t1 * dt2) / ((t1 - t2) * (t1 + t2)) + (dt3 * t4 - t3 * dt4) / (t3 * (t3 + t4));
}
/// Returns the derivative of fresnel_conductor() with respect to cos_i.
[[gnu::always_inline]] inline float fresnel_conductor_slope(float cos_i, float eta, float k) {
    return fresnel_conductor(cos_i, eta, k) * log_fresnel_conductor_slope(cos_i, eta, k);
}

}  // namespace loom
