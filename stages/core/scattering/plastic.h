#pragma once
// A diffuse base under a dielectric coat, smooth or rough. Light that the coat reflects inside is scattered again; the
// series of these reflections is summed in closed form.

#include <algorithm>
#include <stdexcept>

#include "stages/core/scattering/family.h"
#include "stages/core/scattering/fresnel.h"
#include "stages/core/scattering/microfacet.h"

namespace loom {

/// Diffuse reflectance of the base under the coat, without the two transmissions through the interface.
///   ρ / (η² (1 - ρ R_in)), or ρ / (η² (1 - R_in)) without colour shifts (nonlinear = false)
template <class T>
[[gnu::always_inline]] inline Rgb<T> coated_diffuse(const Bsdf<T>& b, const T& inside_reflectance) {
    const T inv_eta2 = T(1) / (b.eta * b.eta);
    if (!b.model->nonlinear) return b.diffuse * (inv_eta2 / (T(1) - inside_reflectance));
    return b.diffuse / (Rgb<T>(T(1)) - b.diffuse * inside_reflectance) * inv_eta2;
}

struct PlasticFamily : SmoothFamily {
    static constexpr bool delta = true, coloured_base = true;

    template <class T>
    struct Energy {
        Rgb<T> specular, diffuse;  // reflectance of each lobe towards wo
        T transmitted;
        T p_specular() const { return share(max_channel(specular), max_channel(diffuse)); }
    };
    template <class T>
    [[gnu::always_inline]] static Energy<T> energy(const Bsdf<T>& b, const Vector3<T>& wo, const Rgb<T>& base) {
        const T F = fresnel_dielectric(wo.z, b.eta).reflectance;
        const T entering = T(1) - fresnel_diffuse_reflectance(b.eta);
        return {b.specular * F, base * ((T(1) - F) * entering), T(1) - F};
    }
    template <class T>
    [[gnu::always_inline]] static Rgb<T> base(const Bsdf<T>& b) {
        return coated_diffuse(b, fresnel_diffuse_reflectance(T(1) / b.eta));
    }
    template <class T>
    [[gnu::always_inline]] static Rgb<T> tint(const Bsdf<T>& b, const Vector3<T>& wo) {
        return base(b) * (T(1) - fresnel_dielectric(wo.z, b.eta).reflectance);
    }
    template <class T>
    [[gnu::always_inline]] static T p_coat(const Bsdf<T>& b, const Vector3<T>& wo) {
        return energy(b, wo, base(b)).p_specular();
    }
    template <class T>
    [[gnu::always_inline]] static LobeValues<T> lobes(const Bsdf<T>& b, const Vector3<T>& wo, const Vector3<T>& wi,
                                                      const T& p) {
        const T cosine = wi.z * inv_pi<T>;
        const T entering = T(1) - fresnel_dielectric(wi.z, b.eta).reflectance;
        return one_sided(wo, wi, {entering * cosine, T(0), (T(1) - p) * cosine});
    }
    template <class T>
    [[gnu::always_inline]] static BsdfValue<T> f_cos_pdf(const Bsdf<T>& b, const Vector3<T>& wo, const Vector3<T>& wi) {
        return two_lobes<PlasticFamily>(b, wo, wi);
    }
    template <class T>
    static ChosenDirection<T> choose(const Bsdf<T>& b, const Vector3<T>& wo, float u_lobe, Point2f u) {
        if (!(wo.z > T(0))) return {};
        if (T(u_lobe) < energy(b, wo, base(b)).p_specular()) return {reflect(wo), Lobe::delta_reflection};
        return {Vector3<T>(sample_cosine_hemisphere(u)), Lobe::diffuse};
    }
    template <class T>
    static DeltaLobe<T> delta_lobe(const Bsdf<T>& b, const Vector3<T>& wo, Lobe lobe) {
        if (lobe != Lobe::delta_reflection || !(wo.z > T(0))) return {};
        const Energy<T> e = energy(b, wo, base(b));
        return {e.specular, e.p_specular(), reflect(wo)};
    }
    template <class T>
    static Rgb<T> albedo(const Bsdf<T>& b, const Vector3<T>& wo) {
        const Energy<T> e = energy(b, wo, base(b));
        return select(wo.z > T(0), e.specular + e.diffuse, Rgb<T>());
    }
};

/// The transmittances of the rough coat come from the tables of prepare().
struct RoughPlasticFamily : SmoothFamily {
    static constexpr bool coloured_base = true;

