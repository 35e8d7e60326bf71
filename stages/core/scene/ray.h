#pragma once
// Rays, and their offsets at surfaces whose points are rounded.

#include <cmath>

#include "stages/core/math/vector.h"

namespace loom {

/// Half-open segment of a ray; d is unit, so t is a distance (m).
struct Ray {
    Point3f o;
    Vector3f d;
    float t_min = 0;
    float t_max = INFINITY;
};

/// A point where rays start or end.
struct RayEnd {
    Point3f p;
    Normal3f n{};         // geometric, unit, on either side; (0, 0, 0): not on a surface, as a pinhole or a point light
    float hit_error = 0;  // Shape::hit_error, m
};

/// Bound of a sum of rounding errors, relative to its terms: twice the largest error over millions of rays
/// (docs/trace.md).
inline constexpr float rounding_bound = 4 * 0x1p-24f;

/// Relative amounts by which rays end before their target: the first at a surface, the second at a point not on a
/// surface. The second is larger because a point light may lie exactly in the plane of a ceiling.
inline constexpr float surface_epsilon = 0x1p-21f, point_epsilon = 0x1p-16f;

/// Sum of |n_k v_k|; the rounding error of n . v is proportional to it.
template <class T, class A, class B>
inline T absolute_dot(const Triple<T, A>& n, const Triple<T, B>& v) {
    return std::abs(n.x * v.x) + std::abs(n.y * v.y) + std::abs(n.z * v.z);
}

/// Distance (m) by which a ray must start off a surface to be on its right side despite rounding. It covers the
/// rounding of the point p, by its coordinates along n, and that of the plane in which the ray engine tests its
/// triangle.
///                                                                                 [Pharr2016] section 3.9
inline float surface_offset(const Point3f& p, const Normal3f& n, float hit_error) {
    return rounding_bound * absolute_dot(n, p) + hit_error;
}

/// Origin of a ray that leaves p in direction d.
inline Point3f offset_origin(const Point3f& p, const Normal3f& n, float hit_error, const Vector3f& d) {
    const float offset = surface_offset(p, n, hit_error);
    return p + Vector3f(n) * (dot(n, d) >= 0 ? offset : -offset);
}

/// End of a segment from o that reaches the surface point q: on the side of o, and off the surface by the rounding
/// error of their distance as well.
inline Point3f offset_end(const Point3f& q, const Normal3f& n, float hit_error, const Point3f& o) {
    const Vector3f back = o - q;
    const float offset = surface_offset(q, n, hit_error) + rounding_bound * absolute_dot(n, back);
    return q + Vector3f(n) * (dot(n, back) >= 0 ? offset : -offset);
}

inline Ray spawn_ray(const RayEnd& from, const Vector3f& d) {
    return {offset_origin(from.p, from.n, from.hit_error, d), d, 0, INFINITY};
}

/// Returns the open segment between two points.
inline Ray spawn_segment(const RayEnd& from, const RayEnd& to) {
    const Point3f o = offset_origin(from.p, from.n, from.hit_error, to.p - from.p);
    const Vector3f d = offset_end(to.p, to.n, to.hit_error, o) - o;
    const float distance = length(d);
    return {o, d / distance, 0, distance * (1 - (to.n == Normal3f{} ? point_epsilon : surface_epsilon))};
}

}  // namespace loom
