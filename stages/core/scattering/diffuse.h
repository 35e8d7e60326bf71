#pragma once
// Diffuse surfaces: Lambert's, and that of Oren and Nayar with Lambertian facets.

#include "stages/core/math/frame.h"
#include "stages/core/sampling/warp.h"
#include "stages/core/scattering/family.h"

namespace loom {

/// f = reflectance / π                                                         [Lambert1760]
struct DiffuseFamily : SmoothFamily {
    static constexpr bool coloured_base = true;

    template <class T>
    [[gnu::always_inline]] static Rgb<T> tint(const Bsdf<T>& b, const Vector3<T>&) {
        return b.diffuse;
    }
    template <class T>
    [[gnu::always_inline]] static T p_coat(const Bsdf<T>&, const Vector3<T>&) {
        return T(0);
    }
    template <class T>
    [[gnu::always_inline]] static LobeValues<T> lobes(const Bsdf<T>&, const Vector3<T>& wo, const Vector3<T>& wi,
                                                      const T&) {
        const T pdf = wi.z * inv_pi<T>;
        return one_sided(wo, wi, {pdf, T(0), pdf});
    }
    template <class T>
    [[gnu::always_inline]] static BsdfValue<T> f_cos_pdf(const Bsdf<T>& b, const Vector3<T>& wo, const Vector3<T>& wi) {
        return f_cos_pdf(b.diffuse, wo.z, wi.z);
    }
    /// The same, of reflectance and cosines alone.
    template <class T>
    [[gnu::always_inline]] static BsdfValue<T> f_cos_pdf(const Rgb<T>& reflectance, const T& cos_o, const T& cos_i) {
        const T pdf = cos_i * inv_pi<T>;
        const bool above = cos_o > T(0) && cos_i > T(0);
        return {select(above, reflectance * pdf, Rgb<T>()), select(above, pdf, T(0))};
    }
    template <class T>
    static ChosenDirection<T> choose(const Bsdf<T>&, const Vector3<T>& wo, float, Point2f u) {
        return {Vector3<T>(sample_cosine_hemisphere(u)), wo.z > T(0) ? Lobe::diffuse : Lobe::none};
    }
    template <class T>
    static Rgb<T> albedo(const Bsdf<T>& b, const Vector3<T>& wo) {
        return select(wo.z > T(0), b.diffuse, Rgb<T>());
    }
};

/// The full qualitative fit with interreflection; σ = alpha_u / √2 as in Mitsuba 0.6's `roughdiffuse`.
///                                                                    [OrenNayar1994] Eqs. (30)-(35)
struct RoughDiffuseFamily : DiffuseFamily {
    static constexpr bool coloured_base = false;

    template <class T>
    [[gnu::always_inline]] static BsdfValue<T> f_cos_pdf(const Bsdf<T>& b, const Vector3<T>& wo, const Vector3<T>& wi) {
        using std::atan2;
        using std::fabs;
        const T sigma2 = T(0.5) * sqr(b.alpha_u);
        const T sin_o = safe_sqrt(sin2_theta(wo)), sin_i = safe_sqrt(sin2_theta(wi));
        const T theta_o = atan2(sin_o, wo.z), theta_i = atan2(sin_i, wi.z);
        const bool tilted = sin_o > T(1e-4) && sin_i > T(1e-4);
        const T cos_phi = select(tilted, (wo.x * wi.x + wo.y * wi.y) / (sin_o * sin_i), T(0));

        // alpha is the larger of the two angles to the normal, beta the smaller one.
        const bool o_steeper = wo.z > wi.z;
        const T alpha = select(o_steeper, theta_i, theta_o), beta = select(o_steeper, theta_o, theta_i);
        const T sin_alpha = select(o_steeper, sin_i, sin_o), sin_beta = select(o_steeper, sin_o, sin_i);
        const T cos_alpha = select(o_steeper, wi.z, wo.z), cos_beta = select(o_steeper, wo.z, wi.z);

        const T ratio = sigma2 / (sigma2 + T(0.09));
        const T two_beta = T(2) * beta * inv_pi<T>;
        const T two_beta2 = two_beta * two_beta;
        const T c1 = T(1) - T(0.5) * sigma2 / (sigma2 + T(0.33));
        const T c2 = T(0.45) * ratio * select(cos_phi > T(0), sin_alpha, sin_alpha - two_beta2 * two_beta);
        const T c3 = T(0.125) * ratio * sqr(T(4) * inv_pi<T> * inv_pi<T> * alpha * beta);
        const T c4 = T(0.17) * sigma2 / (sigma2 + T(0.13));
        const T tan_mean = (sin_alpha + sin_beta) / (cos_alpha + cos_beta);  // of (alpha + beta) / 2
        const T single = c1 + cos_phi * c2 * (sin_beta / cos_beta) + (T(1) - fabs(cos_phi)) * c3 * tan_mean;
        const T twice = c4 * (T(1) - cos_phi * two_beta2);
        const T pdf = wi.z * inv_pi<T>;
        return one_sided(wo, wi, (b.diffuse * single + b.diffuse * b.diffuse * twice) * pdf, pdf);
    }
};

}  // namespace loom
