#pragma once
// Glass: a smooth interface, a thin sheet, a rough interface. All scatter from both sides.

#include "stages/core/scattering/family.h"
#include "stages/core/scattering/fresnel.h"
#include "stages/core/scattering/microfacet.h"

namespace loom {

/// Returns the probability of choosing reflection, in proportion to reflected and transmitted energy; F itself for
/// clear glass.
template <class T>
T reflection_pmf(const Bsdf<T>& b, const T& reflectance) {
    return share(reflectance * max_channel(b.specular), (T(1) - reflectance) * max_channel(b.transmittance));
}

struct DielectricFamily : DeltaFamily {
    template <class T>
    static ChosenDirection<T> choose(const Bsdf<T>& b, const Vector3<T>& wo, float u_lobe, Point2f) {
        const T p = reflection_pmf(b, fresnel_dielectric(wo.z, b.eta).reflectance);
        const Lobe lobe = T(u_lobe) < p ? Lobe::delta_reflection : Lobe::delta_transmission;
        return {delta_lobe(b, wo, lobe).wi, wo.z == T(0) ? Lobe::none : lobe};
    }
    template <class T>
    static DeltaLobe<T> delta_lobe(const Bsdf<T>& b, const Vector3<T>& wo, Lobe lobe) {
        const FresnelDielectric<T> f = fresnel_dielectric(wo.z, b.eta);
        const T p = reflection_pmf(b, f.reflectance);
        if (lobe == Lobe::delta_reflection) return {b.specular * f.reflectance, p, reflect(wo)};
        if (lobe != Lobe::delta_transmission) return {};
        // Radiance is compressed into the smaller solid angle on the denser side.
        const Rgb<T> value = b.transmittance * ((T(1) - f.reflectance) * sqr(f.eta_ti));
        return {value, T(1) - p, {-f.eta_ti * wo.x, -f.eta_ti * wo.y, f.cos_t}, f.eta_it};
    }
    template <class T>
    static Rgb<T> albedo(const Bsdf<T>& b, const Vector3<T>& wo) {
        const T r = fresnel_dielectric(wo.z, b.eta).reflectance;
        return b.specular * r + b.transmittance * (T(1) - r);
    }
};

/// Two parallel interfaces with the sum of their mutual reflections: R' = 2R / (1 + R). Light passes straight through.
struct ThinDielectricFamily : DeltaFamily {
    template <class T>
    static T reflectance(const Bsdf<T>& b, const Vector3<T>& wo) {
        using std::fabs;
        const T r = fresnel_dielectric(T(fabs(wo.z)), b.eta).reflectance;
        return r * (T(2) / (T(1) + r));
    }
    template <class T>
    static ChosenDirection<T> choose(const Bsdf<T>& b, const Vector3<T>& wo, float u_lobe, Point2f) {
        const bool reflects = T(u_lobe) < reflection_pmf(b, reflectance(b, wo));
        return {reflects ? reflect(wo) : -wo, reflects ? Lobe::delta_reflection : Lobe::delta_transmission};
    }
    template <class T>
    static DeltaLobe<T> delta_lobe(const Bsdf<T>& b, const Vector3<T>& wo, Lobe lobe) {
        const T r = reflectance(b, wo);
        const T p = reflection_pmf(b, r);
        if (lobe == Lobe::delta_reflection) return {b.specular * r, p, reflect(wo)};
        if (lobe != Lobe::delta_transmission) return {};
        return {b.transmittance * (T(1) - r), T(1) - p, -wo};
    }
    template <class T>
    static Rgb<T> albedo(const Bsdf<T>& b, const Vector3<T>& wo) {
        const T r = reflectance(b, wo);
        return b.specular * r + b.transmittance * (T(1) - r);
    }
};

/// f_r = F D G / (4 |cos_o cos_i|)                                       [Walter2007] Eq. (20)
/// f_t = |h·wo h·wi / (cos_o cos_i)| (1 - F) D G / (h·wo + η h·wi)²      [Walter2007] Eq. (21)
/// differs: η² of Eq. (21) cancels with the 1/η² of radiance; η is the index on wi's side over that on wo's
struct RoughDielectricFamily : SmoothFamily {
    /// Without visible-normal sampling the facets are sampled with a slightly larger roughness, which reduces the
    /// weights at grazing angles.                                         [Walter2007] §5.3
    template <class T>
    static MicrofacetDistribution<T> sampled_facets(const Bsdf<T>& b, const Vector3<T>& wo) {
        using std::fabs;
        using std::sqrt;
        const T scale = b.model->sample_visible ? T(1) : T(1.2) - T(0.2) * sqrt(T(fabs(wo.z)));
        const MicrofacetDistribution<T> facets(b);
        return {facets.type, facets.alpha_u * scale, facets.alpha_v * scale};
    }

