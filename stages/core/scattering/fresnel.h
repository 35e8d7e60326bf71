#pragma once
// Reflectance of an interface.

#include "stages/core/math/vector.h"

namespace loom {

template <class T>
struct FresnelDielectric {
    T reflectance;
    T cos_t;   // cosine of the refracted direction; 0 at total internal reflection; sign opposite to cos_i
    T eta_it;  // index on the far side over that on the near side
    T eta_ti;  // 1 / eta_it: scale of the tangential part of the refracted direction
};

/// Unpolarised reflectance of an interface between two dielectrics, and the refracted direction.
///   R = (r_s² + r_p²) / 2                                            [Fresnel]
/// in:      cos_i   1   cosine of the incident direction; negative below the interface
///          eta     1   index below the interface over that above it
template <class T>
[[gnu::always_inline]] inline FresnelDielectric<T> fresnel_dielectric(const T& cos_i, const T& eta) {
    using std::fabs;
    const bool outside = cos_i >= T(0);
    const T inv_eta = T(1) / eta;
    const T eta_it = select(outside, eta, inv_eta);
    const T eta_ti = select(outside, inv_eta, eta);
    const T c_i = fabs(cos_i);
    const T c_t = safe_sqrt(T(1) - (T(1) - c_i * c_i) * (eta_ti * eta_ti));
    // r_s = n_s / d_s, r_p = n_p / d_p, over one denominator.
    const T n_s = c_i - eta_it * c_t, d_s = c_i + eta_it * c_t;
    const T n_p = c_t - eta_it * c_i, d_p = c_t + eta_it * c_i;
    const T mean = T(0.5) * (sqr(n_s * d_p) + sqr(n_p * d_s)) / sqr(d_s * d_p);
    // Equal indices at a grazing angle give 0/0 above.
    const bool matched = eta == T(1);
    const T r = select(matched, T(0), select(c_i == T(0), T(1), mean));
    return {r, select(outside, -c_t, c_t), eta_it, eta_ti};
}

/// Unpolarised reflectance of a conductor with the complex index eta + i k, relative to the outside.
///                                                                    [Moeller1988]
/// differs: only squares of eta and k enter, so a negative value (found in published scenes) acts as its absolute value
template <class T>
[[gnu::always_inline]] inline T fresnel_conductor(const T& cos_i, const T& eta, const T& k) {
    const T c2 = cos_i * cos_i;
    const T s2 = T(1) - c2;
    const T difference = eta * eta - k * k - s2;
    const T a2_b2 = safe_sqrt(difference * difference + T(4) * k * k * eta * eta);
    const T a = safe_sqrt(T(0.5) * (a2_b2 + difference));
    const T t1 = a2_b2 + c2;
    const T t2 = T(2) * cos_i * a;
    const T t3 = a2_b2 * c2 + s2 * s2;
    const T t4 = t2 * s2;
    // R_s = (t1 - t2) / (t1 + t2), R_p = R_s (t3 - t4) / (t3 + t4), and their mean over one denominator.
    return (t1 - t2) * t3 / ((t1 + t2) * (t3 + t4));
}
template <class T>
[[gnu::always_inline]] inline Rgb<T> fresnel_conductor(const T& cos_i, const Rgb<T>& eta, const Rgb<T>& k) {
    return {fresnel_conductor(cos_i, eta.r, k.r), fresnel_conductor(cos_i, eta.g, k.g),
            fresnel_conductor(cos_i, eta.b, k.b)};
}

/// Reflectance of a dielectric interface under diffuse illumination, from fits.
///   eta < 1: [EganHilgeman1973], eta >= 1: [dEonIrving2011]; within 0.6 % for 1/2 < eta < 10
template <class T>
[[gnu::always_inline]] inline T fresnel_diffuse_reflectance(const T& eta) {
    const T x = T(1) / eta;
    const T below = T(0.0636) * x + T(0.6681) + eta * (T(0.7099) - eta * T(1.4399));
    const T above =
        T(0.919317) + x * (T(-3.4793) + x * (T(6.75335) + x * (T(-7.80989) + x * (T(4.98554) - x * T(1.36881)))));
    return select(eta < T(1), below, above);
}

/// Mirror direction of w about the unit normal m.
template <class T>
Vector3<T> reflect(const Vector3<T>& w, const Vector3<T>& m) {
    return m * (T(2) * dot(w, m)) - w;
}

/// Refracted direction of w about the unit normal m; f is the result of fresnel_dielectric(dot(w, m), eta).
template <class T>
Vector3<T> refract(const Vector3<T>& w, const Vector3<T>& m, const FresnelDielectric<T>& f) {
    return m * (dot(w, m) * f.eta_ti + f.cos_t) - w * f.eta_ti;
}

}  // namespace loom
