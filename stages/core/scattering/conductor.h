#pragma once
// Smooth and rough metals.

#include "stages/core/scattering/family.h"
#include "stages/core/scattering/fresnel.h"
#include "stages/core/scattering/microfacet.h"

namespace loom {

struct ConductorFamily : DeltaFamily {
    template <class T>
    static ChosenDirection<T> choose(const Bsdf<T>&, const Vector3<T>& wo, float, Point2f) {
        return {reflect(wo), wo.z > T(0) ? Lobe::delta_reflection : Lobe::none};
    }
    template <class T>
    static DeltaLobe<T> delta_lobe(const Bsdf<T>& b, const Vector3<T>& wo, Lobe lobe) {
        if (lobe != Lobe::delta_reflection || !(wo.z > T(0))) return {};
        return {albedo(b, wo), T(1), reflect(wo)};
    }
    template <class T>
    static Rgb<T> albedo(const Bsdf<T>& b, const Vector3<T>& wo) {
        return select(wo.z > T(0), b.specular * fresnel_conductor(wo.z, b.eta_c, b.k_c), Rgb<T>());
    }
};

/// f = F D G / (4 cos_o cos_i)                                          [Walter2007] Eq. (20)
struct RoughConductorFamily : SmoothFamily {
    template <class T>
    [[gnu::always_inline]] static BsdfValue<T> f_cos_pdf(const Bsdf<T>& b, const Vector3<T>& wo, const Vector3<T>& wi) {
        const MicrofacetDistribution<T> facets(b);
        const Vector3<T> h = normalize(wo + wi);
        const T cos_h = dot(wo, h);
        const T d = facets.D(h);
        const T value = d * facets.G1(wo, h) * facets.G1(wi, h) / (T(4) * wo.z);
        const T pdf = b.model->sample_visible ? d * facets.G1_exact(wo) / (T(4) * wo.z) : d * h.z / (T(4) * cos_h);
        const Rgb<T> f = fresnel_conductor(cos_h, b.eta_c, b.k_c);
        return one_sided(wo, wi, b.specular * f * value, pdf);
    }
    template <class T>
    static ChosenDirection<T> choose(const Bsdf<T>& b, const Vector3<T>& wo, float, Point2f u) {
        const Vector3<T> m = MicrofacetDistribution<T>(b).sample(wo, u, b.model->sample_visible);
        const Vector3<T> wi = reflect(wo, m);
        return {wi, wo.z > T(0) && wi.z > T(0) ? Lobe::glossy_reflection : Lobe::none};
    }
    template <class T>
    static Rgb<T> albedo(const Bsdf<T>& b, const Vector3<T>& wo) {
        return ConductorFamily::albedo(b, wo);
    }
};

}  // namespace loom
