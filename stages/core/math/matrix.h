#pragma once
#include <array>
#include <cmath>

#include "stages/core/math/dual.h"
#include "stages/core/math/vector.h"

namespace loom {

/// Affine or projective map of points, row-major, acting on column vectors; world units are m. T is double, or a Dual
/// where the map moves with a parameter.
template <class T>
struct Matrix4 {
    std::array<T, 16> m{T(1), T(0), T(0), T(0), T(0), T(1), T(0), T(0), T(0), T(0), T(1), T(0), T(0), T(0), T(0), T(1)};

    const T& operator()(int row, int column) const { return m[std::size_t(row * 4 + column)]; }
    T& operator()(int row, int column) { return m[std::size_t(row * 4 + column)]; }
    bool operator==(const Matrix4&) const = default;

    Matrix4 operator*(const Matrix4& o) const;
    Point3<T> point(const Point3<T>& p) const;
    Vector3<T> vector(const Vector3<T>& v) const;
    /// Determinant of the upper left 3x3 block; negative for a mirrored transform.
    T determinant3() const;
    /// Inverse transpose of the upper left 3x3 block (row-major): maps normals without preserving their length.
    /// needs:   determinant3() != 0
    std::array<T, 9> normal_matrix() const;
    /// Whether the 3x3 block has no inverse, relative to the lengths of its columns.
    bool singular() const;
    bool finite() const;

    static Matrix4 translation(const T& x, const T& y, const T& z);
    static Matrix4 scaling(const T& x, const T& y, const T& z);
    /// needs:   a non-zero axis
    static Matrix4 rotation(const Vector3<T>& axis, const T& angle_rad);
    /// Camera at `origin`: z points to `target`, x left, y up (Mitsuba's handedness).
    /// needs:   target != origin, up not parallel to the view
    static Matrix4 look_at(const Point3<T>& origin, const Point3<T>& target, const Vector3<T>& up);

  private:
    Vector3<T> column(int j) const { return {(*this)(0, j), (*this)(1, j), (*this)(2, j)}; }
};
using Matrix4d = Matrix4<double>;

template <class T>
Matrix4<T> Matrix4<T>::operator*(const Matrix4& o) const {
    Matrix4 r;
    for (int i = 0; i < 4; ++i)
        for (int j = 0; j < 4; ++j) {
            T sum(0);
            for (int k = 0; k < 4; ++k) sum += (*this)(i, k) * o(k, j);
            r(i, j) = sum;
        }
    return r;
}

template <class T>
Point3<T> Matrix4<T>::point(const Point3<T>& p) const {
    const auto row = [&](int i) {
        return (*this)(i, 0) * p.x + (*this)(i, 1) * p.y + (*this)(i, 2) * p.z + (*this)(i, 3);
    };
    const T w = row(3);
    return {row(0) / w, row(1) / w, row(2) / w};
}

template <class T>
Vector3<T> Matrix4<T>::vector(const Vector3<T>& v) const {
    const auto row = [&](int i) { return (*this)(i, 0) * v.x + (*this)(i, 1) * v.y + (*this)(i, 2) * v.z; };
    return {row(0), row(1), row(2)};
}

template <class T>
T Matrix4<T>::determinant3() const {
    return dot(column(0), cross(column(1), column(2)));
}

template <class T>
std::array<T, 9> Matrix4<T>::normal_matrix() const {
    const Vector3<T> a = column(0), b = column(1), c = column(2);
    const T scale = T(1) / determinant3();
    const Vector3<T> bc = cross(b, c) * scale, ca = cross(c, a) * scale, ab = cross(a, b) * scale;
    return {bc.x, ca.x, ab.x, bc.y, ca.y, ab.y, bc.z, ca.z, ab.z};
}

template <class T>
bool Matrix4<T>::singular() const {
    constexpr double smallest_relative_determinant = 1e-14;
    const T lengths = length(column(0)) * length(column(1)) * length(column(2));
    return !(std::abs(value_of(determinant3())) > smallest_relative_determinant * value_of(lengths));
}

template <class T>
bool Matrix4<T>::finite() const {
    using std::isfinite;
    for (const T& x : m)
        if (!isfinite(x)) return false;
    return true;
}

template <class T>
Matrix4<T> Matrix4<T>::translation(const T& x, const T& y, const T& z) {
    Matrix4 r;
    r(0, 3) = x, r(1, 3) = y, r(2, 3) = z;
    return r;
}

template <class T>
Matrix4<T> Matrix4<T>::scaling(const T& x, const T& y, const T& z) {
    Matrix4 r;
    r(0, 0) = x, r(1, 1) = y, r(2, 2) = z;
    return r;
}

template <class T>
Matrix4<T> Matrix4<T>::rotation(const Vector3<T>& axis, const T& angle_rad) {
    using std::cos, std::sin;
    const Vector3<T> a = normalize(axis);
    const T s = sin(angle_rad), c = cos(angle_rad), d = T(1) - c, zero(0), one(1);
    return {{a.x * a.x * d + c, a.x * a.y * d - a.z * s, a.x * a.z * d + a.y * s, zero, a.y * a.x * d + a.z * s,
             a.y * a.y * d + c, a.y * a.z * d - a.x * s, zero, a.z * a.x * d - a.y * s, a.z * a.y * d + a.x * s,
             a.z * a.z * d + c, zero, zero, zero, zero, one}};
}

template <class T>
Matrix4<T> Matrix4<T>::look_at(const Point3<T>& origin, const Point3<T>& target, const Vector3<T>& up) {
    const Vector3<T> view = normalize(target - origin);
    const Vector3<T> left = normalize(cross(up, view));
    const Vector3<T> above = cross(view, left);
    const T zero(0), one(1);
    return {{left.x, above.x, view.x, origin.x, left.y, above.y, view.y, origin.y, left.z, above.z, view.z, origin.z,
             zero, zero, zero, one}};
}

}  // namespace loom
