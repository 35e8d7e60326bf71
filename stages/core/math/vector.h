#pragma once
// Points, vectors and normals are three types. They transform differently, and a density or a cosine of the wrong type
// must not compile. All are templates over the number type: float in stages that evaluate, Dual in the stage that
// differentiates.

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <type_traits>

namespace loom {

inline constexpr double pi_double = 3.14159265358979323846;
template <class T>
inline constexpr T pi = T(pi_double);
template <class T>
inline constexpr T inv_pi = T(1.0 / pi_double);

/// Chooses without a branch; every formula uses it instead of `if`. It selects a value for a float, a value and its
/// derivatives for a Dual.
template <class T>
constexpr T select(bool mask, const T& a, const T& b) {
    return mask ? a : b;
}

template <class T>
constexpr T sqr(const T& x) {
    return x * x;
}

/// Returns sqrt(max(x, 0)): rounding may give a tiny negative number where the exact value is not negative.
template <class T>
T safe_sqrt(const T& x) {
    using std::sqrt;
    return sqrt(select(x > T(0), x, T(0)));
}

template <class T>
constexpr T clamp(const T& x, const T& low, const T& high) {
    return select(x < low, low, select(x > high, high, x));
}

/// Returns (1 - t) a + t b.
template <class T, class U>
constexpr U lerp(const T& t, const U& a, const U& b) {
    return a * (T(1) - t) + b * t;
}

namespace kind {
struct Point;
struct Vector;
struct Normal;
}  // namespace kind

/// Three Cartesian coordinates with a kind: Point (m), Vector (m, or a unit direction), Normal (unit).
template <class T, class Kind>
struct Triple {
    T x{}, y{}, z{};

    constexpr Triple() = default;
    constexpr Triple(T x_, T y_, T z_) : x(x_), y(y_), z(z_) {}
    template <class U, class OtherKind>
    constexpr explicit Triple(const Triple<U, OtherKind>& o) : x(T(o.x)), y(T(o.y)), z(T(o.z)) {}

