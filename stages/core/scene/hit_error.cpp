#include <algorithm>
#include <array>

#include "stages/core/scene/scene.h"

namespace loom {
namespace {

/// Minimum error relative to a shape's size; keeps a ray's start off an axis-aligned plane through 0, where nothing is
/// rounded.
constexpr double least = 0x1p-40;

/// Sum of the terms (m) whose rounding moves a triangle along its normal: its corners relative to one another, and its
/// normal. The ray engine computes the normal as a cross product of rounded edges, which cancels for a sliver.
double rounded_terms(const Vector3<double>& a, const Vector3<double>& b) {
    const Vector3<double> n = cross(a, b);
    const double area = length(n);
    double sum = 0;
    for (int k = 0; k < 3; ++k) {
        const int i = (k + 1) % 3, j = (k + 2) % 3;
        const double extent = std::max({std::abs(a[k]), std::abs(b[k]), std::abs(b[k] - a[k])});
        sum += (std::abs(n[k]) + std::abs(a[i] * b[j]) + std::abs(a[j] * b[i])) * extent / area;
    }
    return sum;
}

/// Largest error of the triangles of a mesh, rounded up to a power of two. Leaves out its worst slivers, 1e-4 of its
/// area.
float mesh_error(const Shape& shape) {
    constexpr int lowest = -200, highest = 200;
    std::array<double, highest - lowest + 1> area_of{};  // [exponent of the error]
    double total = 0;
    for (const TriangleRecord& t : shape.triangles) {
        const Vector3<double> a(t.e1), b(t.e2);
        const double area = length(cross(a, b)), size = std::max(length(a), length(b));
        if (!(area > 0)) continue;
        int exponent = 0;
        std::frexp(rounding_bound * rounded_terms(a, b) + least * size, &exponent);
        area_of[std::size_t(std::clamp(exponent, lowest, highest) - lowest)] += area;
        total += area;
    }
    double left_out = 0;
    for (int e = highest; e >= lowest; --e) {
        left_out += area_of[std::size_t(e - lowest)];
        if (left_out > 1e-4 * total) return std::ldexp(1.0f, e);
    }
    return 0;
}

}  // namespace

float hit_error(const Shape& shape) {
    switch (shape.kind) {
        case ShapeKind::mesh:
            return mesh_error(shape);
        case ShapeKind::sphere:
            return 2 * rounding_bound * shape.round.radius;
        case ShapeKind::disk: {
            const Vector3<double> u(shape.round.u_axis), v(shape.round.v_axis), n = normalize(cross(u, v));
            return float(rounding_bound * (absolute_dot(n, u) + absolute_dot(n, v)) +
                         least * std::max(length(u), length(v)));
        }
    }
    return 0;
}

}  // namespace loom