    template <class T>
    [[gnu::always_inline]] static BsdfValue<T> f_cos_pdf(const Bsdf<T>& b, const Vector3<T>& wo, const Vector3<T>& wi) {
        using std::fabs;
        const bool reflects = wo.z * wi.z > T(0);
        const bool outside = wo.z > T(0);
        const T eta = select(outside, b.eta, T(1) / b.eta);
        const MicrofacetDistribution<T> facets(b);
        const Vector3<T> sum = wo + wi * select(reflects, T(1), eta);
        const Vector3<T> m = normalize(sum) * select(sum.z < T(0), T(-1), T(1));
        const T cos_o = dot(wo, m), cos_i = dot(wi, m);
        const T F = fresnel_dielectric(cos_o, b.eta).reflectance;
        const T p = reflection_pmf(b, F);
        // |dm / dwi|, and |dm / dwi| |cos_o|. In reflection cos_o = cos_i; rounding would break that equality.
        const T refraction = sqr(eta) * fabs(cos_i) / sqr(cos_o + eta * cos_i);
        const T jacobian = select(reflects, T(0.25) / fabs(cos_i), refraction);
        const T cos_jacobian = select(reflects, T(0.25), fabs(cos_o) * refraction);
        const T base = facets.D(m) * facets.G1(wo, m) * facets.G1(wi, m) * cos_jacobian / fabs(wo.z);
        const Rgb<T> f_cos =
            select(reflects, b.specular * (F * base), b.transmittance * ((T(1) - F) * base / sqr(eta)));

        const MicrofacetDistribution<T> sampled = sampled_facets(b, wo);
        const T pdf_m = b.model->sample_visible ? sampled.D(m) * sampled.G1_exact(wo) * cos_jacobian / fabs(wo.z)
                                                : sampled.D(m) * m.z * jacobian;
        const T pdf = pdf_m * select(reflects, p, T(1) - p);
        // Each direction must see the facet from the side from which it sees the surface.
        const bool faces = cos_o * wo.z > T(0) && cos_i * wi.z > T(0);
        return {select(faces, f_cos, Rgb<T>()), select(faces, pdf, T(0))};
    }
    template <class T>
    static ChosenDirection<T> choose(const Bsdf<T>& b, const Vector3<T>& wo, float u_lobe, Point2f u) {
        const Vector3<T> wo_up = wo * select(wo.z > T(0), T(1), T(-1));
        const Vector3<T> m = sampled_facets(b, wo).sample(wo_up, u, b.model->sample_visible);
        const T cos_o = dot(wo, m);
        if (!(cos_o * wo.z > T(0))) return {};  // wo sees the facet from its wrong side
        const FresnelDielectric<T> f = fresnel_dielectric(cos_o, b.eta);
        const bool reflects = T(u_lobe) < reflection_pmf(b, f.reflectance);
        const Vector3<T> wi = reflects ? reflect(wo, m) : refract(wo, m, f);
        const bool right_side = reflects ? wo.z * wi.z > T(0) : wo.z * wi.z < T(0);
        return {wi, !right_side ? Lobe::none : reflects ? Lobe::glossy_reflection : Lobe::glossy_transmission};
    }
    template <class T>
    static Rgb<T> albedo(const Bsdf<T>& b, const Vector3<T>& wo) {
        return DielectricFamily::albedo(b, wo);
    }
};

}  // namespace loom
