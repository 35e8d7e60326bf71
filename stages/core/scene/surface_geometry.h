#pragma once
// Position, normal and texture coordinates of surface points, unrounded, as templates over the number T: float for the
// tracer, Dual where a shape depends on a parameter. as_stored() rounds for the disk format.

#include "stages/core/math/dual.h"
#include "stages/core/math/frame.h"

namespace loom {

/// dp/du and dp/dv, m per unit of the texture coordinates.
template <class T>
struct Tangents {
    Vector3<T> dp_du, dp_dv;
};

/// A triangle: a corner and the edges to the other two.
template <class T>
struct TriangleGeometry {
    Point3<T> p0;
    Vector3<T> e1, e2;

    /// Point of barycentric coordinates u (second corner) and v (third corner).
    Point3<T> point(const T& u, const T& v) const { return p0 + (e1 * u + e2 * v); }
    Normal3<T> normal() const { return Normal3<T>(normalize(cross(e1, e2))); }
    /// Tangents from the texture coordinates of the corners; arbitrary ones where those are degenerate.
    /// in:      n  normal of arbitrary tangents
    Tangents<T> tangents(const Point2<T>& t0, const Point2<T>& t1, const Point2<T>& t2, const Normal3<T>& n) const {
        const T du1 = t1.x - t0.x, dv1 = t1.y - t0.y, du2 = t2.x - t0.x, dv2 = t2.y - t0.y;
        const T det = du1 * dv2 - dv1 * du2;
        if (!(det == T(0))) return {(e1 * dv2 - e2 * dv1) / det, (e2 * du1 - e1 * du2) / det};
        return any_tangents(n);
    }
    static Tangents<T> any_tangents(const Normal3<T>& n) {
        const Frame<T> frame(n);
        return {frame.s, frame.t};
    }
};

/// Interpolates the corner values of a triangle at barycentric coordinates (u, v).
template <class T>
Vector3<T> interpolate(const Vector3<T>& a, const Vector3<T>& b, const Vector3<T>& c, const T& u, const T& v) {
    return a * (T(1) - u - v) + b * u + c * v;
}
template <class T>
Point2<T> interpolate(const Point2<T>& a, const Point2<T>& b, const Point2<T>& c, const T& u, const T& v) {
    const T w = T(1) - u - v;
    return {a.x * w + b.x * u + c.x * v, a.y * w + b.y * u + c.y * v};
}

/// A sphere or a disk.
template <class T>
struct RoundGeometry {
    Point3<T> center;
    T radius{1};                        // sphere only, m
    Vector3<T> u_axis, v_axis, w_axis;  // sphere: its x, y, z, unit; disk: u_axis and v_axis span the unit disk, m

    /// in:      outward  unit, from the centre, independent of the orientation of the normals
    Point3<T> sphere_point(const Vector3<T>& outward) const { return center + outward * radius; }
    /// Longitude about w_axis from u_axis, and colatitude, both over [0, 1].
    Point2<T> sphere_uv(const Vector3<T>& outward) const {
        using std::acos, std::atan2;
        const T phi = atan2(dot(outward, v_axis), dot(outward, u_axis)) * (T(0.5) * inv_pi<T>);
        return {select(phi < T(0), phi + T(1), phi), acos(clamp(dot(outward, w_axis), T(-1), T(1))) * inv_pi<T>};
    }
    Tangents<T> sphere_tangents(const Vector3<T>& outward) const {
        const T x = dot(outward, u_axis), y = dot(outward, v_axis);
        const T rho = at_least_1e_6(x * x + y * y), scale = radius * pi<T>;
        return {(v_axis * x - u_axis * y) * (T(2) * scale),
                ((u_axis * (x / rho) + v_axis * (y / rho)) * dot(outward, w_axis) - w_axis * rho) * scale};
    }

    /// in:      x, y  on the unit disk
    Point3<T> disk_point(const T& x, const T& y) const { return center + u_axis * x + v_axis * y; }
    Normal3<T> disk_normal() const { return Normal3<T>(normalize(cross(u_axis, v_axis))); }
    /// Radius, and angle over [0, 1].
    Point2<T> disk_uv(const T& x, const T& y) const {
        using std::atan2;
        const T phi = atan2(y, x) * (T(0.5) * inv_pi<T>);
        return {at_least_1e_6(x * x + y * y), select(phi < T(0), phi + T(1), phi)};
    }
    Tangents<T> disk_tangents(const T& x, const T& y) const {
        return {(u_axis * x + v_axis * y) / at_least_1e_6(x * x + y * y), (v_axis * x - u_axis * y) * (T(2) * pi<T>)};
    }

  private:
    /// Square root, bounded away from 0 at a pole, where tangents have no direction.
    static T at_least_1e_6(const T& squared) {
        using std::sqrt;
        const T root = sqrt(squared);
        return select(root < T(1e-6f), T(1e-6f), root);
    }
};

/// Decodes the local normal that a normal map stores as a colour.
template <class T>
Vector3<T> mapped_normal(const Rgb<T>& rgb) {
    return normalize(Vector3<T>{T(2) * rgb.r - T(1), T(2) * rgb.g - T(1), T(2) * rgb.b - T(1)});
}

/// Local normal of a bump map.
/// in:      base      shading frame without the map
///          gradient  gradient of the height in texture coordinates, m
template <class T>
Vector3<T> bumped_normal(const Frame<T>& base, const Tangents<T>& tangents, const Point2<T>& gradient) {
    const Vector3<T> n(base.n);
    const Vector3<T> du = tangents.dp_du + n * (gradient.x - dot(n, tangents.dp_du));
    const Vector3<T> dv = tangents.dp_dv + n * (gradient.y - dot(n, tangents.dp_dv));
    const Vector3<T> bumped = normalize(cross(du, dv));
    return base.to_local(dot(bumped, base.n) < T(0) ? -bumped : bumped);
}

}  // namespace loom
