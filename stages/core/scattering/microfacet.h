#pragma once
// Distribution of microfacet normals of a rough surface: its value, its shadowing, and its sampling.

#include "stages/core/math/dual.h"
#include "stages/core/math/exponential.h"
#include "stages/core/math/frame.h"
#include "stages/core/sampling/warp.h"
#include "stages/core/scattering/bsdf_model.h"

namespace loom {

/// Inverse of the error function, relative error below 4e-7.       [Giles2010] single precision
template <class T>
T erf_inv(const T& x) {
    using std::log;
    using std::sqrt;
    const T w = -log((T(1) - x) * (T(1) + x));
    const T c = w - T(2.5);
    T centre = T(2.81022636e-08);
    for (const double a : {3.43273939e-07, -3.5233877e-06, -4.39150654e-06, 0.00021858087, -0.00125372503,
                           -0.00417768164, 0.246640727, 1.50140941})
        centre = T(a) + centre * c;
    const T s = safe_sqrt(w) - T(3);
    T tail = T(-0.000200214257);
    for (const double a : {0.000100950558, 0.00134934322, -0.00367342844, 0.00573950773, -0.0076224613, 0.00943887047,
                           1.00167406, 2.83297682})
        tail = T(a) + tail * s;
    return select(w < T(5), centre, tail) * x;
}

/// Distribution of microfacet normals at one point of a rough surface.
/// needs:   directions and normals unit, local; normals in the upper hemisphere
template <class T>
struct MicrofacetDistribution {
    Microfacet type;
    T alpha_u, alpha_v;

    MicrofacetDistribution(Microfacet type_, const T& u, const T& v)
        : type(type_), alpha_u(select(u > T(1e-4), u, T(1e-4))), alpha_v(select(v > T(1e-4), v, T(1e-4))) {}
    explicit MicrofacetDistribution(const Bsdf<T>& b)
        : MicrofacetDistribution(b.model->distribution, b.alpha_u, b.alpha_v) {}

    /// Density of normals by projected solid angle: ∫ D cos = 1 (sr^-1).     [Walter2007] Eqs. (25), (33)
    [[gnu::always_inline]] T D(const Vector3<T>& m) const {
        const T area = alpha_u * alpha_v;
        const T z2 = m.z * m.z;
        T d;
        if (type == Microfacet::beckmann) {
            const T slope2 = (sqr(m.x * alpha_v) + sqr(m.y * alpha_u)) / (area * area * z2);
            d = exponential(-slope2) / (pi<T> * area * z2 * z2);
        } else {
            const T q = sqr(m.x * alpha_v) + sqr(m.y * alpha_u) + sqr(m.z * area);
            d = area * area * area / (pi<T> * q * q);
        }
        return select(d * m.z > T(1e-20), d, T(0));
    }

    /// Smith's fraction of the facets with normal m that are visible from v. Beckmann uses the rational fit of Mitsuba
    /// (within 0.35 %).                                     [Walter2007] Eqs. (27), (34)
    [[gnu::always_inline]] T G1(const Vector3<T>& v, const Vector3<T>& m) const {
        const T g = type == Microfacet::ggx ? smith_ggx(v) : smith_beckmann_fit(v);
        return select(dot(v, m) * v.z > T(0), g, T(0));
    }

    /// Smith's fraction without approximation, which normalises the density of visible normals.
    [[gnu::always_inline]] T G1_exact(const Vector3<T>& v) const {
        return type == Microfacet::ggx ? smith_ggx(v) : smith_beckmann(v);
    }

    /// Samples a normal of this surface. With `visible`, among those visible from w, with the density
    ///   D G1_exact(w) max(w·m, 0) / w.z (sr^-1)                            [HeitzDEon2014] Eq. (2)
    /// else among all normals, with D m.z.
    /// needs:   w in the upper hemisphere
    Vector3<T> sample(const Vector3<T>& w, Point2f u, bool visible) const {
        if (!visible) return sample_all(u);
        return type == Microfacet::ggx ? sample_visible_ggx(w, u) : sample_visible_beckmann(w, u);
    }

  private:
    T projected2(const Vector3<T>& v) const { return sqr(alpha_u * v.x) + sqr(alpha_v * v.y); }

    [[gnu::always_inline]] T smith_ggx(const Vector3<T>& v) const {
        using std::fabs;
        using std::sqrt;
        const T z = fabs(v.z);
        return T(2) * z / (z + sqrt(z * z + projected2(v)));
    }

