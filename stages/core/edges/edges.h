#pragma once
// Edges of shapes: the curves at which visibility changes, on which the boundary terms of a derivative are integrated.

#include <algorithm>
#include <cstdint>
#include <span>
#include <vector>

#include "stages/core/math/vector.h"
#include "stages/core/scene/scene.h"

namespace loom {

enum class EdgeKind : std::uint8_t {
    border,  // of one triangle: a silhouette from everywhere
    shared,  // of two triangles: a silhouette from where exactly one of them shows its front
};

/// A straight edge of a mesh. Its geometric normals are oriented by each other, not by the winding of the triangles,
/// which may disagree: both are on one side of the surface. That is the side from which the triangle of n0 lies to the
/// left of the edge and the triangle of n1 to the right. A border has n1 = -n0.
struct Edge {
    Point3f a, b;
    Normal3f n0, n1;  // unit
    std::uint32_t shape_idx = 0;
    std::uint32_t first_face_idx = 0, n_faces = 0;  // see EdgeSet::faces_of()
    EdgeKind kind = EdgeKind::border;

    template <class T>
    Point3<T> point(const T& s) const {
        return Point3<T>(a) + (Point3<T>(b) - Point3<T>(a)) * s;
    }
    double length() const { return loom::length(Point3<double>(b) - Point3<double>(a)); }
    /// Returns the parameter of the point nearest to p.
    double nearest(const Point3<double>& p) const {
        const Vector3<double> along = Point3<double>(b) - Point3<double>(a);
        return std::clamp(dot(p - Point3<double>(a), along) / length2(along), 0.0, 1.0);
    }
};

/// Rim of a disk: center + u_axis cos(phi) + v_axis sin(phi), an ellipse where the axes are sheared. It is a border.
struct RimEdge {
    Point3f center;
    Vector3f u_axis, v_axis;  // m
    std::uint32_t shape_idx = 0;

    Point3<double> point(double phi) const { return Point3<double>(center) - inward(phi); }
    /// Derivative of the point by phi, m: the tangent, not of unit length.
    Vector3<double> tangent(double phi) const {
        return Vector3<double>(v_axis) * std::cos(phi) - Vector3<double>(u_axis) * std::sin(phi);
    }
    /// From the point to the centre, m: towards the occluder.
    Vector3<double> inward(double phi) const {
        return Vector3<double>(u_axis) * -std::cos(phi) - Vector3<double>(v_axis) * std::sin(phi);
    }
};

struct EdgeSet {
    std::vector<Edge> edges;
    std::vector<RimEdge> rims;
    std::vector<std::uint32_t> faces;  // triangles of the edges, edge after edge

    /// Returns the triangles of an edge's shape that end at it. A ray through the edge must ignore them by index: no
    /// offset is right for both sides of a silhouette.
    std::span<const std::uint32_t> faces_of(const Edge& edge) const {
        return {faces.data() + edge.first_face_idx, edge.n_faces};
    }
};

/// Returns the edges of shapes; a sphere has none (its silhouette has a formula of its own).
/// Triangles are joined where the positions of their corners are equal, not their indices, so that seams of texture
/// coordinates or normals are no borders. Shapes are not joined to each other: they move independently, and a seam
/// between two of them is a border of each. Dropped: triangles without area, and edges whose triangles are coplanar to
/// 1e-6 rad.
/// Where more than two triangles meet, an edge is a silhouette if all are on one side as seen from a point. This depends
/// on the outermost two alone, whose normals it gets; if the triangles surround it, there is no such point and no edge.
/// The order depends on the meshes only.
/// in:      wanted  by shape, which ones to take; empty: all
EdgeSet find_edges(std::span<const Shape> shapes, const std::vector<bool>& wanted = {});

/// Whether n points to the side of d. A face seen edge-on counts as if d were moved by an infinitesimal amount, the same
/// for all faces, so that outlines stay closed.
inline bool faces_towards(const Normal3f& n, const Vector3<double>& d) {
    const double cos = dot(Normal3<double>(n), d);
    if (cos != 0) return cos > 0;
    return n.x != 0 ? n.x > 0 : n.y != 0 ? n.y > 0 : n.z > 0;
}

/// Whether an edge is a silhouette as seen against direction d, which points from the edge to the eye.
inline bool is_silhouette_along(const Edge& edge, const Vector3<double>& d) {
    return faces_towards(edge.n0, d) != faces_towards(edge.n1, d);
}
/// Whether an edge is a silhouette as seen from a point.
inline bool is_silhouette(const Edge& edge, const Point3<double>& from) {
    return is_silhouette_along(edge, from - Point3<double>(edge.a));
}

}  // namespace loom
