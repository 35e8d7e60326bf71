#include "stages/core/edges/edges.h"

#include <algorithm>
#include <array>
#include <numeric>
#include <tuple>

namespace loom {
namespace {

using Point3d = Point3<double>;
using Vector3d = Vector3<double>;

// rad. No higher bound for shapes far from the origin, whose normals are less exact: a fine mesh of a curved surface
// would lose its silhouettes, while edges that rounding leaves on a plane are silhouettes from almost nowhere.
constexpr double coplanar = 1e-6;

/// One side of a triangle, between two joined vertices.
struct Side {
    std::uint32_t low, high;  // joined vertices, by their first index
    std::uint32_t triangle_idx;
    std::uint32_t opposite;

    auto key() const { return std::tie(low, high, triangle_idx); }
};

/// Returns, for each vertex, the first one at its position.
std::vector<std::uint32_t> joined_vertices(const std::vector<Point3f>& positions) {
    const auto key = [&](std::uint32_t i) { return std::tie(positions[i].x, positions[i].y, positions[i].z); };
    std::vector<std::uint32_t> order(positions.size()), joined(positions.size());
    std::iota(order.begin(), order.end(), 0u);
    std::sort(order.begin(), order.end(),
              [&](std::uint32_t i, std::uint32_t j) { return std::tuple(key(i), i) < std::tuple(key(j), j); });
    for (std::size_t k = 0; k < order.size(); ++k)
        joined[order[k]] = k > 0 && key(order[k]) == key(order[k - 1]) ? joined[order[k - 1]] : order[k];
    return joined;
}

std::vector<Side> sorted_sides(const Mesh& mesh) {
    const std::vector<std::uint32_t> joined = joined_vertices(mesh.positions);
    std::vector<Side> sides;
    sides.reserve(mesh.indices.size());
    for (std::size_t t = 0; t < mesh.n_triangles(); ++t) {
        std::array<std::uint32_t, 3> corner;
        for (std::size_t k = 0; k < 3; ++k) corner[k] = joined[mesh.indices[3 * t + k]];
        const Point3d p0(mesh.positions[corner[0]]), p1(mesh.positions[corner[1]]), p2(mesh.positions[corner[2]]);
        if (!(length2(cross(p1 - p0, p2 - p0)) > 0)) continue;
        for (std::size_t k = 0; k < 3; ++k) {
            const std::uint32_t start = corner[k], end = corner[(k + 1) % 3];
            sides.push_back({std::min(start, end), std::max(start, end), std::uint32_t(t), corner[(k + 2) % 3]});
        }
    }
    std::sort(sides.begin(), sides.end(), [](const Side& i, const Side& j) { return i.key() < j.key(); });
    return sides;
}

/// Sets the normals of an edge from the sides that meet there; false: it is never a silhouette.
bool set_normals(Edge& edge, std::span<const Side> sides, const std::vector<Point3f>& positions) {
    const Point3d a(edge.a);
    const Vector3d t = normalize(Point3d(edge.b) - a);
    // Turn each normal so that its triangle lies to the left of the edge. All are on one side, as seen from x, where all
    // these normals face x.
    struct Turned {
        Vector3d n;
        double angle;
        std::size_t side_idx;
    };
    std::vector<Turned> turned;
    turned.reserve(sides.size());
    for (std::size_t i = 0; i < sides.size(); ++i)
        turned.push_back({normalize(cross(t, Point3d(positions[sides[i].opposite]) - a)), 0, i});
    const Vector3d u = turned[0].n, v = cross(t, u);
    if (sides.size() == 1) {
        edge.n0 = Normal3f(u);
        edge.n1 = -edge.n0;
        return true;
    }
    // Find the widest gap between them. It must exceed a half turn; the normals at its ends are the outermost.
    for (Turned& one : turned) one.angle = std::atan2(dot(one.n, v), dot(one.n, u));
    std::sort(turned.begin(), turned.end(), [](const Turned& i, const Turned& j) {
        return std::tie(i.angle, i.side_idx) < std::tie(j.angle, j.side_idx);
    });
    double widest = turned.front().angle + 2 * pi_double - turned.back().angle;
    std::size_t before = turned.size() - 1, after = 0;
    for (std::size_t i = 1; i < turned.size(); ++i)
        if (const double gap = turned[i].angle - turned[i - 1].angle; gap > widest) {
            widest = gap;
            before = i - 1;
            after = i;
        }
    if (!(widest > pi_double + coplanar)) return false;
    if (turned[after].side_idx < turned[before].side_idx) std::swap(before, after);
    edge.n0 = Normal3f(turned[before].n);
    edge.n1 = Normal3f(-turned[after].n);
    edge.kind = EdgeKind::shared;
    return true;
}

void add_mesh_edges(const Mesh& mesh, std::uint32_t shape_idx, EdgeSet& set) {
    const std::vector<Side> sides = sorted_sides(mesh);
    for (std::size_t begin = 0, end; begin < sides.size(); begin = end) {
        const Side& first = sides[begin];
        for (end = begin + 1; end < sides.size() && sides[end].low == first.low && sides[end].high == first.high;)
            ++end;
        Edge edge;
        edge.a = mesh.positions[first.low];
        edge.b = mesh.positions[first.high];
        edge.shape_idx = shape_idx;
        edge.first_face_idx = std::uint32_t(set.faces.size());
        edge.n_faces = std::uint32_t(end - begin);
        if (!set_normals(edge, {&sides[begin], end - begin}, mesh.positions)) continue;
        for (std::size_t i = begin; i < end; ++i) set.faces.push_back(sides[i].triangle_idx);
        set.edges.push_back(edge);
    }
}

}  // namespace

EdgeSet find_edges(std::span<const Shape> shapes, const std::vector<bool>& wanted) {
    EdgeSet set;
    for (std::size_t i = 0; i < shapes.size(); ++i) {
        if (!wanted.empty() && !wanted.at(i)) continue;
        const Shape& shape = shapes[i];
        const auto shape_idx = std::uint32_t(i);
        if (shape.kind == ShapeKind::mesh) add_mesh_edges(shape.mesh, shape_idx, set);
        if (shape.kind == ShapeKind::disk)
            set.rims.push_back({shape.round.center, shape.round.u_axis, shape.round.v_axis, shape_idx});
    }
    return set;
}

}  // namespace loom
