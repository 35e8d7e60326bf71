#pragma once
// Dispatch over the kinds of BSDF; adds the second side and the mask for all kinds.

#include "stages/core/scattering/conductor.h"
#include "stages/core/scattering/dielectric.h"
#include "stages/core/scattering/diffuse.h"
#include "stages/core/scattering/phong.h"
#include "stages/core/scattering/plastic.h"
#include "stages/core/scattering/ward.h"

namespace loom {

/// Passes straight through, as without a surface.
struct NullFamily : DeltaFamily {
    template <class T>
    static ChosenDirection<T> choose(const Bsdf<T>&, const Vector3<T>& wo, float, Point2f) {
        return {-wo, Lobe::null};
    }
    template <class T>
    static DeltaLobe<T> delta_lobe(const Bsdf<T>&, const Vector3<T>& wo, Lobe lobe) {
        return lobe == Lobe::null ? DeltaLobe<T>{Rgb<T>(T(1)), T(1), -wo} : DeltaLobe<T>{};
    }
    template <class T>
    static Rgb<T> albedo(const Bsdf<T>&, const Vector3<T>&) {
        return Rgb<T>(T(1));
    }
};

/// Calls f with the family of a kind; the only list of all families. Inlined together with f: passing directions
/// through memory would cost more than most formulas.
template <class F>
[[gnu::always_inline]] inline decltype(auto) with_family(BsdfKind kind, F&& f) {
    switch (kind) {
        case BsdfKind::diffuse:
            return f(DiffuseFamily{});
        case BsdfKind::rough_diffuse:
            return f(RoughDiffuseFamily{});
        case BsdfKind::conductor:
            return f(ConductorFamily{});
        case BsdfKind::rough_conductor:
            return f(RoughConductorFamily{});
        case BsdfKind::dielectric:
            return f(DielectricFamily{});
        case BsdfKind::thin_dielectric:
            return f(ThinDielectricFamily{});
        case BsdfKind::rough_dielectric:
            return f(RoughDielectricFamily{});
        case BsdfKind::plastic:
            return f(PlasticFamily{});
        case BsdfKind::rough_plastic:
            return f(RoughPlasticFamily{});
        case BsdfKind::phong:
            return f(PhongFamily{});
        case BsdfKind::ward:
            return f(WardFamily{});
        case BsdfKind::null:
            break;
    }
    return f(NullFamily{});
}

/// Whether wo is behind a two-sided surface. The surface then scatters as its own mirror image: both directions change
/// side.
template <class T>
bool seen_from_behind(const Bsdf<T>& b, const Vector3<T>& wo) {
    return b.model->two_sided && wo.z < T(0);
}
template <class T>
Vector3<T> mirrored(bool mirror, const Vector3<T>& w) {
    return {w.x, w.y, select(mirror, -w.z, w.z)};
}

/// Applies mask and second side to a delta lobe of a family, given its direction on the front.
template <class T>
void mask_and_mirror(const Bsdf<T>& b, const Vector3<T>& wo, Lobe lobe, DeltaLobe<T>& d) {
    d.wi = mirrored(seen_from_behind(b, wo), d.wi);
    d.value *= b.opacity;
    d.pmf = d.pmf * b.opacity;
    if (lobe == Lobe::null) {
        const T straight_on = T(1) - b.opacity;
        d.value += Rgb<T>(straight_on);
        d.pmf = d.pmf + straight_on;
        d.wi = -wo;
    }
}

/// Returns a delta lobe of the whole BSDF, with mask and second side.
template <class T>
DeltaLobe<T> delta_lobe(const Bsdf<T>& b, const Vector3<T>& wo, Lobe lobe) {
    DeltaLobe<T> d;
    with_family(
        b.model->kind, [&]<class Family>(Family) __attribute__((always_inline)) {
            d = Family::delta_lobe(b, mirrored(seen_from_behind(b, wo), wo), lobe);
        });
    mask_and_mirror(b, wo, lobe, d);
    return d;
}

template <class T>
BsdfValue<T> f_cos_pdf(const Bsdf<T>& b, const Vector3<T>& wo, const Vector3<T>& wi) {
    const bool behind = seen_from_behind(b, wo);
    BsdfValue<T> v;
    with_family(
        b.model->kind, [&]<class Family>(Family) __attribute__((always_inline)) {
            const BsdfValue<T> whole = Family::f_cos_pdf(b, mirrored(behind, wo), mirrored(behind, wi));
            v.f_cos = whole.f_cos * b.opacity;
            v.pdf_w = whole.pdf_w * b.opacity;
        });
    return v;
}

/// Fills the sample of a delta lobe; leaves it empty for a lobe of probability 0.
template <class T>
void set_delta_sample(BsdfSample<T>& s, const DeltaLobe<T>& d, Lobe lobe) {
    if (!(d.pmf > T(0))) return;
    s.wi = d.wi;
    s.weight = d.value / d.pmf;
    s.pmf = d.pmf;
    s.lobe = lobe;
    s.eta = d.eta;
}

template <class T>
BsdfSample<T> sample(const Bsdf<T>& b, const Vector3<T>& wo, float u_lobe, Point2f u) {
    // One object, filled field by field and returned in place: copying it stalls on its padding.
    BsdfSample<T> s;
    const float opacity = value_of(b.opacity);
    if (!(u_lobe < opacity)) {
        set_delta_sample(s, delta_lobe(b, wo, Lobe::null), Lobe::null);
        return s;
    }
    // The rest of u_lobe is uniform again, and must stay below 1.
    const float u_rest = opacity < 1.0f ? std::min(u_lobe / opacity, 0x1.fffffep-1f) : u_lobe;
    const bool behind = seen_from_behind(b, wo);
    const Vector3<T> wo_front = mirrored(behind, wo);
    with_family(
        b.model->kind, [&]<class Family>(Family) __attribute__((always_inline)) {
            const ChosenDirection<T> chosen = Family::choose(b, wo_front, u_rest, u);
            if (chosen.lobe == Lobe::none) return;
            if (Family::delta && is_delta(chosen.lobe)) {
                DeltaLobe<T> d = Family::delta_lobe(b, wo_front, chosen.lobe);
                mask_and_mirror(b, wo, chosen.lobe, d);
                set_delta_sample(s, d, chosen.lobe);
            } else if (Family::smooth) {
                const BsdfValue<T> v = Family::f_cos_pdf(b, wo_front, chosen.wi);
                if (!(v.pdf_w > T(0))) return;
                s.wi = mirrored(behind, chosen.wi);
                s.weight = v.f_cos / v.pdf_w;
                s.pdf_w = v.pdf_w * b.opacity;
                s.lobe = chosen.lobe;
                if (chosen.lobe == Lobe::glossy_transmission) s.eta = select(wo.z > T(0), b.eta, T(1) / b.eta);
            }
        });
    return s;
}

template <class T>
Rgb<T> delta_value(const Bsdf<T>& b, const Vector3<T>& wo, Lobe lobe) {
    return delta_lobe(b, wo, lobe).value;
}
template <class T>
T delta_pmf(const Bsdf<T>& b, const Vector3<T>& wo, Lobe lobe) {
    return delta_lobe(b, wo, lobe).pmf;
}
template <class T>
Vector3<T> delta_direction(const Bsdf<T>& b, const Vector3<T>& wo, Lobe lobe) {
    return delta_lobe(b, wo, lobe).wi;
}

template <class T>
Rgb<T> albedo(const Bsdf<T>& b, const Vector3<T>& wo) {
    const Rgb<T> a = with_family(
        b.model->kind, [&]<class Family>(Family) __attribute__((always_inline)) {
            return Family::albedo(b, mirrored(seen_from_behind(b, wo), wo));
        });
    const Rgb<T> whole = a * b.opacity + Rgb<T>(T(1) - b.opacity);
    return {clamp(whole.r, T(0), T(1)), clamp(whole.g, T(0), T(1)), clamp(whole.b, T(0), T(1))};
}

template <class T>
bool has_smooth_lobe(const Bsdf<T>& b) {
    return b.opacity > T(0) &&
           with_family(
               b.model->kind, []<class Family>(Family) __attribute__((always_inline)) { return Family::smooth; });
}

}  // namespace loom
