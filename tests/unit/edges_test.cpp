// Edges of shapes, the silhouettes among them within a shaft to a light, and the boundary term on them.

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <set>

#include "stages/core/edges/boundary.h"
#include "stages/core/edges/edge_tree.h"
#include "stages/core/sampling/sampler.h"
#include "tests/unit/icosphere.h"
#include "tests/unit/scene_folder.h"

namespace loom {
namespace {

using Point3d = Point3<double>;
using Vector3d = Vector3<double>;

Shape mesh_shape(Mesh mesh) {
    Shape shape;
    shape.mesh = std::move(mesh);
    return shape;
}
EdgeSet edges_of(const Mesh& mesh) {
    const Shape shape = mesh_shape(mesh);
    return find_edges({&shape, 1});
}
Mesh mesh_of(std::vector<Point3f> positions, std::vector<std::uint32_t> indices) {
    return {std::move(positions), {}, {}, std::move(indices)};
}

/// Cube [0, 1]^3 with n x n squares per face, each of two triangles, and vertices of their own for each triangle.
Mesh split_cube(int n) {
    Mesh mesh;
    for (int axis = 0; axis < 3; ++axis)
        for (int top = 0; top < 2; ++top)
            for (int i = 0; i < n; ++i)
                for (int j = 0; j < n; ++j) {
                    const auto corner = [&](int u, int v) {
                        Point3f p;
                        p[axis] = float(top);
                        p[(axis + 1) % 3] = float(i + u) / float(n);
                        p[(axis + 2) % 3] = float(j + v) / float(n);
                        return p;
                    };
                    std::vector<Point3f> six = {corner(0, 0), corner(1, 0), corner(1, 1),
                                                corner(0, 0), corner(1, 1), corner(0, 1)};
                    if (!top) {
                        std::swap(six[1], six[2]);
                        std::swap(six[4], six[5]);
                    }
                    for (const Point3f& p : six) {
                        mesh.indices.push_back(std::uint32_t(mesh.positions.size()));
                        mesh.positions.push_back(p);
                    }
                }
    return mesh;
}

class Numbers {
  public:
    explicit Numbers(std::uint64_t seed) : seed_(seed) {}
    float u() { return Sampler(SamplerKind::independent, seed_, 0, next_++).pair(0).x; }
    float in(float low, float high) { return low + (high - low) * u(); }
    Point3f point(float size = 1) { return {in(-size, size), in(-size, size), in(-size, size)}; }
    Vector3f direction() {
        for (;;) {
            const Vector3f v(point());
            if (length2(v) > 0.01f && length2(v) < 1) return normalize(v);
        }
    }

