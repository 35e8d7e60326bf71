#include "stages/core/edges/shaft.h"

#include <algorithm>
#include <cmath>

namespace loom {
namespace {

using Vector3d = Vector3<double>;

/// Roots of a s^2 + 2 b s + c, ascending; false: none, or not a quadratic.
bool roots(double a, double b, double c, double& low, double& high) {
    const double discriminant = b * b - a * c;
    if (!(discriminant > 0) || a == 0) return false;
    // Without cancellation.                                                       [NumericalRecipes] section 5.6
    const double q = -(b + std::copysign(std::sqrt(discriminant), b));
    low = q / a;
    high = q != 0 ? c / q : 0;
    if (low > high) std::swap(low, high);
    return true;
}

}  // namespace

Shaft::Shaft(const RayEnd& from) : eye_(from.p) {
    const Vector3d n(from.n);
    if (length2(n) > 0) add_plane(n, -double(surface_offset(from.p, from.n, from.hit_error)));
}

void Shaft::add_plane(const Vector3d& n, double offset) {
    planes_[std::size_t(n_planes_++)] = {n, offset};
}

Shaft Shaft::to_polygon(const RayEnd& from, std::span<const Point3f> outline, bool closed) {
    Shaft shaft(from);
    const std::size_t n = outline.size();
    std::array<Vector3d, 4> corner;
    shaft.empty_ = n < 3 || n > corner.size();
    if (shaft.empty_) return shaft;
    double farthest2 = 0, largest_coordinate = 0;
    for (std::size_t k = 0; k < n; ++k) {
        corner[k] = Vector3d(outline[k]) - shaft.eye_;
        farthest2 = std::max(farthest2, length2(corner[k]));
        for (int c = 0; c < 3; ++c) largest_coordinate = std::max(largest_coordinate, std::abs(double(outline[k][c])));
    }
    // The mean normal and the nearest corner along it: the corners are rounded, and four need not lie in a plane.
    Vector3d normal;
    for (std::size_t k = 1; k + 1 < n; ++k) normal = normal + cross(corner[k] - corner[0], corner[k + 1] - corner[0]);
    double volume = INFINITY;
    for (std::size_t k = 0; k < n; ++k)
        if (const double v = dot(normal, corner[k]); std::abs(v) < std::abs(volume)) volume = v;
    constexpr double in_plane = 1e-9;  // sine of the angle
    shaft.empty_ = !(sqr(volume) > sqr(in_plane) * farthest2 * length2(normal));
    if (shaft.empty_) return shaft;
    // Orient all planes inwards.
    const double side = volume < 0 ? -1 : 1;
    for (std::size_t k = 0; k < n; ++k) shaft.add_plane(cross(corner[k], corner[(k + 1) % n]) * side, 0);
    // End before the light as its shadow rays do; the plane's normal keeps its length.
    const double rounding = rounding_before(normal, std::abs(volume), largest_coordinate);
    shaft.add_plane(normal * -side, std::abs(volume) + (closed ? rounding : -rounding));
    return shaft;
}

double Shaft::rounding_before(const Vector3d& normal, double distance, double largest_coordinate) {
    // A length is at most the sum of the components.
    const double length_bound = std::abs(normal.x) + std::abs(normal.y) + std::abs(normal.z);
    return std::max(double(surface_epsilon) * distance, double(rounding_bound) * largest_coordinate * length_bound);
}

Shaft Shaft::to_sphere(const RayEnd& from, const Point3f& center, float radius) {
    Shaft shaft(from);
    shaft.to_center_ = Vector3d(center) - shaft.eye_;
    shaft.radius_ = radius;
    const double distance = length(shaft.to_center_);
    if (!(distance > radius)) {
        shaft.round_ = Round::inside;
        return shaft;
    }
    shaft.round_ = Round::outside;
    shaft.axis_ = shaft.to_center_ / distance;
    shaft.sin2_ = sqr(radius / distance);
    shaft.cos2_ = (1 - radius / distance) * (1 + radius / distance);
    // Four planes around the cone, and that of the circle in which it touches the sphere.
    const double cos = std::sqrt(shaft.cos2_), sin = std::sqrt(shaft.sin2_);
    const Frame<double> frame{Normal3<double>(shaft.axis_)};
    for (const Vector3d& side : {frame.s, -frame.s, frame.t, -frame.t})
        shaft.add_plane(shaft.axis_ * sin + side * cos, 0);
    shaft.add_plane(-shaft.axis_, distance * shaft.cos2_);
    return shaft;
}

Shaft Shaft::to_infinity(const RayEnd& from) {
    return Shaft(from);
}

Shaft Shaft::along(const Vector3f& direction) {
    Shaft shaft{RayEnd{}};
    shaft.eye_ = Vector3d(direction);
    shaft.weight_ = 0;
    return shaft;
}

void Shaft::clip_by_cone(const Vector3d& start, const Vector3d& along, EdgeInterval& part) const {
    // Inside: sin^2 (e . axis)^2 - cos^2 |e across the axis|^2 >= 0 for e = start + s along. The planes have removed what
    // is behind the apex.
    const double start_axial = dot(start, axis_), along_axial = dot(along, axis_);
    const Vector3d start_across = start - axis_ * start_axial, along_across = along - axis_ * along_axial;
    const double a = sin2_ * sqr(along_axial) - cos2_ * length2(along_across);
    const double b = sin2_ * start_axial * along_axial - cos2_ * dot(start_across, along_across);
    const double c = sin2_ * sqr(start_axial) - cos2_ * length2(start_across);
    const auto nothing = [&] { part.s1 = part.s0; };
    double low = 0, high = 0;
    if (!roots(a, b, c, low, high)) {
        // Parallel to a line of the cone, or outside of it.
        if (a != 0 || b == 0) return nothing();
        if (b > 0)
            part.s0 = std::max(part.s0, -c / (2 * b));
        else
            part.s1 = std::min(part.s1, -c / (2 * b));
    } else if (a < 0) {
        part = {std::max(part.s0, low), std::min(part.s1, high)};
    } else if (along_axial > 0) {
        part.s0 = std::max(part.s0, high);
    } else {
        part.s1 = std::min(part.s1, low);
    }
}

int Shaft::clip(const Point3f& a, const Point3f& b, std::array<EdgeInterval, 2>& inside) const {
    const Vector3d end_a = Vector3d(a) - eye_ * weight_, end_b = Vector3d(b) - eye_ * weight_;
    const Vector3d along = end_b - end_a;
    EdgeInterval part{0, 1};
    for (int i = 0; i < n_planes_; ++i) {
        const Plane& plane = planes_[std::size_t(i)];
        const double at_a = dot(plane.n, end_a) + plane.offset, at_b = dot(plane.n, end_b) + plane.offset;
        if (at_a < 0 && at_b < 0) return 0;
        if (at_a < 0) part.s0 = std::max(part.s0, at_a / (at_a - at_b));
        if (at_b < 0) part.s1 = std::min(part.s1, at_a / (at_a - at_b));
    }
    constexpr double in_line = 1e-12;  // sine of the angle
    if (!(part.s1 > part.s0)) return 0;
    if (weight_ != 0 && length2(cross(end_a, along)) <= sqr(in_line) * length2(end_a) * length2(along)) return 0;
    if (round_ == Round::none) {
        inside[0] = part;
        return 1;
    }
    if (round_ == Round::outside) clip_by_cone(end_a, along, part);
    // The part of the line in the ball.
    const Vector3d from_center = end_a - to_center_;
    double low = 0, high = 0;
    const bool through_ball =
        roots(length2(along), dot(from_center, along), length2(from_center) - sqr(radius_), low, high);
    int n = 0;
    const auto add = [&](double s0, double s1) {
        if (s1 > s0) inside[std::size_t(n++)] = {s0, s1};
    };
    if (round_ == Round::inside) {
        if (through_ball) add(std::max(part.s0, low), std::min(part.s1, high));
    } else if (through_ball) {
        add(part.s0, std::min(part.s1, low));
        add(std::max(part.s0, high), part.s1);
    } else {
        add(part.s0, part.s1);
    }
    return n;
}

}  // namespace loom
