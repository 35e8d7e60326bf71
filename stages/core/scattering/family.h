#pragma once
// Interface between a family of BSDFs and the dispatch of bsdf.inl. Each family is a struct of static templates over
// the number T, so that a loop over vertices of one kind inlines only its formula:
//   f_cos_pdf(bsdf, wo, wi)       as in bsdf.h, without mask and second side; zero on the back
//   choose(bsdf, wo, u_lobe, u)   lobe and direction
//   delta_lobe(bsdf, wo, lobe)    a lobe without width
//   albedo(bsdf, wo)              as in bsdf.h
//   tint(bsdf, wo), p_coat(bsdf, wo), lobes(bsdf, wo, wi, p_coat)   where colour and direction separate: see LobeValues
// f_cos_pdf and its callees are inlined by force: a call prevents vectorisation of loops over columns. The bases below
// provide defaults for the functions that a family lacks.

#include "stages/core/scattering/bsdf_model.h"

namespace loom {

template <class T>
struct ChosenDirection {
    Vector3<T> wi;
    Lobe lobe = Lobe::none;
};

template <class T>
struct DeltaLobe {
    Rgb<T> value;  // not divided by the pmf
    T pmf{};
    Vector3<T> wi;
    T eta{1};
};

/// A coloured base under a coat: f_cos = tint(wo) base + specular coat. Families with coloured_base provide three
/// functions, from which two_lobes() makes their f_cos_pdf(): tint(), lobes(), and p_coat(), the probability of
/// sampling the coat.
template <class T>
struct LobeValues {
    T base{}, coat{}, pdf_w{};
};
template <class Family, class T>
[[gnu::always_inline]] inline BsdfValue<T> two_lobes(const Bsdf<T>& b, const Vector3<T>& wo, const Vector3<T>& wi) {
    const LobeValues<T> v = Family::lobes(b, wo, wi, Family::p_coat(b, wo));
    return {b.specular * v.coat + Family::tint(b, wo) * v.base, v.pdf_w};
}

struct SmoothFamily {
    static constexpr bool smooth = true, delta = false, coloured_base = false;
    template <class T>
    static DeltaLobe<T> delta_lobe(const Bsdf<T>&, const Vector3<T>&, Lobe) {
        return {};
    }
};

struct DeltaFamily {
    static constexpr bool smooth = false, delta = true, coloured_base = false;
    template <class T>
    static BsdfValue<T> f_cos_pdf(const Bsdf<T>&, const Vector3<T>&, const Vector3<T>&) {
        return {};
    }
};

/// Returns the value if both directions are above the surface, else zero.
template <class T>
BsdfValue<T> one_sided(const Vector3<T>& wo, const Vector3<T>& wi, const Rgb<T>& f_cos, const T& pdf_w) {
    const bool above = wo.z > T(0) && wi.z > T(0);
    return {select(above, f_cos, Rgb<T>()), select(above, pdf_w, T(0))};
}

template <class T>
[[gnu::always_inline]] inline LobeValues<T> one_sided(const Vector3<T>& wo, const Vector3<T>& wi,
                                                      const LobeValues<T>& v) {
    const bool above = wo.z > T(0) && wi.z > T(0);
    return {select(above, v.base, T(0)), select(above, v.coat, T(0)), select(above, v.pdf_w, T(0))};
}

/// Returns the probability of choosing the first of two lobes that reflect `a` and `b`. It is proportional to their
/// reflectances, so that no sample of either weighs much more than both together. A lobe of reflectance 0 is never
/// chosen.
template <class T>
T share(const T& a, const T& b) {
    const T sum = a + b;
    return select(sum > T(0), a / sum, T(0));
}

}  // namespace loom
