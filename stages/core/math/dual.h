#pragma once
// Forward-mode differentiation: a value together with its derivatives with respect to N parameters. Every formula of
// scattering and transport is a template over the number type; with a Dual, the same lines compute its derivatives.

#include <array>
#include <cmath>
#include <concepts>

namespace loom {

/// A value and its partial derivatives with respect to N parameters.
///   (f, f') ; arithmetic follows the chain rule
/// needs:   Real is float or double
/// differs: where a derivative is infinite at the edge of a domain (sqrt(0), acos(±1)) it is 0. Thus the unused side of
///          a select() cannot turn the used side into NaN. The value itself follows the rules of Real.
template <int N, class Real = float>
struct Dual {
    Real value{};
    std::array<Real, N> d{};

    constexpr Dual() = default;
    /// A constant: all derivatives are 0.
    template <class U>
    requires std::is_arithmetic_v<U>
    constexpr Dual(U constant) : value(static_cast<Real>(constant)) {}
    /// The independent variable number i: its derivative with respect to itself is 1.
    static constexpr Dual variable(Real x, int i) {
        Dual result(x);
        result.d[i] = Real(1);
        return result;
    }
    /// f(x) by the chain rule, given f and f' at x.
    constexpr Dual chain(Real f, Real df) const {
        Dual result(f);
        for (int i = 0; i < N; ++i) result.d[i] = df * d[i];
        return result;
    }
    /// f(x, y) by the chain rule, given f and its two partial derivatives.
    static constexpr Dual chain(const Dual& x, const Dual& y, Real f, Real df_dx, Real df_dy) {
        Dual result(f);
        for (int i = 0; i < N; ++i) result.d[i] = df_dx * x.d[i] + df_dy * y.d[i];
        return result;
    }

    constexpr Dual operator-() const { return chain(-value, Real(-1)); }
    friend constexpr Dual operator+(const Dual& a, const Dual& b) {
        return chain(a, b, a.value + b.value, Real(1), Real(1));
    }
    friend constexpr Dual operator-(const Dual& a, const Dual& b) {
        return chain(a, b, a.value - b.value, Real(1), Real(-1));
    }
    friend constexpr Dual operator*(const Dual& a, const Dual& b) {
        return chain(a, b, a.value * b.value, b.value, a.value);
    }
    friend constexpr Dual operator/(const Dual& a, const Dual& b) {
        const Real inv = Real(1) / b.value;
        const Real quotient = a.value / b.value;
        return chain(a, b, quotient, inv, -quotient * inv);
    }
    constexpr Dual& operator+=(const Dual& o) { return *this = *this + o; }
    constexpr Dual& operator-=(const Dual& o) { return *this = *this - o; }
    constexpr Dual& operator*=(const Dual& o) { return *this = *this * o; }
    constexpr Dual& operator/=(const Dual& o) { return *this = *this / o; }

    // Comparisons use the value, so that a select() takes the same branch as the plain number.
    friend constexpr bool operator==(const Dual& a, const Dual& b) { return a.value == b.value; }
    friend constexpr auto operator<=>(const Dual& a, const Dual& b) { return a.value <=> b.value; }

    friend Dual sqrt(const Dual& x) {
        const Real root = std::sqrt(x.value);
        return x.chain(root, x.value == Real(0) ? Real(0) : Real(0.5) / root);
    }
    friend Dual exp(const Dual& x) {
        const Real e = std::exp(x.value);
        return x.chain(e, e);
    }
    friend Dual log(const Dual& x) { return x.chain(std::log(x.value), Real(1) / x.value); }
    friend Dual sin(const Dual& x) { return x.chain(std::sin(x.value), std::cos(x.value)); }
    friend Dual cos(const Dual& x) { return x.chain(std::cos(x.value), -std::sin(x.value)); }
    friend Dual tan(const Dual& x) {
        const Real t = std::tan(x.value);
        return x.chain(t, Real(1) + t * t);
    }
    friend Dual acos(const Dual& x) {
        const Real s2 = Real(1) - x.value * x.value;
        return x.chain(std::acos(x.value), s2 > Real(0) ? Real(-1) / std::sqrt(s2) : Real(0));
    }
    friend Dual asin(const Dual& x) {
        const Real s2 = Real(1) - x.value * x.value;
        return x.chain(std::asin(x.value), s2 > Real(0) ? Real(1) / std::sqrt(s2) : Real(0));
    }
    friend Dual atan(const Dual& x) { return x.chain(std::atan(x.value), Real(1) / (Real(1) + x.value * x.value)); }
    friend Dual atan2(const Dual& y, const Dual& x) {
        const Real r2 = x.value * x.value + y.value * y.value;
        const Real inv = r2 > Real(0) ? Real(1) / r2 : Real(0);
        return chain(y, x, std::atan2(y.value, x.value), x.value * inv, -y.value * inv);
    }
    friend Dual erf(const Dual& x) {
        constexpr Real two_over_sqrt_pi = Real(1.12837916709551257390);
        return x.chain(std::erf(x.value), two_over_sqrt_pi * std::exp(-x.value * x.value));
    }
    /// x^p; at x = 0 the derivative with respect to p is 0, its limit for p > 0.
    friend Dual pow(const Dual& x, const Dual& p) {
        const Real f = std::pow(x.value, p.value);
        const Real df_dx = p.value == Real(0) ? Real(0) : p.value * std::pow(x.value, p.value - Real(1));
        const Real df_dp = x.value == Real(0) ? Real(0) : f * std::log(x.value);
        // For a constant power no logarithm is computed: a negative base has none.
        Dual result(f);
        for (int i = 0; i < N; ++i) result.d[i] = df_dx * x.d[i] + (p.d[i] == Real(0) ? Real(0) : df_dp * p.d[i]);
        return result;
    }
    friend Dual fabs(const Dual& x) { return x.chain(std::fabs(x.value), std::copysign(Real(1), x.value)); }
    friend Dual abs(const Dual& x) { return fabs(x); }
    friend bool isfinite(const Dual& x) {
        bool all = std::isfinite(x.value);
        for (const Real& di : x.d) all = all && std::isfinite(di);
        return all;
    }
};

/// Whether a number depends on a parameter, i.e. any of its derivatives is not 0.
template <class Real>
requires std::is_arithmetic_v<Real>
constexpr bool moves(Real) {
    return false;
}
template <int N, class Real>
constexpr bool moves(const Dual<N, Real>& x) {
    for (const Real& di : x.d)
        if (di != Real(0)) return true;
    return false;
}

/// Returns the plain value of any number type that a formula may take; for indices and choices.
template <class Real>
requires std::is_arithmetic_v<Real>
constexpr Real value_of(Real x) {
    return x;
}
template <int N, class Real>
constexpr Real value_of(const Dual<N, Real>& x) {
    return x.value;
}

}  // namespace loom
