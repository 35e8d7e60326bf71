// Curves that touch other surfaces: the edges of a box on a floor, of walls in the corners of a room. Of two edges at one
// place each has the light of its own surface, so that no light counts twice.

#include <algorithm>
#include <array>
#include <utility>

#include "stages/core/edges/boundary.h"
#include "stages/derive/boundary.h"

namespace loom::derive {
namespace {

using Vec = Vector3<double>;
using Pt = Point3<double>;

/// A plane, and rounding of what lies on it, m.
struct Plane {
    Pt p;
    Vec n;  // unit
    double error;
};
Plane plane_at(const Shape& shape, std::uint32_t primitive, const Pt& near) {
    if (shape.kind == ShapeKind::mesh) {
        const TriangleRecord& t = shape.triangles[primitive];
        const Pt p(t.p0);
        double error = seam_rounding(p);
        for (const Vec& side : {Vec(t.e1), Vec(t.e2)}) error = std::max(error, seam_rounding(p + side));
        return {p, normalize(cross(Vec(t.e1), Vec(t.e2))), error};
    }
    const Pt center(shape.round.center);
    if (shape.kind == ShapeKind::disk)
        return {center, normalize(cross(Vec(shape.round.u_axis), Vec(shape.round.v_axis))), seam_rounding(center)};
    const Vec n = normalize(near - center);
    const Pt p = center + n * double(shape.round.radius);
    return {p, n, seam_rounding(p)};
}

/// Whether a part of an edge lies on a triangle.
bool lies_on_triangle(const Edge& edge, const TriangleRecord& t, double error) {
    const Vec e1(t.e1), e2(t.e2), n = normalize(cross(e1, e2));
    const Vec a = Pt(edge.a) - Pt(t.p0), b = Pt(edge.b) - Pt(t.p0);
    if (std::abs(dot(n, a)) > error || std::abs(dot(n, b)) > error) return false;
    double s0 = 0, s1 = 1;
    const std::array<std::pair<Vec, Vec>, 3> sides{{{{}, e1}, {e1, e2}, {e2, {}}}};
    for (const auto& [from, to] : sides) {
        const Vec inside = cross(n, to - from);
        const double at_a = dot(inside, a - from), at_b = dot(inside, b - from);
        if (at_a < 0 && at_b < 0) return false;
        if (at_a < 0) s0 = std::max(s0, at_a / (at_a - at_b));
        if (at_b < 0) s1 = std::min(s1, at_a / (at_a - at_b));
    }
    return s0 < s1;
}

}  // namespace

void BoundaryScene::find_touched_emitters() {
    touched_emitters.assign(scene.emitters.size(), 0);
    const SeamQuery query = moving_pairs(scene, tangents);
    for (std::size_t e = 0; e < scene.emitters.size(); ++e) {
        if (scene.emitters[e].kind != EmitterKind::area) continue;
        const std::uint32_t light = scene.emitters[e].shape_idx;
        if (scene.shapes[light].kind == ShapeKind::sphere) continue;
        Box3f box = scene.shapes[light].bounds();
        const double error = std::max(seam_rounding(Pt(box.lo)), seam_rounding(Pt(box.hi)));
        box.grow(float(error));
        const auto touches = [&](const Edge& edge) {
            const std::uint32_t group = query.group[edge.shape_idx];
            if (edge.shape_idx == light || (group == query.group[light] && group != SeamQuery::deforms)) return false;
            for (int c = 0; c < 3; ++c)
                if (std::max(edge.a[c], edge.b[c]) < box.lo[c] || std::min(edge.a[c], edge.b[c]) > box.hi[c])
                    return false;
            if (scene.shapes[light].kind == ShapeKind::disk)
                return lies_on(Pt(edge.a), light, 0) && lies_on(Pt(edge.b), light, 0);
            const auto& triangles = scene.shapes[light].triangles;
            return std::any_of(triangles.begin(), triangles.end(),
                               [&](const TriangleRecord& t) { return lies_on_triangle(edge, t, error); });
        };
        const auto& edges = all_edges.set().edges;
        touched_emitters[e] = std::any_of(edges.begin(), edges.end(), touches);
    }
}

bool BoundaryScene::is_behind(const Pt& p, const Vec& view, std::uint32_t shape, std::uint32_t primitive) const {
    const Plane plane = plane_at(scene.shapes[shape], primitive, p);
    const double depth = dot(plane.n, p - plane.p) * (dot(plane.n, view) > 0 ? 1 : -1);
    return depth > std::max(plane.error, seam_rounding(p));
}

bool BoundaryScene::lies_on(const Pt& p, std::uint32_t shape, std::uint32_t primitive) const {
    const Plane plane = plane_at(scene.shapes[shape], primitive, p);
    return std::abs(dot(plane.n, p - plane.p)) <= std::max(plane.error, seam_rounding(p));
}

bool BoundaryScene::ends_too(const Curve& curve, std::uint32_t shape, std::uint32_t primitive) const {
    if (!curve.edge || is_face(curve, shape, primitive)) return false;
    const EdgeSet& set = curve.tree->set();
    const auto velocity = [&](const Edge& edge) {
        std::vector<Vec> v(n());
        edge_velocity(set, edge, edge.nearest(curve.p), v);
        return v;
    };
    const auto is_other = [&](std::uint32_t i) {
        const Edge& edge = set.edges[i];
        const std::span<const std::uint32_t> faces = set.faces_of(edge);
        if (edge.shape_idx != shape || std::find(faces.begin(), faces.end(), primitive) == faces.end()) return false;
        // It must be sampled itself: where it shows, and its light jumps.
        if (curve.front &&
            is_behind(edge.point(edge.nearest(curve.p)), curve.view, curve.front.shape_idx, curve.front.primitive_idx))
            return false;
        if (!is_silhouette_along(edge, -curve.view) && !is_crease(set, edge)) return false;
        if (curve.touched) return true;
        // Of edges that part each has all light for itself.
        const std::vector<Vec> a = velocity(*curve.edge), b = velocity(edge);
        constexpr double alike = 1e-6;
        for (std::size_t k = 0; k < n(); ++k)
            if (length(a[k] - b[k]) > alike * (length(a[k]) + length(b[k]))) return false;
        return true;
    };
    return curve.tree->find_near(curve.p, clearance(curve.p, curve.r), is_other).has_value();
}

bool BoundaryScene::contact_velocity(const Curve& curve, Velocities out) const {
    if (!curve.touched || !curve.front) return false;
    Seam line;
    std::vector<Vec> v[2] = {std::vector<Vec>(n()), std::vector<Vec>(n())};
    const Hit* hits[] = {&curve.front, &curve.touched};
    for (std::size_t i = 0; i < 2; ++i) {
        const std::uint32_t shape = hits[i]->shape_idx, primitive = hits[i]->primitive_idx;
        line.faces[i].n = plane_at(scene.shapes[shape], primitive, curve.p).n;
        shape_velocity(shape, primitive, curve.p, v[i]);
    }
    constexpr double least_sine = 1e-3;
    if (length(cross(line.faces[0].n, line.faces[1].n)) < least_sine) return false;
    for (std::size_t k = 0; k < n(); ++k) out[k] = line.velocity(v[0][k], v[1][k]);
    return true;
}

bool BoundaryScene::is_face(const Curve& curve, std::uint32_t shape, std::uint32_t primitive) const {
    if (shape != curve.shape_idx) return false;
    if (!curve.edge) return true;
    const std::span<const std::uint32_t> faces = curve.tree->set().faces_of(*curve.edge);
    return std::find(faces.begin(), faces.end(), primitive) != faces.end();
}

double BoundaryScene::touching_depth(const Curve& curve, std::uint32_t shape, std::uint32_t primitive) const {
    constexpr double flattest = 1.0 / 64;  // sine between ray and surface
    return is_face(curve, shape, primitive) ? 1e-6 * curve.r : clearance(curve.p, curve.r) / flattest;
}

}  // namespace loom::derive
