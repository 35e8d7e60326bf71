#pragma once
// Velocities of the boundary term. A line from x_S to x_L runs through the point x_B of an edge with unit tangent t;
// omega is its unit direction, s = |x_S x_B| / |x_S x_L| (0 for a light at infinity).
//
//   v_rel = v_B - (1 - s) v_S - s v_L
//   swept = -(t x omega)_out . v_rel
//
// swept is the rate at which light appears beside the edge, per length of edge. The derivative by a parameter of what
// x_S receives is, for stored x_S,
//
//   integral of f_cos(omega) L(x_L -> x_S) swept / r_B^2 over the length of the visible silhouettes, r_B = |x_S x_B|.

#include "stages/core/edges/edges.h"

namespace loom {

/// Returns t x omega, turned away from the occluder. It is not normalised: its length is the sine between t and omega.
/// Its sign does not depend on those of t and omega.
/// in:      t       unit tangent
///          inward  from the edge into the occluder, any length
inline Vector3<double> outward(const Vector3<double>& t, const Vector3<double>& omega, const Vector3<double>& inward) {
    const Vector3<double> across = cross(t, omega);
    return dot(across, inward) > 0 ? -across : across;
}

/// Returns outward() of an edge. The occluder is on the side of its triangles as seen along omega.
/// needs:   the edge is a silhouette along omega
inline Vector3<double> outward(const Edge& edge, const Vector3<double>& omega) {
    const Vector3<double> across = cross(normalize(Point3<double>(edge.b) - Point3<double>(edge.a)), omega);
    return faces_towards(edge.n0, -omega) ? -across : across;
}

/// Returns the velocity of an edge point relative to the line of sight through it.
/// in:      s        share of the line from x_S to x_L at which the edge point lies; 0 for a light at infinity
///          v_edge, v_from, v_light  velocities of x_B, x_S, x_L, m per unit of the parameter
inline Vector3<double> relative_velocity(double s, const Vector3<double>& v_edge, const Vector3<double>& v_from,
                                         const Vector3<double>& v_light) {
    return v_edge - v_from * (1 - s) - v_light * s;
}

inline double swept(const Vector3<double>& outward, const Vector3<double>& v_rel) {
    return -dot(outward, v_rel);
}

}  // namespace loom
