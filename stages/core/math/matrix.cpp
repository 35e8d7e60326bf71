#include "stages/core/math/matrix.h"

#include <cmath>

namespace loom {

Matrix4d Matrix4d::operator*(const Matrix4d& o) const {
    Matrix4d r;
    for (int i = 0; i < 4; ++i)
        for (int j = 0; j < 4; ++j) {
            double sum = 0;
            for (int k = 0; k < 4; ++k) sum += (*this)(i, k) * o(k, j);
            r(i, j) = sum;
        }
    return r;
}

Point3<double> Matrix4d::point(const Point3<double>& p) const {
    const auto row = [&](int i) {
        return (*this)(i, 0) * p.x + (*this)(i, 1) * p.y + (*this)(i, 2) * p.z + (*this)(i, 3);
    };
    const double w = row(3);
    if (w == 1.0) return {row(0), row(1), row(2)};
    return {row(0) / w, row(1) / w, row(2) / w};
}

Vector3<double> Matrix4d::vector(const Vector3<double>& v) const {
    const auto row = [&](int i) { return (*this)(i, 0) * v.x + (*this)(i, 1) * v.y + (*this)(i, 2) * v.z; };
    return {row(0), row(1), row(2)};
}

namespace {
Vector3<double> column(const Matrix4d& m, int j) {
    return {m(0, j), m(1, j), m(2, j)};
}
}  // namespace

double Matrix4d::determinant3() const {
    return dot(column(*this, 0), cross(column(*this, 1), column(*this, 2)));
}

std::array<double, 9> Matrix4d::normal_matrix() const {
    const Vector3<double> a = column(*this, 0), b = column(*this, 1), c = column(*this, 2);
    const double scale = 1 / determinant3();
    const Vector3<double> bc = cross(b, c) * scale, ca = cross(c, a) * scale, ab = cross(a, b) * scale;
    return {bc.x, ca.x, ab.x, bc.y, ca.y, ab.y, bc.z, ca.z, ab.z};
}

bool Matrix4d::singular() const {
    constexpr double smallest_relative_determinant = 1e-14;
    const double lengths = length(column(*this, 0)) * length(column(*this, 1)) * length(column(*this, 2));
    return !(std::abs(determinant3()) > smallest_relative_determinant * lengths);
}

bool Matrix4d::finite() const {
    for (const double x : m)
        if (!std::isfinite(x)) return false;
    return true;
}

Matrix4d Matrix4d::translation(double x, double y, double z) {
    return {{1, 0, 0, x, 0, 1, 0, y, 0, 0, 1, z, 0, 0, 0, 1}};
}

Matrix4d Matrix4d::scaling(double x, double y, double z) {
    return {{x, 0, 0, 0, 0, y, 0, 0, 0, 0, z, 0, 0, 0, 0, 1}};
}

Matrix4d Matrix4d::rotation(const Vector3<double>& axis, double angle_rad) {
    const Vector3<double> a = normalize(axis);
    const double s = std::sin(angle_rad), c = std::cos(angle_rad), d = 1 - c;
    return {{a.x * a.x * d + c, a.x * a.y * d - a.z * s, a.x * a.z * d + a.y * s, 0, a.y * a.x * d + a.z * s,
             a.y * a.y * d + c, a.y * a.z * d - a.x * s, 0, a.z * a.x * d - a.y * s, a.z * a.y * d + a.x * s,
             a.z * a.z * d + c, 0, 0, 0, 0, 1}};
}

Matrix4d Matrix4d::look_at(const Point3<double>& origin, const Point3<double>& target, const Vector3<double>& up) {
    const Vector3<double> view = normalize(target - origin);
    const Vector3<double> left = normalize(cross(up, view));
    const Vector3<double> above = cross(view, left);
    return {{left.x, above.x, view.x, origin.x, left.y, above.y, view.y, origin.y, left.z, above.z, view.z, origin.z, 0,
             0, 0, 1}};
}

}  // namespace loom
