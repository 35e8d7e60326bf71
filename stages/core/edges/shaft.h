#pragma once
// The region between a surface point and a light, in which an edge can shadow the light.

#include <array>
#include <span>

#include "stages/core/edges/edges.h"
#include "stages/core/scene/ray.h"

namespace loom {

/// Part of an edge, by its parameter: 0 at Edge::a, 1 at Edge::b.
struct EdgeInterval {
    double s0 = 0, s1 = 0;
};

/// A convex region with an eye at its apex, or the whole space seen along a direction.
///
/// The normal of `from` is on the side that receives the light: what lies below its tangent plane, or within rounding
/// of it, is outside. Without a normal there is no such bound.
class Shaft {
  public:
    /// Pyramid from a point to a convex polygon. Empty where the point lies in the polygon's plane.
    /// in:      outline  3 or 4 corners, either way round
    ///          closed   with what lies on that plane to within rounding: the light's own borders, and edges that touch it
    static Shaft to_polygon(const RayEnd& from, std::span<const Point3f> outline, bool closed = false);
    /// Returns how far before the plane of a flat light shadow rays end, in lengths of its normal.
    /// in:      distance            of the rays' start from the plane, in the same lengths
    ///          largest_coordinate  of the light's corners, m
    static double rounding_before(const Vector3<double>& normal, double distance, double largest_coordinate);
    /// Cone from a point to a sphere, up to the sphere's surface; inside of a sphere, the sphere.
    static Shaft to_sphere(const RayEnd& from, const Point3f& center, float radius);
    /// All directions, to infinity.
    static Shaft to_infinity(const RayEnd& from);
    /// The whole space, seen by light that travels against `direction`, which points to the light.
    static Shaft along(const Vector3f& direction);

    bool empty() const { return empty_; }
    /// Whether an edge is a silhouette as seen from the apex.
    bool is_silhouette(const Edge& edge) const {
        return is_silhouette_along(edge, eye_ - Vector3<double>(edge.a) * weight_);
    }
    /// Computes the parts of an edge inside, in ascending order, none of length 0. Two only where the edge runs through
    /// a sphere. An edge in line with the apex subtends no angle and has none.
    /// out:     returns how many of `inside` are set
    int clip(const Edge& edge, std::array<EdgeInterval, 2>& inside) const { return clip(edge.a, edge.b, inside); }
    int clip(const Point3f& a, const Point3f& b, std::array<EdgeInterval, 2>& inside) const;

    /// Half-space n . (p - apex) + offset >= 0.
    struct Plane {
        Vector3<double> n;  // of any length
        double offset = 0;
    };
    /// Bounds of the region, for culling: of a cone those of a pyramid around it.
    std::span<const Plane> planes() const { return {planes_.data(), std::size_t(n_planes_)}; }
    /// The eye in homogeneous coordinates: the direction from p to it is eye() - weight() p. The weight is 0 for a
    /// direction.
    const Vector3<double>& eye() const { return eye_; }
    double weight() const { return weight_; }

  private:
    explicit Shaft(const RayEnd& from);
    void add_plane(const Vector3<double>& n, double offset);
    /// Restricts an interval to the cone.
    void clip_by_cone(const Vector3<double>& start, const Vector3<double>& along, EdgeInterval& part) const;

    Vector3<double> eye_;
    double weight_ = 1;
    std::array<Plane, 6> planes_;
    int n_planes_ = 0;
    bool empty_ = false;
    // A spherical light, from the apex.
    enum class Round { none, outside, inside } round_ = Round::none;
    Vector3<double> to_center_, axis_;  // m; unit
    double radius_ = 0, cos2_ = 0, sin2_ = 0;
};

}  // namespace loom