    constexpr T& operator[](int i) { return i == 0 ? x : i == 1 ? y : z; }
    constexpr const T& operator[](int i) const { return i == 0 ? x : i == 1 ? y : z; }
    constexpr Triple operator-() const { return {-x, -y, -z}; }
    constexpr Triple operator*(const T& s) const { return {x * s, y * s, z * s}; }
    constexpr Triple operator/(const T& s) const { return *this * (T(1) / s); }
    constexpr bool operator==(const Triple& o) const { return x == o.x && y == o.y && z == o.z; }
    friend constexpr Triple operator*(const T& s, const Triple& v) { return v * s; }
};

template <class T>
using Point3 = Triple<T, kind::Point>;
template <class T>
using Vector3 = Triple<T, kind::Vector>;
template <class T>
using Normal3 = Triple<T, kind::Normal>;
using Point3f = Point3<float>;
using Vector3f = Vector3<float>;
using Normal3f = Normal3<float>;

template <class T>
constexpr Vector3<T> operator+(const Vector3<T>& a, const Vector3<T>& b) {
    return {a.x + b.x, a.y + b.y, a.z + b.z};
}
template <class T>
constexpr Vector3<T> operator-(const Vector3<T>& a, const Vector3<T>& b) {
    return {a.x - b.x, a.y - b.y, a.z - b.z};
}
template <class T>
constexpr Point3<T> operator+(const Point3<T>& a, const Vector3<T>& b) {
    return {a.x + b.x, a.y + b.y, a.z + b.z};
}
template <class T>
constexpr Point3<T> operator-(const Point3<T>& a, const Vector3<T>& b) {
    return {a.x - b.x, a.y - b.y, a.z - b.z};
}
template <class T>
constexpr Vector3<T> operator-(const Point3<T>& a, const Point3<T>& b) {
    return {a.x - b.x, a.y - b.y, a.z - b.z};
}
template <class T, class A, class B>
constexpr T dot(const Triple<T, A>& a, const Triple<T, B>& b) {
    return a.x * b.x + a.y * b.y + a.z * b.z;
}
template <class T, class A, class B>
constexpr Vector3<T> cross(const Triple<T, A>& a, const Triple<T, B>& b) {
    return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
template <class T>
constexpr T length2(const Vector3<T>& v) {
    return dot(v, v);
}
template <class T, class K>
T length(const Triple<T, K>& v) {
    using std::sqrt;
    return sqrt(dot(v, v));
}
template <class T, class K>
Triple<T, K> normalize(const Triple<T, K>& v) {
    return v / length(v);
}
template <class T, class K>
bool all_finite(const Triple<T, K>& v) {
    return std::isfinite(v.x) && std::isfinite(v.y) && std::isfinite(v.z);
}

template <class T>
struct Point2 {
    T x{}, y{};
};
using Point2f = Point2<float>;

/// Linear RGB (sRGB primaries): radiance (W m^-2 sr^-1), reflectance (1), …; the variable's name says which.
template <class T>
struct Rgb {
    T r{}, g{}, b{};

    constexpr Rgb() = default;
    constexpr explicit Rgb(T grey) : r(grey), g(grey), b(grey) {}
    constexpr Rgb(T r_, T g_, T b_) : r(r_), g(g_), b(b_) {}
    template <class U>
    requires(!std::is_same_v<U, T>) constexpr explicit Rgb(const Rgb<U>& o) : r(T(o.r)), g(T(o.g)), b(T(o.b)) {}

    constexpr T& operator[](int i) { return i == 0 ? r : i == 1 ? g : b; }
    constexpr const T& operator[](int i) const { return i == 0 ? r : i == 1 ? g : b; }
    constexpr Rgb operator+(const Rgb& o) const { return {r + o.r, g + o.g, b + o.b}; }
    constexpr Rgb operator-(const Rgb& o) const { return {r - o.r, g - o.g, b - o.b}; }
    constexpr Rgb operator*(const Rgb& o) const { return {r * o.r, g * o.g, b * o.b}; }
    constexpr Rgb operator/(const Rgb& o) const { return {r / o.r, g / o.g, b / o.b}; }
    constexpr Rgb operator*(const T& s) const { return {r * s, g * s, b * s}; }
    constexpr Rgb operator/(const T& s) const { return *this * (T(1) / s); }
    constexpr Rgb& operator+=(const Rgb& o) { return *this = *this + o; }
    constexpr Rgb& operator*=(const Rgb& o) { return *this = *this * o; }
    constexpr Rgb& operator*=(const T& s) { return *this = *this * s; }
    constexpr bool operator==(const Rgb& o) const { return r == o.r && g == o.g && b == o.b; }
    friend constexpr Rgb operator*(const T& s, const Rgb& v) { return v * s; }
};
using Spectrum = Rgb<float>;

// Selects by component: a whole structure would be selected through memory, and its loop would not vectorise.
template <class T>
constexpr Rgb<T> select(bool mask, const Rgb<T>& a, const Rgb<T>& b) {
    return {select(mask, a.r, b.r), select(mask, a.g, b.g), select(mask, a.b, b.b)};
}
template <class T, class K>
constexpr Triple<T, K> select(bool mask, const Triple<T, K>& a, const Triple<T, K>& b) {
    return {select(mask, a.x, b.x), select(mask, a.y, b.y), select(mask, a.z, b.z)};
}

template <class T>
constexpr T max_channel(const Rgb<T>& v) {
    T m = select(v.r > v.g, v.r, v.g);
    return select(m > v.b, m, v.b);
}
template <class T>
constexpr T mean_channel(const Rgb<T>& v) {
    return (v.r + v.g + v.b) * T(1.0 / 3.0);
}
/// Returns Rec. 709 luminance of linear sRGB, the row Y of the matrix to XYZ.
template <class T>
constexpr T luminance(const Rgb<T>& v) {
    return T(0.212671) * v.r + T(0.715160) * v.g + T(0.072169) * v.b;
}
template <class T>
bool is_black(const Rgb<T>& v) {
    return (v.r == T(0)) & (v.g == T(0)) & (v.b == T(0));
}
template <class T>
bool all_finite(const Rgb<T>& v) {
    return std::isfinite(v.r) && std::isfinite(v.g) && std::isfinite(v.b);
}

}  // namespace loom