  private:
    std::uint64_t seed_, next_ = 0;
};

/// n triangles of random size and place, which share no vertex.
Mesh soup(int n, float size, std::uint64_t seed) {
    Numbers numbers(seed);
    Mesh mesh;
    for (int i = 0; i < n; ++i) {
        const Point3f center = numbers.point();
        for (int k = 0; k < 3; ++k) {
            mesh.indices.push_back(std::uint32_t(mesh.positions.size()));
            mesh.positions.push_back(center + Vector3f(numbers.point(size)));
        }
    }
    return mesh;
}

/// A height field with folds on all scales.
Mesh terrain(int n, std::uint64_t seed) {
    Numbers numbers(seed);
    Mesh mesh;
    for (int j = 0; j <= n; ++j)
        for (int i = 0; i <= n; ++i) {
            const float x = 2 * float(i) / float(n) - 1, y = 2 * float(j) / float(n) - 1;
            mesh.positions.push_back({x, y, 0.3f * std::sin(5 * x + 2 * y) * std::cos(4 * y) + numbers.in(0, 0.01f)});
        }
    const auto at = [&](int i, int j) { return std::uint32_t(j * (n + 1) + i); };
    for (int j = 0; j < n; ++j)
        for (int i = 0; i < n; ++i)
            for (std::uint32_t k : {at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j), at(i + 1, j + 1), at(i, j + 1)})
                mesh.indices.push_back(k);
    return mesh;
}

std::size_t count(const EdgeSet& set, EdgeKind kind) {
    return std::size_t(
        std::count_if(set.edges.begin(), set.edges.end(), [&](const Edge& e) { return e.kind == kind; }));
}

// Detected mutations: vertices joined by index; coplanar diagonals kept.
TEST(Edges, OfACubeDoNotDependOnItsTriangles) {
    Numbers numbers(0);
    for (int n : {1, 2, 5}) {
        Mesh cube = split_cube(n);
        const EdgeSet set = edges_of(cube);
        EXPECT_EQ(set.edges.size(), 12u * unsigned(n));
        EXPECT_EQ(count(set, EdgeKind::shared), set.edges.size());
        double sum = 0;
        for (const Edge& edge : set.edges) {
            ASSERT_EQ(set.faces_of(edge).size(), 2u);
            EXPECT_NEAR(dot(edge.n0, edge.n1), 0, 1e-7);
            sum += edge.length();
            // The normals are those of the triangles, or their reverse.
            double turn[2];
            for (std::size_t k = 0; k < 2; ++k) {
                const std::uint32_t* i = &cube.indices[3 * set.faces_of(edge)[k]];
                const Point3f& p = cube.positions[i[0]];
                const Vector3f n_face = normalize(cross(cube.positions[i[1]] - p, cube.positions[i[2]] - p));
                turn[k] = dot(n_face, k ? edge.n1 : edge.n0);
            }
            EXPECT_NEAR(std::abs(turn[0]), 1, 1e-6);
            EXPECT_NEAR(turn[1], turn[0], 1e-6);
        }
        EXPECT_NEAR(sum, 12, 1e-6);
        for (Point3f& p : cube.positions)
            if (p.x == 0 && numbers.u() < 0.5f) p.x = -0.0f;
        EXPECT_EQ(edges_of(cube).edges.size(), 12u * unsigned(n));
    }
    EXPECT_EQ(edges_of(test::icosphere(3, {}, 1)).edges.size(), 1920u);
}

// Detected mutations: triangles without area kept; no rule for faces seen edge-on.
TEST(Edges, OfOpenMeshesAreBorders) {
    const Mesh square = mesh_of({{0, 0, 0}, {1, 0, 0}, {1, 1, 0}, {0, 1, 0}}, {0, 1, 2, 2, 3, 0});
    EdgeSet set = edges_of(square);
    ASSERT_EQ(set.edges.size(), 4u);
    EXPECT_EQ(count(set, EdgeKind::border), 4u);
    for (const Edge& edge : set.edges) {
        EXPECT_EQ(std::abs(edge.n0.z), 1);
        EXPECT_EQ(edge.n1, -edge.n0);
        // A silhouette from everywhere, the plane of the square too.
        for (const Point3d& from : {Point3d{0.5, 0.5, 1}, {3, 3, -1}, {5, 7, 0}})
            EXPECT_TRUE(is_silhouette(edge, from));
    }
    // Both sides modelled: the same.
    Mesh doubled = square;
    for (std::uint32_t i : {2u, 1u, 0u, 0u, 3u, 2u}) doubled.indices.push_back(i);
    set = edges_of(doubled);
    ASSERT_EQ(set.edges.size(), 4u);
    for (const Edge& edge : set.edges) EXPECT_TRUE(is_silhouette(edge, {0.5, 0.5, 1}));
    // Without the triangles that have no area.
    Mesh with_slivers = square;
    for (std::uint32_t i : {0u, 1u, 1u, 2u, 2u, 2u}) with_slivers.indices.push_back(i);
    with_slivers.positions.push_back({0.5f, 0, 0});
    for (std::uint32_t i : {0u, 4u, 1u}) with_slivers.indices.push_back(i);
    EXPECT_EQ(edges_of(with_slivers).edges.size(), 4u);
    EXPECT_TRUE(edges_of({}).edges.empty());
}

class EdgesOfFiles : public SceneFolder {};

TEST_F(EdgesOfFiles, SeamsOfTextureCoordinatesAreNoBorders) {
    // A roof whose ridge is a seam: its vertices are there twice.
    write("roof.obj",
          "v 0 0 0\nv 0 1 0\nv 1 0 1\nv 1 1 1\nv 1 0 1\nv 1 1 1\nv 2 0 0\nv 2 1 0\n"
          "vt 0 0\nvt 0 1\nvt .5 0\nvt .5 1\nvt .6 0\nvt .6 1\nvt 1 0\nvt 1 1\n"
          "f 1/1 3/3 4/4 2/2\nf 5/5 7/7 8/8 6/6\n");
    const Mesh mesh = load_obj(path("roof.obj"));
    ASSERT_EQ(mesh.positions.size(), 8u);
    const EdgeSet set = edges_of(mesh);
    EXPECT_EQ(count(set, EdgeKind::border), 6u);
    EXPECT_EQ(count(set, EdgeKind::shared), 1u);
}

TEST(Edges, OfOtherShapes) {
    std::vector<Shape> shapes(4);
    shapes[0] = mesh_shape(split_cube(1));
    shapes[1].kind = ShapeKind::sphere;
    shapes[2].kind = ShapeKind::disk;
    shapes[2].round.center = {1, 2, 3};
    shapes[2].round.u_axis = {2, 0, 0};
    shapes[2].round.v_axis = {1, 1, 0};
    shapes[3] = shapes[0];  // in the same place: not joined
    EdgeSet set = find_edges(shapes);
    EXPECT_EQ(set.edges.size(), 24u);
    EXPECT_EQ(set.edges.back().shape_idx, 3u);
    ASSERT_EQ(set.rims.size(), 1u);
    const RimEdge& rim = set.rims[0];
    EXPECT_EQ(rim.shape_idx, 2u);
    for (double phi : {0.0, 0.7, 2.0, 4.0}) {
        EXPECT_NEAR(length(rim.point(phi) + rim.inward(phi) - Point3d{1, 2, 3}), 0, 1e-12);
        const Vector3d slope = (rim.point(phi + 1e-5) - rim.point(phi - 1e-5)) / 2e-5;
        EXPECT_NEAR(length(slope - rim.tangent(phi)), 0, 1e-8);
    }
    set = find_edges(shapes, {false, true, false, true});
    EXPECT_EQ(set.edges.size(), 12u);
    EXPECT_EQ(set.edges.front().shape_idx, 3u);
    EXPECT_TRUE(set.rims.empty());
}

/// Whether all triangles at an edge are on one side as seen from a point, by the corners of the mesh.
/// out:     clear  false: a triangle is seen almost edge-on, the answer is rounding
bool is_silhouette_slowly(const Mesh& mesh, const EdgeSet& set, const Edge& edge, const Point3d& from, bool& clear) {
    bool left = false, right = false;
    clear = true;
    const Point3d a(edge.a), b(edge.b);
    for (std::uint32_t face : set.faces_of(edge)) {
        Point3d opposite;
        double farthest = -1;
        for (int k = 0; k < 3; ++k) {
            const Point3d p(mesh.positions[mesh.indices[3 * face + unsigned(k)]]);
            const double off = length(cross(b - a, p - a));
            if (off > farthest) {
                farthest = off;
                opposite = p;
            }
        }
        const Vector3d n = cross(b - a, opposite - a);
        const double side = dot(n, from - a) / length(n);
        (side > 0 ? left : right) = true;
        clear = clear && std::abs(side) > 1e-6 * (1 + length(from - a));
    }
    return left != right;
}

// The silhouette and its outer side depend on where the triangles are, not on how they are wound.
// Detected mutations: n1 on the other side.
TEST(Edges, ClassificationDoesNotDependOnTheWinding) {
    Numbers numbers(1);
    const Mesh regular = test::icosphere(2, {}, 1);
    Mesh mixed = regular;
    for (std::size_t t = 0; t < mixed.n_triangles(); ++t)
        if (numbers.u() < 0.5f) std::swap(mixed.indices[3 * t], mixed.indices[3 * t + 1]);
    const EdgeSet a = edges_of(regular), b = edges_of(mixed);
    ASSERT_EQ(a.edges.size(), b.edges.size());
    std::size_t n_silhouettes = 0;
    for (int i = 0; i < 200; ++i) {
        // From planes of triangles too.
        const Point3f from = i % 4 ? numbers.point(3) : regular.positions[std::size_t(i)] + Vector3f{0, 0, 1};
        for (std::size_t k = 0; k < a.edges.size(); ++k) {
            const bool is = is_silhouette(a.edges[k], Point3d(from));
            ASSERT_EQ(is, is_silhouette(b.edges[k], Point3d(from))) << i << ' ' << k;
            if (!is) continue;
            ++n_silhouettes;
            const Vector3d omega = normalize(a.edges[k].point(0.5) - Point3d(from));
            const Vector3d out = outward(a.edges[k], omega);
            EXPECT_EQ(out, outward(b.edges[k], omega));
            // Away from the sphere.
            const Vector3d up = Vector3d(a.edges[k].point(0.5));
            EXPECT_TRUE(dot(out, up) > 0 || length(Vector3d(from)) < 1.1 || length(out) < 0.1);
        }
    }
    EXPECT_GT(n_silhouettes, 2000u);
}

/// Fans of triangles about the z axis, at angles in degrees.
Mesh fan(const std::vector<double>& angles) {
    Mesh mesh = mesh_of({{0, 0, 0}, {0, 0, 1}}, {});
    for (double angle : angles) {
        const double a = angle * pi_double / 180;
        mesh.indices.insert(mesh.indices.end(), {0, 1, std::uint32_t(mesh.positions.size())});
        mesh.positions.push_back({float(std::cos(a)), float(std::sin(a)), 0.5f});
    }
    return mesh;
}

// Detected mutations: the first two of three triangles; an edge kept that triangles surround.
TEST(Edges, OfManyTrianglesAreSilhouettesWhereAllAreOnOneSide) {
    Numbers numbers(2);
    std::size_t n_with_axis = 0;
    for (int i = 0; i < 300; ++i) {
        std::vector<double> angles;
        const float spread = i % 3 ? 200 : 360;
        for (int k = 0; k < 1 + i % 5; ++k) angles.push_back(numbers.in(0, spread));
        const Mesh mesh = fan(angles);
        const EdgeSet set = edges_of(mesh);
        const auto on_axis = [](const Edge& edge) {
            return edge.a.x == 0 && edge.b.x == 0 && edge.a.y == 0 && edge.b.y == 0;
        };
        const auto at = std::find_if(set.edges.begin(), set.edges.end(), on_axis);
        Edge axis;
        EdgeSet all_faces;
        axis.a = {0, 0, 0};
        axis.b = {0, 0, 1};
        for (std::size_t k = 0; k < angles.size(); ++k) all_faces.faces.push_back(std::uint32_t(k));
        axis.n_faces = std::uint32_t(angles.size());
        if (at != set.edges.end()) {
            EXPECT_EQ(at->n_faces, angles.size());
            ++n_with_axis;
        }
        for (int j = 0; j < 50; ++j) {
            const Point3d from(numbers.point(4));
            bool clear;
            const bool is = is_silhouette_slowly(mesh, all_faces, axis, from, clear);
            if (!clear) continue;
            ASSERT_EQ(is, at != set.edges.end() && is_silhouette(*at, from));
        }
    }
    EXPECT_GT(n_with_axis, 150u);
    EXPECT_LT(n_with_axis, 290u);
    const auto has_axis = [](const std::vector<double>& angles) {
        const EdgeSet set = edges_of(fan(angles));
        return std::any_of(set.edges.begin(), set.edges.end(), [](const Edge& e) { return e.a.x == 0 && e.b.x == 0; });
    };
    EXPECT_FALSE(has_axis({0, 90, 180}));       // a wall on a floor
    EXPECT_FALSE(has_axis({0, 90, 180, 270}));  // two cubes that touch at an edge
    EXPECT_TRUE(has_axis({0, 30, 90}));
    EXPECT_TRUE(has_axis({0, 90}));
    EXPECT_FALSE(has_axis({0, 180}));
}

/// Meshes of all kinds, with their trees.
struct Case {
    const char* name;
    Mesh mesh;
    EdgeTree tree;
};
const std::vector<Case>& cases() {
    static const std::vector<Case> all = [] {
        std::vector<Case> made;
        const auto add = [&](const char* name, const Mesh& mesh) {
            made.push_back({name, mesh, EdgeTree(edges_of(mesh))});
        };
        add("one triangle", mesh_of({{-0.5f, -0.5f, 0}, {0.5f, -0.5f, 0.2f}, {0, 0.5f, 0.1f}}, {0, 1, 2}));
        add("cube", split_cube(2));
        add("icosphere of 1,920 edges", test::icosphere(3, {0.1f, 0.2f, 0}, 0.7f));
        add("soup", soup(300, 0.3f, 3));
        add("terrain", terrain(30, 4));
        // Windings at random, and a shell in a shell: two sheets with opposite normals.
        Mesh shells = test::icosphere(3, {}, 0.8f);
        const Mesh inner = test::icosphere(3, {}, 0.79f);
        for (std::uint32_t i : inner.indices) shells.indices.push_back(i + std::uint32_t(shells.positions.size()));
        shells.positions.insert(shells.positions.end(), inner.positions.begin(), inner.positions.end());
        Numbers numbers(5);
        for (std::size_t t = 0; t < shells.n_triangles(); ++t)
            if (numbers.u() < 0.5f) std::swap(shells.indices[3 * t], shells.indices[3 * t + 1]);
        add("shells", shells);
        return made;
    }();
    return all;
}

// The cones of normals and the boxes skip no silhouette: all that a loop over the edges finds, in the same order.
// Detected mutations: the cone's bound without the reach of the edges, with that of the other side, with half its sine,
// or over one normal of each edge.
TEST(EdgeTree, ListsAllSilhouettes) {
    std::vector<EdgeSegment> found;
    for (const Case& c : cases()) {
        Numbers numbers(6);
        std::size_t n_silhouettes = 0;
        constexpr int n_queries = 4000;
        for (int i = 0; i < n_queries; ++i) {
            const Point3f from = i % 2 ? numbers.point(1) : numbers.point(10);
            const Vector3f direction = numbers.direction();
            const bool at_infinity = i % 4 == 3;
            const Shaft shaft = at_infinity ? Shaft::along(direction) : Shaft::to_infinity({from});
            c.tree.collect(shaft, found);
            std::size_t k = 0;
            for (std::uint32_t idx = 0; idx < c.tree.n_edges(); ++idx) {
                const Edge& edge = c.tree.edge(idx);
                if (!(at_infinity ? is_silhouette_along(edge, Vector3d(direction))
                                  : is_silhouette(edge, Point3d(from))))
                    continue;
                ASSERT_LT(k, found.size()) << c.name << ", query " << i;
                ASSERT_EQ(found[k].edge_idx, idx) << c.name << ", query " << i;
                EXPECT_EQ(found[k].s0, 0);
                EXPECT_EQ(found[k].s1, 1);
                EXPECT_FLOAT_EQ(found[k].length, float(edge.length()));
                ++k;
            }
            ASSERT_EQ(k, found.size()) << c.name << ", query " << i;
            n_silhouettes += k;
        }
        EXPECT_GT(n_silhouettes, 2u * n_queries) << c.name;
    }
}

/// The light of a shaft, with a slow test of what is before it.
struct Light {
    std::vector<Point3f> outline;  // empty: a sphere
    Point3f center;
    float radius = 0;