    /// Returns an entry of the coat. With slopes it depends on alpha and eta to first order around the model's own
    /// values.
    /// in:      pick  RoughCoat -> T
    /// throws:  std::logic_error where alpha or eta moves with a parameter and prepare_coat_slopes() was not called
    template <class T, class Pick>
    [[gnu::always_inline]] static T entry(const Bsdf<T>& b, const Pick& pick) {
        const BsdfModel& m = *b.model;
        if (!m.coats) {
            const T value = pick(m.coat);
            if constexpr (std::is_same_v<T, float>) return value;
            if (!has_slopes(b, m.slopes != nullptr)) return value;
            return value + pick(m.slopes->by_alpha) * (b.alpha_u - T(m.alpha_u)) +
                   pick(m.slopes->by_eta) * (b.eta - T(m.eta()));
        }
        const auto [row, next, t] = m.coats->between(b.alpha_u);
        const T value = pick(m.coats->rows[row]) * (T(1) - t) + pick(m.coats->rows[next]) * t;
        if constexpr (std::is_same_v<T, float>) return value;
        const auto& slopes = m.coats->slopes;
        if (!has_slopes(b, !slopes.empty())) return value;
        return value + (pick(slopes[row].by_eta) * (T(1) - t) + pick(slopes[next].by_eta) * t) * (b.eta - T(m.eta()));
    }
    /// Transmittance of the coat, by linear interpolation of the table.
    template <class T>
    [[gnu::always_inline]] static T transmittance(const Bsdf<T>& b, const T& cos) {
        const T x = cos * T(n_transmittance - 1);
        const int i = std::min(std::max(static_cast<int>(value_of(x)), 0), n_transmittance - 2);
        const T t = x - T(static_cast<float>(i));
        return entry(
            b, [&](const RoughCoat& coat) __attribute__((always_inline)) {
                const float* table = coat.external_transmittance.data();
                return T(table[i]) * (T(1) - t) + T(table[i + 1]) * t;
            });
    }
    /// fdr_int or fdr_ext of the coat.
    template <class T>
    [[gnu::always_inline]] static T diffuse_reflectance(const Bsdf<T>& b, float RoughCoat::*side) {
        return entry(
            b, [&](const RoughCoat& coat) __attribute__((always_inline)) { return T(coat.*side); });
    }
    template <class T>
    [[gnu::always_inline]] static PlasticFamily::Energy<T> energy(const Bsdf<T>& b, const Vector3<T>& wo,
                                                                  const Rgb<T>& base) {
        const T through = transmittance(b, wo.z);
        return {b.specular * (T(1) - through), base * (through * (T(1) - diffuse_reflectance(b, &RoughCoat::fdr_ext))),
                through};
    }
    template <class T>
    [[gnu::always_inline]] static Rgb<T> base(const Bsdf<T>& b) {
        return coated_diffuse(b, diffuse_reflectance(b, &RoughCoat::fdr_int));
    }
    template <class T>
    [[gnu::always_inline]] static Rgb<T> tint(const Bsdf<T>& b, const Vector3<T>& wo) {
        return base(b) * transmittance(b, wo.z);
    }
    template <class T>
    [[gnu::always_inline]] static T p_coat(const Bsdf<T>& b, const Vector3<T>& wo) {
        return energy(b, wo, base(b)).p_specular();
    }
    template <class T>
    [[gnu::always_inline]] static LobeValues<T> lobes(const Bsdf<T>& b, const Vector3<T>& wo, const Vector3<T>& wi,
                                                      const T& p) {
        const MicrofacetDistribution<T> facets(b);
        const Vector3<T> h = normalize(wo + wi);
        const T cos_h = dot(wo, h);
        const T d = facets.D(h);
        const T F = fresnel_dielectric(cos_h, b.eta).reflectance;
        const T specular = F * d * facets.G1(wo, h) * facets.G1(wi, h) / (T(4) * wo.z);
        const T specular_pdf =
            b.model->sample_visible ? d * facets.G1_exact(wo) / (T(4) * wo.z) : d * h.z / (T(4) * cos_h);
        const T cosine = wi.z * inv_pi<T>;
        return one_sided(wo, wi, {transmittance(b, wi.z) * cosine, specular, p * specular_pdf + (T(1) - p) * cosine});
    }
    template <class T>
    [[gnu::always_inline]] static BsdfValue<T> f_cos_pdf(const Bsdf<T>& b, const Vector3<T>& wo, const Vector3<T>& wi) {
        return two_lobes<RoughPlasticFamily>(b, wo, wi);
    }
    template <class T>
    static ChosenDirection<T> choose(const Bsdf<T>& b, const Vector3<T>& wo, float u_lobe, Point2f u) {
        if (!(wo.z > T(0))) return {};
        if (!(T(u_lobe) < energy(b, wo, base(b)).p_specular()))
            return {Vector3<T>(sample_cosine_hemisphere(u)), Lobe::diffuse};
        const Vector3<T> m = MicrofacetDistribution<T>(b).sample(wo, u, b.model->sample_visible);
        const Vector3<T> wi = reflect(wo, m);
        return {wi, wi.z > T(0) ? Lobe::glossy_reflection : Lobe::none};
    }
    template <class T>
    static Rgb<T> albedo(const Bsdf<T>& b, const Vector3<T>& wo) {
        const PlasticFamily::Energy<T> e = energy(b, wo, base(b));
        return select(wo.z > T(0), e.specular + e.diffuse, Rgb<T>());
    }

  private:
    template <class T>
    static bool has_slopes(const Bsdf<T>& b, bool prepared) {
        if (!prepared && (moves(b.alpha_u) || moves(b.eta)))
            throw std::logic_error("rough plastic without prepare_coat_slopes()");
        return prepared;
    }
};

}  // namespace loom
