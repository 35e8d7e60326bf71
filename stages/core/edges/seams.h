#pragma once
// Lines along which surfaces cut each other: the visible surface changes there, and no mesh has an edge.

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "stages/core/edges/edges.h"

namespace loom {

/// A straight part of such a line. From everywhere off the two planes both surfaces show, one on each side: it is a
/// crease, never a silhouette.
struct Seam {
    struct Face {
        std::uint32_t shape_idx = 0, triangle_idx = 0;
        Vector3<double> n;  // unit, of the triangle's winding
    };
    Point3f a, b;
    std::array<Face, 2> faces;

    Point3<double> point(double s) const { return Point3<double>(a) + (Point3<double>(b) - Point3<double>(a)) * s; }
    double length() const { return loom::length(Point3<double>(b) - Point3<double>(a)); }

    /// Velocity of the line at a point: it follows both surfaces, and has no part along the line.
    /// in:      v0, v1  velocities of the material points of the two faces there
    Vector3<double> velocity(const Vector3<double>& v0, const Vector3<double>& v1) const {
        const Vector3<double>&n0 = faces[0].n, &n1 = faces[1].n;
        const double c = dot(n0, n1), r0 = dot(n0, v0), r1 = dot(n1, v1), d = 1 - c * c;
        return n0 * ((r0 - c * r1) / d) + n1 * ((r1 - c * r0) / d);
    }
    /// Unit vector within face i, off the line, towards the part of the face that shows along a direction of view.
    Vector3<double> along_face(int i, const Vector3<double>& view) const {
        const Vector3<double>&n = faces[std::size_t(i)].n, &other = faces[std::size_t(1 - i)].n;
        const Vector3<double> w = normalize(other - n * dot(n, other));
        return dot(other, view) > 0 ? -w : w;
    }
    /// Unit vector off both faces, towards the eye.
    Vector3<double> lifted(const Vector3<double>& view) const {
        Vector3<double> sum;
        for (const Face& face : faces) sum = dot(face.n, view) > 0 ? sum - face.n : sum + face.n;
        return normalize(sum);
    }
};

/// Which pairs of triangles matter. Shapes of one group do not move relative to each other; a shape of the group
/// `deforms` moves relative to all others and within itself.
struct SeamQuery {
    static constexpr std::uint32_t deforms = ~0u;
    std::vector<std::uint32_t> group;       // by shape
    bool resting = false;                   // pairs of one group, too, and pairs within one shape
    std::uint64_t most_tests = 50'000'000;  // pairs of triangles or boxes
};
struct SeamSet {
    std::vector<Seam> seams;
    std::uint64_t n_tests = 0;
    bool complete = true;  // false: the search ended at SeamQuery::most_tests
};

/// How far from a surface a point may be, m, and still lie on it: by rounding, 1e-6 of the coordinates.
double seam_rounding(const Point3<double>& p);

/// Finds the seams of meshes. Two triangles have one where each has corners on both sides of the other's plane, beyond
/// seam_rounding(): a box that stands on a floor has none there, its edges are boundaries anyway.
/// Where a surface is cut along an edge of two nearly coplanar triangles, the seam belongs to one of them. Triangles of
/// one shape that share a corner, and pairs within 1e-4 rad of coplanar, have none.
/// The order depends on the shapes and groups only.
SeamSet find_seams(std::span<const Shape> shapes, const SeamQuery& query);

/// Finds pairs of shapes, of which one at least is a sphere or a disk, whose surfaces cut each other: their lines are no
/// seams here. Ends after `most` pairs, or after SeamQuery::most_tests triangles.
std::vector<std::array<std::uint32_t, 2>> find_round_seams(std::span<const Shape> shapes, const SeamQuery& query,
                                                           std::size_t most);

}  // namespace loom
