#include "stages/core/scattering/gradient.h"

#include "stages/core/scattering/bsdf.h"
#include "stages/core/scattering/pullback.h"

namespace loom {
namespace {

/// A value and its gradient as a sum of colours times gradients of scalars, for directions on the front, without mask.
template <int n>
struct Terms {
    Spectrum f_cos;
    std::array<Spectrum, n> colour;
    std::array<DirectionCovector, n> by;
};

/// mirrored(), inlined by force: a call sends the direction through memory.
[[gnu::always_inline]] inline Vector3f inlined_mirrored(bool mirror, const Vector3f& w) {
    return {w.x, w.y, mirror ? -w.z : w.z};
}

/// Returns the gradient, with mask and second side.
template <int n>
[[gnu::always_inline]] inline DirectionGradient sum_of(const Terms<n>& terms, float opacity, bool behind) {
    const float opacity_z = behind ? -opacity : opacity;
    const auto sum = [&](float scale, auto&& component) __attribute__((always_inline)) {
        Spectrum s = terms.colour[0] * (scale * component(terms.by[0]));
        if constexpr (n > 1) s += terms.colour[1] * (scale * component(terms.by[1]));
        return s;
    };
    using By = const DirectionCovector&;
    return {terms.f_cos * opacity,
            {sum(opacity, [](By by) { return by.by_wo.x; }), sum(opacity, [](By by) { return by.by_wo.y; }),
             sum(opacity_z, [](By by) { return by.by_wo.z; })},
            {sum(opacity, [](By by) { return by.by_wi.x; }), sum(opacity, [](By by) { return by.by_wi.y; }),
             sum(opacity_z, [](By by) { return by.by_wi.z; })}};
}

/// Gradient of log(D G1(wo) G1(wi) / |wo.z|) for the facets with normal m = (wo + eta wi) inv_length.
[[gnu::always_inline]] inline DirectionCovector log_facets_gradient(const MicrofacetDistribution<float>& facets,
                                                                    const Vector3f& wo, const Vector3f& wi,
                                                                    const Vector3f& m, float inv_length, float eta) {
    const Vector3f by_sum = log_D_gradient(facets, m, inv_length);
    DirectionCovector by{by_sum + log_G1_over_z_gradient(facets, wo),
                         by_sum * eta + log_G1_over_z_gradient(facets, wi)};
    by.by_wi.z += 1 / wi.z;
    return by;
}

/// A covector with components along the normal alone.
DirectionCovector along_normal(float by_wo, float by_wi) {
    return {{0, 0, by_wo}, {0, 0, by_wi}};
}

// Terms of each kind that has formulas. Values are those of the families, bit for bit.

[[gnu::always_inline]] inline Terms<1> terms(DiffuseFamily, const Bsdf<float>& b, const Vector3f& wo,
                                             const Vector3f& wi) {
    const bool above = wo.z > 0 && wi.z > 0;
    return {DiffuseFamily::f_cos_pdf(b, wo, wi).f_cos, {b.diffuse}, {along_normal(0, above ? inv_pi<float> : 0)}};
}

[[gnu::always_inline]] inline Terms<2> terms(RoughConductorFamily, const Bsdf<float>& b, const Vector3f& wo,
                                             const Vector3f& wi) {
    const Spectrum f_cos = RoughConductorFamily::f_cos_pdf(b, wo, wi).f_cos;
    if (is_black(f_cos)) return {};
    const Vector3f sum = wo + wi;
    const float inv_length = 1 / length(sum);
    const Vector3f h = sum * inv_length;
    const float cos_h = dot(wo, h);
    const DirectionCovector by = log_facets_gradient(MicrofacetDistribution<float>(b), wo, wi, h, inv_length, 1);
    // cos_h = |wo + wi| / 2.
    const Vector3f half_h = h * 0.5f;
    const Spectrum log_F(log_fresnel_conductor_slope(cos_h, b.eta_c.r, b.k_c.r),
                         log_fresnel_conductor_slope(cos_h, b.eta_c.g, b.k_c.g),
                         log_fresnel_conductor_slope(cos_h, b.eta_c.b, b.k_c.b));
    return {f_cos, {f_cos, f_cos * log_F}, {by, {half_h, half_h}}};
}

[[gnu::always_inline]] inline Terms<1> terms(RoughDielectricFamily, const Bsdf<float>& b, const Vector3f& wo,
                                             const Vector3f& wi) {
    const Spectrum f_cos = RoughDielectricFamily::f_cos_pdf(b, wo, wi).f_cos;
    if (is_black(f_cos)) return {};
    const bool reflects = wo.z * wi.z > 0;
    const float eta_o = wo.z > 0 ? b.eta : 1 / b.eta;
    const float eta = reflects ? 1 : eta_o;
    const Vector3f sum = wo + wi * eta;
    const float inv_length = (sum.z < 0 ? -1.0f : 1.0f) / length(sum);
    const Vector3f m = sum * inv_length;
    const float cos_o = dot(wo, m), cos_i = dot(wi, m);
    DirectionCovector by = log_facets_gradient(MicrofacetDistribution<float>(b), wo, wi, m, inv_length, eta);
    if (reflects) {
        const Vector3f by_cos = m * (0.5f * fresnel_slope(cos_o, b.eta).log_R);
        by = {by.by_wo + by_cos, by.by_wi + by_cos};
    } else {
        // The rest is a function of the angle between wo and wi alone:
        //   d cos_o = η² cos_i / (cos_o + η cos_i)² d(wo·wi),  d cos_i = cos_o / (cos_o + η cos_i)² d(wo·wi)
        // The facet refracts wo into wi, so that cos_i is the refracted cosine. Computing it from cos_o would lose
        // digits near total reflection.
        const float log_T = fresnel_slope(cos_o, cos_i, eta_o).log_T;
        const float by_angle =
            (sqr(eta * cos_i - cos_o) / (cos_o * cos_i) - log_T * sqr(eta) * cos_i) * sqr(inv_length);
        by = {by.by_wo + wi * by_angle, by.by_wi + wo * by_angle};
    }
    return {f_cos, {f_cos}, {by}};
}

[[gnu::always_inline]] inline Terms<1> terms(PlasticFamily, const Bsdf<float>& b, const Vector3f& wo,
                                             const Vector3f& wi) {
    if (!(wo.z > 0 && wi.z > 0)) return {};
    const LobeValues<float> v = PlasticFamily::lobes(b, wo, wi, 0.0f);
    const FresnelSlope o = fresnel_slope(wo.z, b.eta), i = fresnel_slope(wi.z, b.eta);
    return {b.specular * v.coat + PlasticFamily::tint(b, wo) * v.base,
            {PlasticFamily::base(b)},
            {along_normal(-o.by_cos * i.transmittance * wi.z * inv_pi<float>,
                          o.transmittance * (i.transmittance - i.by_cos * wi.z) * inv_pi<float>)}};
}

/// Slope of the interpolated transmittance of a rough coat.
[[gnu::always_inline]] inline float transmittance_slope(const Bsdf<float>& b, float cos) {
    const int i = std::min(std::max(int(cos * float(n_transmittance - 1)), 0), n_transmittance - 2);
    return RoughPlasticFamily::entry(
        b, [&](const RoughCoat& coat) __attribute__((always_inline)) {
            const float* table = coat.external_transmittance.data();
            return (table[i + 1] - table[i]) * float(n_transmittance - 1);
        });
}

[[gnu::always_inline]] inline Terms<2> terms(RoughPlasticFamily, const Bsdf<float>& b, const Vector3f& wo,
                                             const Vector3f& wi) {
    if (!(wo.z > 0 && wi.z > 0)) return {};
    const LobeValues<float> v = RoughPlasticFamily::lobes(b, wo, wi, 0.0f);
    const Spectrum base = RoughPlasticFamily::base(b);
    const float through_o = RoughPlasticFamily::transmittance(b, wo.z);
    const float through_i = RoughPlasticFamily::transmittance(b, wi.z);
    Terms<2> t{b.specular * v.coat + RoughPlasticFamily::tint(b, wo) * v.base, {base, b.specular * v.coat}, {}};
    t.by[0].by_wo.z = transmittance_slope(b, wo.z) * v.base;
    t.by[0].by_wi.z = through_o * (through_i + transmittance_slope(b, wi.z) * wi.z) * inv_pi<float>;
    if (!(v.coat > 0)) return t;
    const Vector3f sum = wo + wi;
    const float inv_length = 1 / length(sum);
    const Vector3f h = sum * inv_length;
    const DirectionCovector by = log_facets_gradient(MicrofacetDistribution<float>(b), wo, wi, h, inv_length, 1);
    const Vector3f by_cos = h * (0.5f * fresnel_slope(dot(wo, h), b.eta).log_R);
    t.by[1] = {by.by_wo + by_cos, by.by_wi + by_cos};
    return t;
}

[[gnu::always_inline]] inline Terms<2> terms(PhongFamily, const Bsdf<float>& b, const Vector3f& wo,
                                             const Vector3f& wi) {
    if (!(wo.z > 0 && wi.z > 0)) return {};
    const LobeValues<float> v = PhongFamily::lobes(b, wo, wi, 0.0f);
    const Spectrum coat = b.specular * v.coat;
    Terms<2> t{coat + PhongFamily::tint(b, wo) * v.base, {b.diffuse, coat}, {}};
    t.by[0].by_wi.z = inv_pi<float>;
    if (!(v.coat > 0)) return t;
    const float by_cos = b.exponent / std::max(dot(reflect(wo), wi), 1e-20f);
    t.by[1] = {reflect(wi) * by_cos, reflect(wo) * by_cos};
    t.by[1].by_wi.z += 1 / wi.z;
    return t;
}

[[gnu::always_inline]] inline Terms<2> terms(WardFamily, const Bsdf<float>& b, const Vector3f& wo, const Vector3f& wi) {
    if (!(wo.z > 0 && wi.z > 0)) return {};
    const LobeValues<float> v = WardFamily::lobes(b, wo, wi, 0.0f);
    const Spectrum coat = b.specular * v.coat;
    Terms<2> t{coat + WardFamily::tint(b, wo) * v.base, {b.diffuse, coat}, {}};
    t.by[0].by_wi.z = inv_pi<float>;
    if (!(v.coat > 0)) return t;
    const Vector3f H = wo + wi;
    const float inv_z = 1 / H.z;
    // The exponent is homogeneous of degree 0 in H.
    Vector3f by_H{-2 * H.x * sqr(inv_z / b.alpha_u), -2 * H.y * sqr(inv_z / b.alpha_v), 0};
    by_H.z = -(by_H.x * H.x + by_H.y * H.y) * inv_z;
    Vector3f by_wo = by_H, by_wi = by_H;
    by_wi.z += 1 / wi.z;
    if (b.model->variant == WardVariant::balanced) {
        Vector3f by_normalisation = H * (2 / length2(H));
        by_normalisation.z -= 4 * inv_z;
        by_wo = by_wo + by_normalisation;
        by_wi = by_wi + by_normalisation;
    } else {
        const float power = b.model->variant == WardVariant::duer ? 1.0f : 0.5f;
        by_wo.z -= power / wo.z;
        by_wi.z -= power / wi.z;
    }
    t.by[1] = {by_wo, by_wi};
    return t;
}

/// Gradient by dual numbers, for rough_diffuse. It is rarely used, and its angles leave little to share.
DirectionGradient gradient_by_dual(const Bsdf<float>& b, const Vector3f& wo, const Vector3f& wi) {
    using T = Dual<6>;
    const auto variable = [](const Vector3f& v, int i) {
        return Vector3<T>{T::variable(v.x, i), T::variable(v.y, i + 1), T::variable(v.z, i + 2)};
    };
    const Rgb<T> f = f_cos_pdf(Bsdf<T>(b), variable(wo, 0), variable(wi, 3)).f_cos;
    DirectionGradient g{{f.r.value, f.g.value, f.b.value}, {}, {}};
    for (int k = 0; k < 3; ++k) {
        g.by_wo[k] = {f.r.d[k], f.g.d[k], f.b.d[k]};
        g.by_wi[k] = {f.r.d[k + 3], f.g.d[k + 3], f.b.d[k + 3]};
    }
    return g;
}

/// Derivative of a delta lobe's value with respect to wo.z, for wo on the front: delta lobes depend on nothing else.
Spectrum delta_slope(const Bsdf<float>& b, float z, Lobe lobe) {
    const bool reflects = lobe == Lobe::delta_reflection;
    if (!reflects && lobe != Lobe::delta_transmission) return {};
    switch (b.model->kind) {
        case BsdfKind::conductor:
            if (!(reflects && z > 0)) return {};
            return b.specular * Spectrum(fresnel_conductor_slope(z, b.eta_c.r, b.k_c.r),
                                         fresnel_conductor_slope(z, b.eta_c.g, b.k_c.g),
                                         fresnel_conductor_slope(z, b.eta_c.b, b.k_c.b));
        case BsdfKind::dielectric: {
            const FresnelDielectric<float> f = fresnel_dielectric(z, b.eta);
            const float by_cos = fresnel_slope(z, f.cos_t, f.eta_it).by_cos;
            return reflects ? b.specular * by_cos : b.transmittance * (-by_cos * sqr(f.eta_ti));
        }
        case BsdfKind::thin_dielectric: {
            const FresnelDielectric<float> f = fresnel_dielectric(std::fabs(z), b.eta);
            const float by_z =
                std::copysign(2 / sqr(1 + f.reflectance), z) * fresnel_slope(std::fabs(z), f.cos_t, f.eta_it).by_cos;
            return reflects ? b.specular * by_z : b.transmittance * -by_z;
        }
        case BsdfKind::plastic:
            return reflects && z > 0 ? b.specular * fresnel_slope(z, b.eta).by_cos : Spectrum();
        default:
            return {};
    }
}

}  // namespace

DirectionGradient f_cos_gradient(const Bsdf<float>& bsdf, const Vector3f& wo, const Vector3f& wi) {
    if (!(std::fabs(wo.z) > grazing_cosine && std::fabs(wi.z) > grazing_cosine))
        return {f_cos_pdf(bsdf, wo, wi).f_cos, {}, {}};
    if (bsdf.model->kind == BsdfKind::rough_diffuse) return gradient_by_dual(bsdf, wo, wi);
    const bool behind = seen_from_behind(bsdf, wo);
    return with_family(
        bsdf.model->kind, [&]<class Family>(Family family) __attribute__((always_inline)) {
            if constexpr (Family::smooth && !std::is_same_v<Family, RoughDiffuseFamily>)
                return sum_of(terms(family, bsdf, inlined_mirrored(behind, wo), inlined_mirrored(behind, wi)),
                              bsdf.opacity, behind);
            else
                return DirectionGradient{};
        });
}

DeltaGradient delta_value_gradient(const Bsdf<float>& bsdf, const Vector3f& wo, Lobe lobe) {
    const bool behind = seen_from_behind(bsdf, wo);
    DeltaGradient g{delta_value(bsdf, wo, lobe), {}};
    g.by_wo[2] = delta_slope(bsdf, behind ? -wo.z : wo.z, lobe) * (behind ? -bsdf.opacity : bsdf.opacity);
    return g;
}

}  // namespace loom
