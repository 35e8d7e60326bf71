#pragma once
// The modified Phong model of Mitsuba 0.6: a diffuse lobe and a power of the cosine to the mirror direction.

#include "stages/core/math/frame.h"
#include "stages/core/sampling/warp.h"
#include "stages/core/scattering/family.h"

namespace loom {

/// f = ρ_d / π + ρ_s (n + 2) / 2π · max(cos a, 0)ⁿ, a the angle between wi and the mirror direction
///                                                                      [LafortuneWillems1994] Eq. (4)
struct PhongFamily : SmoothFamily {
    static constexpr bool coloured_base = true;

    /// Chooses lobes in proportion to the largest weight that each can reach from wo. For the diffuse lobe this is its
    /// reflectance; for the glossy one its reflectance times the largest cosine within about its width.
    template <class T>
    [[gnu::always_inline]] static T p_coat(const Bsdf<T>& b, const Vector3<T>& wo) {
        using std::sqrt;
        const T n = b.exponent;
        const T reach = wo.z + T(1.5f) / sqrt(n + T(1));
        const T largest = select(reach < T(1), reach, T(1)) * ((n + T(2)) / (n + T(1)));
        return share(max_channel(b.specular) * largest, max_channel(b.diffuse));
    }
    template <class T>
    [[gnu::always_inline]] static Rgb<T> tint(const Bsdf<T>& b, const Vector3<T>&) {
        return b.diffuse;
    }
    template <class T>
    [[gnu::always_inline]] static LobeValues<T> lobes(const Bsdf<T>& b, const Vector3<T>& wo, const Vector3<T>& wi,
                                                      const T& p) {
        using std::pow;
        const T n = b.exponent;
        const T cos_a = dot(reflect(wo), wi);
        const T power =
            select(cos_a > T(0), T(pow(select(cos_a > T(0), cos_a, T(1)), n)), T(0)) * T(0.5f * inv_pi<float>);
        const T cosine = wi.z * inv_pi<T>;
        return one_sided(wo, wi, {cosine, (n + T(2)) * power * wi.z, p * (n + T(1)) * power + (T(1) - p) * cosine});
    }
    template <class T>
    [[gnu::always_inline]] static BsdfValue<T> f_cos_pdf(const Bsdf<T>& b, const Vector3<T>& wo, const Vector3<T>& wi) {
        return two_lobes<PhongFamily>(b, wo, wi);
    }
    template <class T>
    static ChosenDirection<T> choose(const Bsdf<T>& b, const Vector3<T>& wo, float u_lobe, Point2f u) {
        if (!(wo.z > T(0))) return {};
        if (!(T(u_lobe) < p_coat(b, wo))) return {Vector3<T>(sample_cosine_hemisphere(u)), Lobe::diffuse};
        const float cos_a = std::pow(1.0f - u.y, 1.0f / (value_of(b.exponent) + 1.0f));
        const float sin_a = safe_sqrt(1.0f - cos_a * cos_a);
        const SinCos phi = sin_cos_turn(u.x);
        const Frame<T> around(Normal3<T>(reflect(wo)));
        const Vector3<T> wi = around.to_world({T(sin_a * phi.cos), T(sin_a * phi.sin), T(cos_a)});
        return {wi, wi.z > T(0) ? Lobe::glossy_reflection : Lobe::none};
    }
    template <class T>
    static Rgb<T> albedo(const Bsdf<T>& b, const Vector3<T>& wo) {
        return select(wo.z > T(0), b.diffuse + b.specular * wo.z, Rgb<T>());
    }
};

}  // namespace loom
