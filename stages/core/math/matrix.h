#pragma once
#include <array>

#include "stages/core/math/vector.h"

namespace loom {

/// Affine or projective map of points, row-major, acting on column vectors; world units are m.
struct Matrix4d {
    std::array<double, 16> m{1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1};

    double operator()(int row, int column) const { return m[std::size_t(row * 4 + column)]; }
    double& operator()(int row, int column) { return m[std::size_t(row * 4 + column)]; }
    bool operator==(const Matrix4d&) const = default;

    Matrix4d operator*(const Matrix4d& o) const;
    Point3<double> point(const Point3<double>& p) const;
    Vector3<double> vector(const Vector3<double>& v) const;
    /// Of the upper left 3x3 block; negative for a mirrored transform.
    double determinant3() const;
    /// Inverse transpose of the upper left 3x3 block (row-major): maps normals, length not kept.
    /// needs: determinant3() != 0
    std::array<double, 9> normal_matrix() const;
    /// True when the 3x3 block has no inverse, judged relative to the lengths of its columns.
    bool singular() const;
    bool finite() const;

    static Matrix4d translation(double x, double y, double z);
    static Matrix4d scaling(double x, double y, double z);
    /// needs: a non-zero axis
    static Matrix4d rotation(const Vector3<double>& axis, double angle_rad);
    /// Camera at `origin`: z to `target`, x to the left, y up (Mitsuba's handedness).
    /// needs: target != origin, up not parallel to the view
    static Matrix4d look_at(const Point3<double>& origin, const Point3<double>& target, const Vector3<double>& up);
};

}  // namespace loom
