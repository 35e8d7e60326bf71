// Lines along which surfaces cut each other, and how these move.
//
// Detected mutations: no tolerance for rounding; edges in the plane of a face not joined; pairs of triangles of one shape
// left out; the wrong sign of the cosine between the faces in the velocity.

#include "stages/core/edges/seams.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <random>

#include "tests/unit/icosphere.h"

namespace loom {
namespace {

using Pt = Point3<double>;
using Vec = Vector3<double>;

Shape shape_of(std::vector<Point3f> positions, std::vector<std::uint32_t> indices) {
    Shape shape;
    shape.mesh = {std::move(positions), {}, {}, std::move(indices)};
    return shape;
}
Shape rectangle(const Pt& centre, const Vec& u, const Vec& v) {
    const auto at = [&](double s, double t) { return Point3f(centre + u * s + v * t); };
    return shape_of({at(-1, -1), at(1, -1), at(1, 1), at(-1, 1)}, {0, 1, 2, 0, 2, 3});
}
/// Box with n x n squares on each face.
Shape box(const Pt& centre, const Vec& half, int n = 1, double turn = 0) {
    Shape shape;
    const auto turned = [&](const Vec& v) {
        return Vec{std::cos(turn) * v.x - std::sin(turn) * v.y, std::sin(turn) * v.x + std::cos(turn) * v.y, v.z};
    };
    for (int axis = 0; axis < 3; ++axis)
        for (const double side : {-1.0, 1.0})
            for (int i = 0; i < n; ++i)
                for (int j = 0; j < n; ++j) {
                    const auto first = std::uint32_t(shape.mesh.positions.size());
                    for (int corner = 0; corner < 4; ++corner) {
                        Vec p;
                        p[axis] = side * half[axis];
                        p[(axis + 1) % 3] = half[(axis + 1) % 3] * (2.0 * (i + corner % 2) / n - 1);
                        p[(axis + 2) % 3] = half[(axis + 2) % 3] * (2.0 * (j + corner / 2) / n - 1);
                        shape.mesh.positions.push_back(Point3f(centre + turned(p)));
                    }
                    for (const std::uint32_t k : {0u, 1u, 3u, 0u, 3u, 2u}) shape.mesh.indices.push_back(first + k);
                }
    return shape;
}

SeamSet seams_of(const std::vector<Shape>& shapes, bool resting = false) {
    SeamQuery query;
    for (std::uint32_t k = 0; k < shapes.size(); ++k) query.group.push_back(k);
    query.resting = resting;
    return find_seams(shapes, query);
}
double total_length(const SeamSet& set) {
    double sum = 0;
    for (const Seam& seam : set.seams) sum += seam.length();
    return sum;
}
/// Largest distance of the ends of seams from the planes of their faces.
double distance_from_planes(const std::vector<Shape>& shapes, const SeamSet& set) {
    double largest = 0;
    for (const Seam& seam : set.seams)
        for (const Seam::Face& face : seam.faces) {
            const Mesh& mesh = shapes[face.shape_idx].mesh;
            const Pt corner(mesh.positions[mesh.indices[3 * std::size_t(face.triangle_idx)]]);
            for (const Point3f& end : {seam.a, seam.b})
                largest = std::max(largest, std::abs(dot(face.n, Pt(end) - corner)));
        }
    return largest;
}

TEST(Seams, OfTwoRectangles) {
    // A wall through a floor, turned off its diagonals: the line is as long as the wall is wide.
    const std::vector<Shape> shapes{rectangle({0, 0, 0}, {2, 0, 0}, {0, 2, 0}),
                                    rectangle({0.1, 0.3, 0.4}, {0.8, 0.6, 0}, {0, 0, 1})};
    const SeamSet set = seams_of(shapes);
    EXPECT_TRUE(set.complete);
    EXPECT_NEAR(total_length(set), 2, 1e-6);
    EXPECT_LT(distance_from_planes(shapes, set), 1e-7);
    for (const Seam& seam : set.seams) EXPECT_NE(seam.faces[0].shape_idx, seam.faces[1].shape_idx);
    // Where the floor ends the line ends, and beyond a gap there is none.
    EXPECT_NEAR(total_length(seams_of({shapes[0], rectangle({2, 0, 0}, {0.5, 0, 0}, {0, 0, 1})})), 0.5, 1e-6);
    EXPECT_EQ(seams_of({shapes[0], rectangle({0, 0, 1.1}, {0.5, 0, 0}, {0, 0, 1})}).seams.size(), 0u);
    // No pair moves relative to the other: only where all are wanted.
    SeamQuery query{{0, 0}, false};
    EXPECT_EQ(find_seams(shapes, query).seams.size(), 0u);
    query.resting = true;
    EXPECT_NEAR(total_length(find_seams(shapes, query)), 2, 1e-6);
    query.most_tests = 2;
    EXPECT_FALSE(find_seams(shapes, query).complete);
}

TEST(Seams, OfABoxSunkIntoAFloor) {
    const Shape floor = rectangle({0, 0, 0}, {3, 0, 0}, {0, 3, 0});
    for (const int n : {1, 2, 3})
        for (const double turn : {0.0, 0.3}) {
            // Also where the floor cuts along edges within the faces: n = 2, height 0.
            for (const double height : {0.0, 0.07}) {
                const std::vector<Shape> shapes{floor, box({0.2, -0.1, height}, {0.5, 0.4, 0.25}, n, turn)};
                const SeamSet set = seams_of(shapes);
                EXPECT_NEAR(total_length(set), 4 * (0.5 + 0.4), 1e-5) << n << " " << turn << " " << height;
                EXPECT_LT(distance_from_planes(shapes, set), 2e-7);
            }
            // It stands on the floor, hangs below it, or is off it by rounding.
            for (const double height : {0.25, -0.25, 0.25 + 1e-7, 0.25 - 1e-7})
                EXPECT_EQ(seams_of({floor, box({0.2, -0.1, height}, {0.5, 0.4, 0.25}, n, turn)}).seams.size(), 0u)
                    << n << " " << turn << " " << height;
        }
    // Far from the origin coordinates are rounded.
    EXPECT_EQ(seams_of({rectangle({1000, 0, 500}, {3, 0, 0}, {0, 3, 0}),
                        box({1000, 0, 500.3 + 3e-5}, {0.5, 0.4, 0.3}, 1, 0.3)})
                  .seams.size(),
              0u);
}

TEST(Seams, OfCoplanarAndNeighbouringTriangles) {
    const Shape floor = rectangle({0, 0, 0}, {3, 0, 0}, {0, 3, 0});
    EXPECT_EQ(seams_of({floor, rectangle({0.5, 0.5, 0}, {1, 0.3, 0}, {-0.2, 1, 0})}).seams.size(), 0u);
    EXPECT_EQ(seams_of({floor, rectangle({0.5, 0.5, 0}, {1, 0, 1e-5}, {0, 1, 0})}).seams.size(), 0u);
    // A wall that ends on the floor, and one that ends at its border.
    EXPECT_EQ(seams_of({floor, rectangle({0, 0, 1}, {1, 0, 0}, {0, 0, 1})}).seams.size(), 0u);
    EXPECT_EQ(seams_of({floor, rectangle({0, 3, 0}, {1, 0, 0}, {0, 0, 1})}).seams.size(), 0u);
    // Faces of one closed mesh meet at edges, not along seams; two boxes of one mesh have some.
    Shape two = box({0, 0, 0}, {1, 1, 1}, 3);
    EXPECT_EQ(seams_of({two}, true).seams.size(), 0u);
    const Shape other = box({0.1, 0.2, 1}, {0.5, 0.4, 0.3}, 2);
    const auto first = std::uint32_t(two.mesh.positions.size());
    two.mesh.positions.insert(two.mesh.positions.end(), other.mesh.positions.begin(), other.mesh.positions.end());
    for (const std::uint32_t i : other.mesh.indices) two.mesh.indices.push_back(first + i);
    EXPECT_NEAR(total_length(seams_of({two}, true)), 4 * 0.9, 1e-5);
    EXPECT_EQ(seams_of({two}).seams.size(), 0u);
    EXPECT_NEAR(total_length(find_seams({&two, 1}, {{SeamQuery::deforms}, false})), 4 * 0.9, 1e-5);
}

/// Length along which a segment between two planes lies within two triangles, by the roots of all six edges.
double brute_force(const std::array<Pt, 3>& a, const std::array<Pt, 3>& b) {
    const auto inside = [](const std::array<Pt, 3>& t, const Pt& p) {
        const Vec n = cross(t[1] - t[0], t[2] - t[0]);
        for (std::size_t k = 0; k < 3; ++k)
            if (dot(n, cross(t[(k + 1) % 3] - t[k], p - t[k])) < 0) return false;
        return true;
    };
    std::vector<Pt> ends;
    const auto pierce = [&](const std::array<Pt, 3>& edges, const std::array<Pt, 3>& face) {
        const Vec n = cross(face[1] - face[0], face[2] - face[0]);
        for (std::size_t k = 0; k < 3; ++k) {
            const Pt &p = edges[k], &q = edges[(k + 1) % 3];
            const double dp = dot(n, p - face[0]), dq = dot(n, q - face[0]);
            if ((dp < 0) == (dq < 0)) continue;
            const Pt x = p + (q - p) * (dp / (dp - dq));
            if (inside(face, x)) ends.push_back(x);
        }
    };
    pierce(a, b);
    pierce(b, a);
    return ends.size() == 2 ? length(ends[1] - ends[0]) : 0;
}

double brute_force(const Shape& a, const Shape& b) {
    const auto triangle = [](const Mesh& mesh, std::size_t t) {
        std::array<Pt, 3> p;
        for (std::size_t k = 0; k < 3; ++k) p[k] = Pt(mesh.positions[mesh.indices[3 * t + k]]);
        return p;
    };
    double sum = 0;
    for (std::size_t i = 0; i < a.mesh.n_triangles(); ++i)
        for (std::size_t j = 0; j < b.mesh.n_triangles(); ++j)
            sum += brute_force(triangle(a.mesh, i), triangle(b.mesh, j));
    return sum;
}

TEST(Seams, EqualABruteForceSearch) {
    std::mt19937 random(3);
    std::uniform_real_distribution<double> u(-1, 1);
    Shape ball;
    ball.mesh = test::icosphere(2, {0.3f, 0.2f, 0.5f}, 0.45f);
    int n_cut = 0;
    for (int trial = 0; trial < 60; ++trial) {
        std::vector<Point3f> corners;
        for (int k = 0; k < 4; ++k) corners.push_back(Point3f(float(u(random)), float(u(random)), float(u(random))));
        const std::vector<Shape> shapes{shape_of(corners, {0, 1, 2, 0, 1, 3, 1, 2, 3, 2, 0, 3}),
                                        box({0.1 * u(random), 0.1 * u(random), 0}, {0.5, 0.4, 0.6}, 1 + trial % 3, 0.7),
                                        ball};
        double length = 0;
        for (std::size_t i = 0; i < shapes.size(); ++i)
            for (std::size_t j = 0; j < i; ++j) length += brute_force(shapes[i], shapes[j]);
        const SeamSet set = seams_of(shapes);
        EXPECT_NEAR(total_length(set), length, 1e-4) << trial;
        EXPECT_LT(distance_from_planes(shapes, set), 3e-7);
        n_cut += set.seams.size() > 0;
        // The same seams where shapes of one group are wanted, too.
        EXPECT_NEAR(total_length(find_seams(shapes, {{0, 0, 0}, true})), length, 1e-4);
    }
    EXPECT_GT(n_cut, 50);
}

TEST(Seams, MoveAsTheirSurfacesDo) {
    std::mt19937 random(5);
    std::uniform_real_distribution<double> u(-1, 1);
    const auto vec = [&] { return Vec{u(random), u(random), u(random)}; };
    for (int trial = 0; trial < 50; ++trial) {
        // Two planes through a point, each with an affine motion of its own.
        const Pt p{u(random), u(random), u(random)};
        Seam seam;
        std::array<Vec, 2> offset;
        std::array<std::array<Vec, 3>, 2> linear;
        for (std::size_t i = 0; i < 2; ++i) {
            seam.faces[i].n = normalize(vec());
            offset[i] = vec();
            for (Vec& row : linear[i]) row = vec();
        }
        const auto moved = [&](std::size_t i, const Vec& x) {
            return Vec{dot(linear[i][0], x), dot(linear[i][1], x), dot(linear[i][2], x)} + offset[i];
        };
        const Vec t = normalize(cross(seam.faces[0].n, seam.faces[1].n));
        // Where the two moved planes and the plane across the line meet.
        const auto line_at = [&](double h) {
            std::array<Vec, 3> n{Vec{}, Vec{}, t};
            std::array<double, 3> d{0, 0, dot(t, Vec(p))};
            for (std::size_t i = 0; i < 2; ++i) {
                const Frame<double> frame{Normal3<double>(seam.faces[i].n)};
                const auto place = [&](const Vec& x) { return x + moved(i, x) * h; };
                const Vec q = place(Vec(p));
                n[i] = cross(place(Vec(p) + frame.s) - q, place(Vec(p) + frame.t) - q);
                d[i] = dot(n[i], q);
            }
            return (cross(n[1], n[2]) * d[0] + cross(n[2], n[0]) * d[1] + cross(n[0], n[1]) * d[2]) /
                   dot(n[0], cross(n[1], n[2]));
        };
        constexpr double h = 1e-5;
        const Vec difference = (line_at(h) - line_at(-h)) / (2 * h),
                  v = seam.velocity(moved(0, Vec(p)), moved(1, Vec(p)));
        const double sine = length(cross(seam.faces[0].n, seam.faces[1].n));
        EXPECT_LT(length(v - difference), 1e-5 / sqr(sine)) << trial;
        EXPECT_NEAR(dot(v, t), 0, 1e-9 / sqr(sine));
        // From everywhere both faces show, one on each side of the line.
        const Vec view = normalize(vec()), out = cross(t, view);
        const Vec w0 = seam.along_face(0, view), w1 = seam.along_face(1, view);
        EXPECT_LT(dot(out, w0) * dot(out, w1), 0);
        for (std::size_t i = 0; i < 2; ++i) {
            EXPECT_NEAR(dot(seam.faces[i].n, seam.along_face(int(i), view)), 0, 1e-9);
            EXPECT_LT(dot(seam.lifted(view), seam.faces[i].n) * dot(view, seam.faces[i].n), 0);
        }
    }
}

TEST(Seams, OfSpheresAndDisksAreFoundByPairs) {
    const Shape floor = rectangle({0, 0, 0}, {2, 0, 0}, {0, 2, 0});
    const auto sphere = [](const Point3f& center, float radius) {
        Shape shape;
        shape.kind = ShapeKind::sphere;
        shape.round.center = center;
        shape.round.radius = radius;
        return shape;
    };
    const auto disk = [](const Point3f& center, const Vector3f& u, const Vector3f& v) {
        Shape shape;
        shape.kind = ShapeKind::disk;
        shape.round.center = center;
        shape.round.u_axis = u, shape.round.v_axis = v;
        return shape;
    };
    const auto cut = [](const Shape& a, const Shape& b) {
        const std::vector<Shape> shapes{a, b};
        return find_round_seams(shapes, {{0, 1}}, 4).size();
    };
    EXPECT_EQ(cut(floor, sphere({0.5f, 0.2f, 0.3f}, 0.4f)), 1u);
    EXPECT_EQ(cut(floor, sphere({0.5f, 0.2f, 0.3f}, 0.3f)), 0u);  // it touches
    EXPECT_EQ(cut(floor, sphere({0.5f, 0.2f, 0.5f}, 0.4f)), 0u);
    EXPECT_EQ(cut(floor, sphere({2.2f, 0.2f, 0}, 0.3f)), 1u);  // at the border
    EXPECT_EQ(cut(floor, sphere({0, 0, 0}, 5)), 0u);           // inside of the sphere
    EXPECT_EQ(cut(sphere({0, 0, 0}, 1), sphere({1.5f, 0, 0}, 1)), 1u);
    EXPECT_EQ(cut(sphere({0, 0, 0}, 1), sphere({0.2f, 0, 0}, 0.5f)), 0u);
    EXPECT_EQ(cut(floor, disk({0, 0, 0.2f}, {0.5f, 0, 0}, {0, 0, 0.5f})), 1u);
    EXPECT_EQ(cut(floor, disk({0, 0, 0.6f}, {0.5f, 0, 0}, {0, 0, 0.5f})), 0u);
    EXPECT_EQ(cut(floor, disk({0, 0, 0}, {0.5f, 0, 0}, {0, 0.5f, 0})), 0u);
    EXPECT_EQ(cut(sphere({0, 0, 0.1f}, 0.3f), disk({0, 0, 0}, {0.5f, 0, 0}, {0, 0.5f, 0})), 1u);
    EXPECT_EQ(cut(disk({0, 0, 0}, {0, 0.3f, 0}, {0, 0, 0.3f}), disk({0, 0, 0}, {0.5f, 0, 0}, {0, 0.5f, 0})), 1u);
    // Two that rest.
    const std::vector<Shape> shapes{floor, sphere({0.5f, 0.2f, 0.3f}, 0.4f)};
    EXPECT_EQ(find_round_seams(shapes, {{0, 0}}, 4).size(), 0u);
    EXPECT_EQ(find_round_seams(shapes, {{0, 0}, true}, 4).size(), 1u);
}

}  // namespace
}  // namespace loom