    /// Returns 1 / (alpha tan(theta)); large where all facets are visible.
    [[gnu::always_inline]] T cot_over_alpha(const Vector3<T>& v) const {
        using std::fabs;
        using std::sqrt;
        const T xy = projected2(v);
        return fabs(v.z) / sqrt(select(xy > T(1e-20), xy, T(1e-20)));
    }
    [[gnu::always_inline]] T smith_beckmann_fit(const Vector3<T>& v) const {
        const T a = cot_over_alpha(v);
        const T fit = a * (T(3.535) + T(2.181) * a) / (T(1) + a * (T(2.276) + T(2.577) * a));
        return select(a >= T(1.6), T(1), fit);
    }
    [[gnu::always_inline]] T smith_beckmann(const Vector3<T>& v) const {
        const T a = cot_over_alpha(v);
        // lambda = exp(-a²) / (2 a √π) - erfc(a) / 2, and erfc(a) = exp(-a²) p(t) to 1.5e-7.
        //                    [AbramowitzStegun1964] Eq. (7.1.26)
        const T t = T(1) / (T(1) + T(0.3275911) * a);
        const T p = t * (T(0.254829592) +
                         t * (T(-0.284496736) + t * (T(1.421413741) + t * (T(-1.453152027) + t * T(1.061405429)))));
        const T lambda = exponential(-a * a) * (T(1 / (2 * 1.77245385090551602730)) / a - T(0.5) * p);
        // Exact to rounding; the derivatives are then 0.
        return select(a > T(4), T(1), T(1) / (T(1) + lambda));
    }

    Vector3<T> from_unit_slope(const T& x, const T& y) const {
        return normalize(Vector3<T>{-alpha_u * x, -alpha_v * y, T(1)});
    }

    Vector3<T> sample_all(Point2f u) const {
        const float tan2 = type == Microfacet::ggx ? u.x / (1.0f - u.x) : -std::log1p(-u.x);
        const float r = std::sqrt(tan2);
        const SinCos phi = sin_cos_turn(u.y);
        return from_unit_slope(T(-r * phi.cos), T(-r * phi.sin));
    }

    /// Samples the visible facets of an ellipsoid: reflects uniformly into a spherical cap and halves.
    ///                                                        [DupuyBenyoub2023] listing 3
    Vector3<T> sample_visible_ggx(const Vector3<T>& w, Point2f u) const {
        const Vector3<T> o = normalize(Vector3<T>{alpha_u * w.x, alpha_v * w.y, w.z});
        const T h = (T(1) + o.z) * T(u.y);  // 1 - z of the cap's point
        const T r = safe_sqrt(h * (T(2) - h));
        const SinCos phi = sin_cos_turn(u.x);
        const Vector3<T> m{r * T(phi.cos) + o.x, r * T(phi.sin) + o.y, T(1) - h + o.z};
        return normalize(Vector3<T>{alpha_u * m.x, alpha_v * m.y, m.z});
    }

    /// Samples the visible slopes of a Gaussian surface by numerical inversion: the slope along w by Halley's method in
    /// the domain of erf, the slope across it directly.                [Jakob2014] §2, [HeitzDEon2014]
    Vector3<T> sample_visible_beckmann(const Vector3<T>& w, Point2f u) const {
        using std::erf;
        using std::exp;
        using std::sqrt;
        const T inv_sqrt_pi = T(1.0 / 1.77245385090551602730);
        const Vector3<T> o = normalize(Vector3<T>{alpha_u * w.x, alpha_v * w.y, w.z});
        const T sin2 = o.x * o.x + o.y * o.y;
        const T sin = sqrt(select(sin2 > T(1e-12), sin2, T(1e-12)));
        const T tan = sin / o.z;
        const T cot = o.z / sin;
        const float u_along = clamp(u.x, 1e-6f, 1.0f - 1e-6f);
        const float u_across = clamp(u.y, 1e-6f, 1.0f - 1e-6f);

        // CDF of the slope s = erf_inv(x): 1 + x + tan/√π exp(-s²), for x up to erf(cot).
        const T top = erf(cot);
        const T target = T(u_along) * (T(1) + top + inv_sqrt_pi * tan * exp(-cot * cot));
        T x = top - (top + T(1)) * T(std::erf(std::sqrt(-std::log(u_along))));
        for (int i = 0; i < 2; ++i) {
            const T s = erf_inv(x);
            const T bell = inv_sqrt_pi * exp(-s * s);  // 1/2 of dx/ds
            const T excess = T(1) + x + tan * bell - target;
            const T slope = T(1) - s * tan;
            const T newton = excess / slope;
            // Halley's correction by the second derivative, -tan / (2 bell).
            x = x - newton / (T(1) + T(0.25) * newton * tan / (bell * slope));
            x = clamp(x, T(-1 + 1e-6), T(1 - 1e-6));
        }
        const T along = erf_inv(x);
        const T across = T(erf_inv(2.0f * u_across - 1.0f));
        const T cos_phi = select(sin2 > T(1e-12), o.x / sin, T(1));
        const T sin_phi = select(sin2 > T(1e-12), o.y / sin, T(0));
        return from_unit_slope(cos_phi * along - sin_phi * across, sin_phi * along + cos_phi * across);
    }
};

}  // namespace loom