    Shaft shaft(const RayEnd& from) const {
        return outline.empty() ? Shaft::to_sphere(from, center, radius) : Shaft::to_polygon(from, outline);
    }
    /// Whether a point is between x and the light: inside of a tetrahedron over a triangle of the polygon by barycentric
    /// coordinates, or before the first hit with the sphere.
    bool is_before(const Point3d& p, const Point3d& x) const {
        const Vector3d e = p - x;
        if (!outline.empty()) {
            for (std::size_t k = 1; k + 1 < outline.size(); ++k) {
                const Vector3d q0 = Point3d(outline[0]) - x, q1 = Point3d(outline[k]) - x,
                               q2 = Point3d(outline[k + 1]) - x;
                const double det = dot(q0, cross(q1, q2));
                const double w0 = dot(e, cross(q1, q2)) / det, w1 = dot(q0, cross(e, q2)) / det,
                             w2 = dot(q0, cross(q1, e)) / det;
                if (w0 >= 0 && w1 >= 0 && w2 >= 0 && w0 + w1 + w2 <= 1) return true;
            }
            return false;
        }
        const Vector3d to = Point3d(center) - x, w = normalize(e);
        if (length(to) < radius) return length(p - Point3d(center)) < radius;
        const double b = dot(to, w), h2 = sqr(double(radius)) - (dot(to, to) - b * b);
        return h2 > 0 && b > 0 && length(e) < b - std::sqrt(h2);
    }
};

/// Checks what collect() finds against samples of each silhouette. Returns how many silhouettes were clipped.
std::size_t expect_clipped(const Case& c, const Light& light, const RayEnd& from, std::vector<EdgeSegment>& found) {
    const Point3d x(from.p);
    const Vector3d n(from.n);
    c.tree.collect(light.shaft(from), found);
    std::size_t k = 0, n_clipped = 0;
    for (std::uint32_t idx = 0; idx < c.tree.n_edges(); ++idx) {
        const Edge& edge = c.tree.edge(idx);
        const std::size_t first = k;
        double sum = 0;
        while (k < found.size() && found[k].edge_idx == idx) {
            sum += found[k].s1 - found[k].s0;
            EXPECT_LT(found[k].s0, found[k].s1);
            EXPECT_NEAR(found[k].length, edge.length() * (found[k].s1 - found[k].s0), 1e-6);
            ++k;
        }
        n_clipped += sum > 0 && sum < 1;
        bool clear;
        const bool is = is_silhouette_slowly(c.mesh, c.tree.set(), edge, x, clear);
        if (!clear) continue;
        if (!is) {
            EXPECT_EQ(k, first);
            continue;
        }
        constexpr int n_samples = 40;
        for (int i = 0; i <= n_samples; ++i) {
            const double s = double(i) / n_samples;
            bool in = false, near = false;
            for (std::size_t j = first; j < k; ++j) {
                in |= s >= found[j].s0 && s <= found[j].s1;
                near |= std::abs(s - found[j].s0) < 1e-4 || std::abs(s - found[j].s1) < 1e-4;
            }
            const Point3d p = edge.point(s);
            const bool expected = light.is_before(p, x) && (length2(n) == 0 || dot(n, p - x) > 0);
            // Samples on the boundary, which a short interval or none at all may miss.
            if (!near && in != expected) {
                int n_in = 0;
                for (double ds : {-1e-4, 1e-4}) {
                    const Point3d q = edge.point(s + ds);
                    n_in += light.is_before(q, x) && (length2(n) == 0 || dot(n, q - x) > 0);
                }
                EXPECT_NE(n_in, expected ? 2 : 0) << c.name << ", edge " << idx << " at " << s;
            }
        }
    }
    EXPECT_EQ(k, found.size());
    return n_clipped;
}

// Random points, lights and meshes against the loop over all edges.
// Detected mutations: a plane of the pyramid lost; all reversed for one orientation of the polygon; no front plane; no
// tangent plane; the ball of a spherical light not cut out; boxes halved.
TEST(EdgeTree, ClipsSilhouettesToTheShaftOfALight) {
    std::vector<EdgeSegment> found, reversed;
    for (const Case& c : cases()) {
        Numbers numbers(7);
        std::size_t n_clipped = 0, n_found = 0;
        for (int i = 0; i < 1200; ++i) {
            RayEnd from{numbers.point(1.5f)};
            if (i % 3 == 0) from.n = Normal3f(numbers.direction());
            Light light;
            const Point3f corner = numbers.point(2);
            const Vector3f u = numbers.direction() * numbers.in(0.05f, 2),
                           v = numbers.direction() * numbers.in(0.05f, 2);
            if (i % 4 == 0) {
                light.outline = {corner, corner + u, corner + v};
            } else if (i % 4 < 3) {
                light.outline = {corner, corner + u, corner + u + v, corner + v};
            } else {
                light.center = corner;
                light.radius = numbers.in(0.05f, 1.5f);
            }
            n_clipped += expect_clipped(c, light, from, found);
            n_found += found.size();
            std::reverse(light.outline.begin(), light.outline.end());
            c.tree.collect(light.shaft(from), reversed);
            ASSERT_EQ(found.size(), reversed.size());
            for (std::size_t k = 0; k < found.size(); ++k) {
                EXPECT_EQ(found[k].edge_idx, reversed[k].edge_idx);
                EXPECT_NEAR(found[k].s0, reversed[k].s0, 1e-9);
                EXPECT_NEAR(found[k].s1, reversed[k].s1, 1e-9);
            }
        }
        EXPECT_GT(n_clipped, 200u) << c.name;
        EXPECT_GT(n_found, n_clipped) << c.name;
    }
}

// Detected mutations: the light's own borders kept, or an edge in line with the apex.
TEST(EdgeTree, DegenerateShafts) {
    const Mesh square =
        mesh_of({{-0.4f, -0.4f, 1}, {0.4f, -0.4f, 1}, {0.4f, 0.4f, 1}, {-0.4f, 0.4f, 1}}, {0, 1, 2, 2, 3, 0});
    const EdgeTree tree(edges_of(square));
    const std::vector<Point3f> lamp = {{-1, -1, 3}, {1, -1, 3}, {1, 1, 3}, {-1, 1, 3}};
    std::vector<EdgeSegment> found;
    const auto n_found = [&](const Shaft& shaft) {
        tree.collect(shaft, found);
        return found.size();
    };
    EXPECT_EQ(n_found(Shaft::to_polygon({{0, 0, -1}}, lamp)), 4u);
    EXPECT_EQ(n_found(Shaft::to_polygon({{0, 0, 5}}, lamp)), 0u);  // the light is on the way
    EXPECT_EQ(n_found(Shaft::to_polygon({{0, 0, 2}}, lamp)), 0u);  // the edges are behind
    // In the light's plane, and lights without area or with too few corners.
    EXPECT_TRUE(Shaft::to_polygon({{5, 0, 3}}, lamp).empty());
    EXPECT_TRUE(Shaft::to_polygon({{0, 0, 3}}, lamp).empty());
    const Point3f line[] = {{0, 0, 3}, {1, 1, 3}, {2, 2, 3}};
    EXPECT_TRUE(Shaft::to_polygon({{0, 0, 0}}, line).empty());
    EXPECT_TRUE(Shaft::to_polygon({{0, 0, 0}}, {line, 2}).empty());
    EXPECT_TRUE(Shaft::to_polygon({{0, 0, 0}}, {}).empty());
    EXPECT_EQ(n_found(Shaft::to_polygon({{0, 0, 0}}, line)), 0u);
    // The occluder is the light: its own borders are no boundary.
    EXPECT_EQ(n_found(Shaft::to_polygon({{0.1f, 0.2f, 0}}, square.positions)), 0u);
    // On an edge, at its end, and in line with it: the edge itself subtends no angle.
    for (const Point3f& x : {Point3f{0.4f, 0.1f, 1}, {0.4f, 0.4f, 1}, {0.4f, 2, 1}}) {
        tree.collect(Shaft::to_infinity({x}), found);
        for (const EdgeSegment& segment : found) {
            const Edge& edge = tree.edge(segment.edge_idx);
            EXPECT_FALSE(edge.a.x == 0.4f && edge.b.x == 0.4f);
        }
    }
    // Above the tangent plane only.
    EXPECT_EQ(n_found(Shaft::to_infinity({{0, 0, 0}, {0, 0, 1}})), 4u);
    EXPECT_EQ(n_found(Shaft::to_infinity({{0, 0, 0}, {0, 0, -1}})), 0u);
    EXPECT_EQ(n_found(Shaft::to_infinity({{0, 0, 1}, {0, 0, 1}})), 0u);
    ASSERT_EQ(n_found(Shaft::to_infinity({{0.2f, 0, 0}, {1, 0, 0}})), 3u);
    // An edge through a ball has two parts; a sphere behind has none.
    const Mesh bar = mesh_of({{-2, 0, 2}, {2, 0, 2}, {0, 1, 2}}, {0, 1, 2});
    const EdgeTree bars(edges_of(bar));
    bars.collect(Shaft::to_sphere({{0, 0, 0}}, {0, 0, 2.5f}, 0.7f), found);
    const auto on_bar = std::count_if(found.begin(), found.end(), [&](const EdgeSegment& s) {
        return bars.edge(s.edge_idx).a.y == 0 && bars.edge(s.edge_idx).b.y == 0;
    });
    EXPECT_EQ(on_bar, 2);
    EXPECT_EQ(n_found(Shaft::to_sphere({{0, 0, 0}}, {0, 0, -2}, 0.5f)), 0u);
    EXPECT_EQ(n_found(Shaft::to_sphere({{0, 0, 0}}, {0, 0, 1}, 5)), 4u);  // from inside
    // No edges at all.
    EdgeTree().collect(Shaft::to_infinity({{0, 0, 0}}), found);
    EXPECT_TRUE(found.empty());
}

// A random part of the silhouettes: each is listed with the probability that it carries, within the same shaft, and about
// as many nodes are visited as blocks were asked for, times the depth.
// Detected mutations: a child's share without that of its parent; one random number for all nodes.
TEST(EdgeTree, ListsARandomPartWithKnownProbabilities) {
    EdgeSet set = edges_of(test::icosphere(5, {}, 1));
    std::vector<float> speeds;
    for (const Edge& edge : set.edges) speeds.push_back(edge.a.x > 0 ? 3.0f : 0.0f);
    const EdgeTree tree(std::move(set), speeds);
    ASSERT_GT(tree.n_edges(), 10000u);
    Numbers numbers(8);
    const std::vector<Point3f> lamp = {{-2, -2, 3}, {2, -2, 3}, {2, 2, 3}, {-2, 2, 3}};
    std::vector<EdgeSegment> all, some;
    for (int query = 0; query < 24; ++query) {
        const Point3f far = Point3f{} + numbers.direction() * 2.5f;
        const Shaft shaft = query % 3 == 0   ? Shaft::to_infinity({far})
                            : query % 3 == 1 ? Shaft::along(numbers.direction())
                                             : Shaft::to_polygon({{0.3f, 0.1f * float(query % 5), -2}}, lamp);
        tree.collect(shaft, all);
        ASSERT_FALSE(all.empty()) << query;
        double exact = 0;
        for (const EdgeSegment& segment : all) exact += segment.length;
        constexpr int n = 3000;
        std::vector<double> expected(tree.n_edges()), listed(tree.n_edges());
        double sum = 0, square = 0, n_visited = 0;
        for (int i = 0; i < n; ++i) {
            n_visited += double(tree.collect_some(shaft, 16, query % 2, std::uint64_t(10000 * query + i), some));
            double total = 0;
            for (const EdgeSegment& segment : some) {
                ASSERT_GT(segment.share, 0);
                ASSERT_LE(segment.share, 1);
                total += double(segment.length) / double(segment.share);
                expected[segment.edge_idx] = double(segment.share);
                listed[segment.edge_idx] += 1;
            }
            sum += total, square += total * total;
        }
        const double mean = sum / n, se = std::sqrt(std::max(square / n - mean * mean, 0.0) / n);
        EXPECT_NEAR(mean, exact, 4.5 * se + 1e-4 * exact) << query;
        EXPECT_LT(n_visited / n, 16 * 12) << query;
        double chi2 = 0;
        int n_edges = 0;
        for (std::size_t i = 0; i < listed.size(); ++i)
            if (const double p = expected[i]; p * n > 20 && p < 0.99)
                chi2 += std::pow(listed[i] - p * n, 2) / (p * (1 - p) * n), ++n_edges;
        // Siblings exclude each other, which makes the sum vary more than that of independent ones.
        if (n_edges > 20) {
            EXPECT_LT(chi2 / n_edges, 2) << query << ", " << n_edges << " edges";
        }
    }
}

// From a few clusters: of all edges where they are few, and the closer the farther away.
TEST(EdgeTree, KnowsAboutHowMuchMovesAroundAPoint) {
    EXPECT_EQ(EdgeTree().motion_around({0, 0, 0}, 1), 0);
    for (const int n : {1, 4, 5, 40, 4000}) {
        EdgeSet set = edges_of(soup(n, 0.1f, 9));
        std::vector<float> speeds;
        for (const Edge& edge : set.edges) speeds.push_back(edge.a.x > 0 ? 3.0f : 0.0f);
        const EdgeTree tree(set, speeds), at_rest(set);
        Numbers numbers(3);
        for (int query = 0; query < 32; ++query) {
            const double distance = query % 2 ? 3 : 30, end_speed = query % 3;
            const auto eye = Point3<double>(Vector3<double>(numbers.direction()) * distance);
            double exact = 0;
            for (std::size_t i = 0; i < set.edges.size(); ++i)
                exact +=
                    set.edges[i].length() * (double(speeds[i]) + end_speed) / length2(set.edges[i].point(0.5) - eye);
            EXPECT_NEAR(tree.motion_around(eye, end_speed), exact, (distance > 10 ? 0.15 : 0.5) * exact) << n;
            EXPECT_EQ(at_rest.motion_around(eye, 0), 0);
        }
    }
}

TEST(EdgeTree, FindsTheEdgesNearAPoint) {
    EXPECT_FALSE(EdgeTree().find_near({0, 0, 0}, 1, [](std::uint32_t) { return true; }).has_value());
    for (const int n : {1, 40, 4000}) {
        const EdgeTree tree(edges_of(soup(n, 0.1f, 9)));
        Numbers numbers(5);
        std::size_t n_near = 0;
        for (int query = 0; query < 64; ++query) {
            const Edge& edge = tree.edge(std::uint32_t(query) % std::uint32_t(tree.n_edges()));
            const Point3d p = edge.point(0.3) + Vector3d(numbers.direction()) * 0.02;
            const double distance = query % 2 ? 0.03 : 0.015;
            std::set<std::uint32_t> near, found;
            for (std::uint32_t i = 0; i < tree.n_edges(); ++i) {
                double least = INFINITY;
                for (int k = 0; k <= 100; ++k) least = std::min(least, length(tree.edge(i).point(k / 100.0) - p));
                if (std::abs(least - distance) < 1e-4) found.insert(i);  // too close to tell
                if (least < distance) near.insert(i);
            }
            for (const std::uint32_t i : found) near.insert(i);
            EXPECT_FALSE(tree.find_near(p, distance,
                                        [&](std::uint32_t i) {
                                            found.insert(i);
                                            return false;
                                        })
                             .has_value());
            EXPECT_EQ(found, near);
            n_near += near.size();
            for (const std::uint32_t wanted : near) {
                const auto is_wanted = [&](std::uint32_t i) { return i == wanted; };
                EXPECT_EQ(tree.find_near(p, distance + 2e-4, is_wanted), wanted);
            }
        }
        EXPECT_GT(n_near, 32u);
    }
}

TEST(EdgeTree, IsTheSameEachTimeAndHoldsEachEdgeOnce) {
    for (int n : {1, 2, 3, 5, 7, 11, 40}) {
        const EdgeSet set = edges_of(soup(n, 0.2f, 9));
        const EdgeTree one(set), two(set);
        ASSERT_EQ(one.n_edges(), set.edges.size());
        std::set<std::array<float, 6>> seen;
        for (std::uint32_t i = 0; i < one.n_edges(); ++i) {
            const Edge &e = one.edge(i), &f = two.edge(i);
            EXPECT_TRUE(e.a == f.a && e.b == f.b);
            seen.insert({e.a.x, e.a.y, e.a.z, e.b.x, e.b.y, e.b.z});
            EXPECT_EQ(one.set().faces_of(e).size(), 1u);
        }
        EXPECT_EQ(seen.size(), set.edges.size());
    }
    // Positions that cannot be told apart along any axis.
    Mesh same = soup(1, 0.2f, 9);
    for (int i = 0; i < 500; ++i) {
        for (std::uint32_t k : {0u, 1u}) same.indices.push_back(k);
        same.indices.push_back(std::uint32_t(same.positions.size()));
        same.positions.push_back(Point3f{0.1f, 0.1f, 0.1f} + Vector3f{0, 0, 1e-6f} * float(i));
    }
    EXPECT_GT(EdgeTree(edges_of(same)).n_edges(), 1000u);
}

/// Integral of f over a rectangle at height z by n x n midpoints.
template <class F>
double over_rectangle(double x0, double x1, double y0, double y1, double z, const F& f) {
    constexpr int n = 400;
    double sum = 0;
    for (int i = 0; i < n; ++i)
        for (int j = 0; j < n; ++j)
            sum += f(Point3d{x0 + (x1 - x0) * (i + 0.5) / n, y0 + (y1 - y0) * (j + 0.5) / n, z});
    return sum * (x1 - x0) * (y1 - y0) / (n * n);
}

// A square lamp [-.3, .3]^2 at z = 3 of radiance 1, an occluder [-.4, .4]^2 at z = 1, a receiver point on the floor; each
// moves with (1, .4, .3). E = integral of cos cos / (pi r^2) over the visible part of the lamp. What moves the shadow is
// the boundary term; the rest is the derivative of the integrand on the lamp's own points.
// Detected mutations: the sign of swept; 1 - s lost; s of v_light lost; t x omega turned inwards; no clipping.
TEST(Boundary, DerivativesOfAShadowByOccluderReceiverAndLamp) {
    const Point3f from{0.72f, 0.31f, 0};
    const Point3d x(from);
    const Vector3d v{1, 0.4, 0.3}, still{};
    const std::vector<Point3f> lamp = {{-0.3f, -0.3f, 3}, {0.3f, -0.3f, 3}, {0.3f, 0.3f, 3}, {-0.3f, 0.3f, 3}};
    const EdgeTree tree(edges_of(
        mesh_of({{-0.4f, -0.4f, 1}, {0.4f, -0.4f, 1}, {0.4f, 0.4f, 1}, {-0.4f, 0.4f, 1}}, {0, 1, 2, 2, 3, 0})));
    std::vector<EdgeSegment> found;
    tree.collect(Shaft::to_polygon({from, {0, 0, 1}}, lamp), found);
    ASSERT_FALSE(found.empty());
    const auto boundary = [&](const Vector3d& v_edge, const Vector3d& v_from, const Vector3d& v_lamp) {
        double sum = 0;
        for (const EdgeSegment& segment : found) {
            const Edge& edge = tree.edge(segment.edge_idx);
            constexpr int n = 2000;
            for (int i = 0; i < n; ++i) {
                const Point3d at = edge.point(segment.s0 + (segment.s1 - segment.s0) * (i + 0.5) / n);
                const double r = length(at - x);
                const Vector3d omega = (at - x) / r;
                const double s = r * omega.z / 3;
                const double f_cos = omega.z / pi_double;
                sum += f_cos * swept(outward(edge, omega), relative_velocity(s, v_edge, v_from, v_lamp)) / (r * r) *
                       segment.length / n;
            }
        }
        return sum;
    };
    // d(cos cos / (pi r^2)) for d = y - x with velocity v, normals (0, 0, 1).
    const auto interior = [&](const Vector3d& v_d) {
        return over_rectangle(-0.24, 0.3, -0.3, 0.3, 3, [&](const Point3d& y) {
            const Vector3d d = y - x;
            const double r2 = length2(d), value = sqr(d.z / r2) / pi_double;
            return value * (2 * v_d.z / d.z - 4 * dot(d, v_d) / r2);
        });
    };
    EXPECT_NEAR(boundary(v, still, still), -0.0560014, 1e-6);
    EXPECT_NEAR(boundary(still, v, still) + interior(-v), 0.0357395, 1e-6);
    EXPECT_NEAR(boundary(still, still, v) + interior(v), 0.0202620, 1e-6);
    EXPECT_NEAR(boundary(v, v, v), 0, 1e-12);
}

}  // namespace
}  // namespace loom
