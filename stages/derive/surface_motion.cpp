#include "stages/derive/surface_motion.h"

#include <algorithm>

namespace loom::derive {

namespace {

using Vec = Vector3<double>;

Vec orthogonal_part(const Vec& v, const Vec& unit) {
    return v - unit * dot(v, unit);
}

}  // namespace

SurfaceMotions::SurfaceMotions(const Scene& scene, const SceneTangents& tangents) : scene_(scene), tangents_(tangents) {
    for (std::size_t s = 0; s < scene.shapes.size(); ++s)
        only_translates_.push_back(tangents.vertices[s].empty() && tangents.shading_normals[s].empty() &&
                                   std::all_of(tangents.shapes[s].begin(), tangents.shapes[s].end(), [](const auto& e) {
                                       return e.effect.linear == std::array<double, 9>{};
                                   }));
}

bool SurfaceMotions::varies(std::uint32_t shape_idx) const {
    const Shape& shape = scene_.shapes[shape_idx];
    const auto textured = [&](std::uint32_t m) { return scene_.materials[m].textured(); };
    const int back = scene_.materials[shape.material_idx].back_idx;
    return !shape.mesh.normals.empty() || shape.kind == ShapeKind::sphere || textured(shape.material_idx) ||
           (back >= 0 && textured(std::uint32_t(back))) ||
           (shape.emitter_idx >= 0 && scene_.emitters[std::size_t(shape.emitter_idx)].texture_idx >= 0);
}

Point2<double> SurfaceMotions::barycentric(const SurfacePlace& at, const Vec& from_corner) const {
    const TriangleRecord& triangle = scene_.shapes[at.shape_idx].triangles[at.primitive_idx];
    const Vec e1(triangle.e1), e2(triangle.e2);
    const double a = length2(e1), b = dot(e1, e2), c = length2(e2);
    const double x = dot(e1, from_corner), y = dot(e2, from_corner), det = a * c - b * b;
    return {(c * x - b * y) / det, (a * y - b * x) / det};
}

SurfaceMotions::Slide SurfaceMotions::normals_along(const SurfacePlace& at, const Vec& slide) const {
    const Shape& shape = scene_.shapes[at.shape_idx];
    if (shape.kind == ShapeKind::sphere) {
        const Vec outward = normalize(at.p - Point3<double>(shape.round.center));
        const Vec change =
            orthogonal_part(slide, outward) * ((dot(outward, at.ng) < 0 ? -1.0 : 1.0) / double(shape.round.radius));
        return {change, change};
    }
    const Mesh& mesh = shape.mesh;
    if (shape.kind != ShapeKind::mesh || mesh.normals.empty()) return {};
    const std::uint32_t* i = &mesh.indices[3 * std::size_t(at.primitive_idx)];
    const Vec n0(mesh.normals[i[0]]), n1(mesh.normals[i[1]]), n2(mesh.normals[i[2]]);
    const Point2<double> b = barycentric(at, at.p - Point3<double>(shape.triangles[at.primitive_idx].p0)),
                         rate = barycentric(at, slide);
    const Vec n = interpolate(n0, n1, n2, b.x, b.y);
    const double len = length(n);
    if (!(len > 0)) return {};
    const Vec unit = n / len, change = (n1 - n0) * rate.x + (n2 - n0) * rate.y;
    return {{}, orthogonal_part(change, unit) * ((dot(unit, at.ns) < 0 ? -1.0 : 1.0) / len)};
}

void SurfaceMotions::add_tilt_of_vertices(const SurfacePlace& at, const Vec& along, std::span<double> tilt) const {
    const Mesh& mesh = scene_.shapes[at.shape_idx].mesh;
    const std::uint32_t* i = &mesh.indices[3 * std::size_t(at.primitive_idx)];
    const Point2<double> b = barycentric(at, along);
    const double rate[3] = {-b.x - b.y, b.x, b.y};
    for (int corner = 0; corner < 3; ++corner)
        for (const auto& [p, v] : tangents_.vertices[at.shape_idx][i[corner]]) tilt[p] += rate[corner] * dot(at.ng, v);
}

SurfaceMotions::UvSlide SurfaceMotions::uv_along(const SurfacePlace& at, const Vec& slide) const {
    const Shape& shape = scene_.shapes[at.shape_idx];
    using D = Dual<1, double>;
    if (shape.kind == ShapeKind::mesh) {
        const Point2<double> b = barycentric(at, at.p - Point3<double>(shape.triangles[at.primitive_idx].p0)),
                             rate = barycentric(at, slide);
        const Mesh& mesh = shape.mesh;
        if (mesh.uvs.empty()) return {{float(b.x), float(b.y)}, rate};
        const std::uint32_t* i = &mesh.indices[3 * std::size_t(at.primitive_idx)];
        const Point2f &t0 = mesh.uvs[i[0]], &t1 = mesh.uvs[i[1]], &t2 = mesh.uvs[i[2]];
        return {interpolate(t0, t1, t2, float(b.x), float(b.y)),
                {double(t1.x - t0.x) * rate.x + double(t2.x - t0.x) * rate.y,
                 double(t1.y - t0.y) * rate.x + double(t2.y - t0.y) * rate.y}};
    }
    const RoundGeometry<float>& round = shape.round;
    const auto moving = [](const Vec& v, const Vec& rate) {
        Vector3<D> m;
        for (int k = 0; k < 3; ++k) m[k] = D(v[k]), m[k].d[0] = rate[k];
        return m;
    };
    RoundGeometry<D> as_dual;
    as_dual.u_axis = Vector3<D>(round.u_axis);
    as_dual.v_axis = Vector3<D>(round.v_axis);
    as_dual.w_axis = Vector3<D>(round.w_axis);
    const Vec from_centre = at.p - Point3<double>(round.center);
    Point2<D> uv;
    if (shape.kind == ShapeKind::sphere) {
        uv = as_dual.sphere_uv(normalize(moving(from_centre, slide)));
    } else {
        const Vec u(round.u_axis), v(round.v_axis);
        const double a = length2(u), b = dot(u, v), c = length2(v), det = a * c - b * b;
        const auto on_disk = [&](const Vec& w) {
            return Point2<double>{(c * dot(u, w) - b * dot(v, w)) / det, (a * dot(v, w) - b * dot(u, w)) / det};
        };
        const Point2<double> xy = on_disk(from_centre), rate = on_disk(slide);
        D x(xy.x), y(xy.y);
        x.d[0] = rate.x, y.d[0] = rate.y;
        uv = as_dual.disk_uv(x, y);
    }
    return {{float(uv.x.value), float(uv.y.value)}, {uv.x.d[0], uv.y.d[0]}};
}

MaterialTangent SurfaceMotions::texture_along(const SurfacePlace& at, std::uint32_t material_idx,
                                              const Vec& slide) const {
    const Material& m = scene_.materials[material_idx];
    MaterialTangent t;
    if (!m.textured()) return t;
    const UvSlide uv = uv_along(at, slide);
    const auto colour = [&](int texture, float scale) {
        Rgb<double> rate;
        if (texture < 0) return rate;
        const auto gradient = scene_.textures[std::size_t(texture)].eval_colour_gradient(uv.uv);
        for (int c = 0; c < 3; ++c)
            rate[c] = double(scale) * (double(gradient.by_u[c]) * uv.rate.x + double(gradient.by_v[c]) * uv.rate.y);
        return rate;
    };
    const auto number = [&](int texture) {
        if (texture < 0) return 0.0;
        const Point2f gradient = scene_.textures[std::size_t(texture)].eval_gradient(uv.uv);
        return double(gradient.x) * uv.rate.x + double(gradient.y) * uv.rate.y;
    };
    t.diffuse = colour(m.diffuse_idx, m.reflectance_scale);
    t.specular = colour(m.specular_idx, m.reflectance_scale);
    t.transmittance = colour(m.transmittance_idx, 1);
    t.alpha_u = number(m.alpha_u_idx);
    t.alpha_v = number(m.alpha_v_idx);
    t.opacity = number(m.opacity_idx);
    t.exponent = number(m.exponent_idx);
    t.eta_c = colour(m.eta_c_idx, m.index_scale);
    t.k_c = colour(m.k_c_idx, m.index_scale);
    return t;
}

Rgb<double> SurfaceMotions::emission_along(const SurfacePlace& at, const Vec& slide) const {
    const Shape& shape = scene_.shapes[at.shape_idx];
    if (shape.emitter_idx < 0) return {};
    const Emitter& emitter = scene_.emitters[std::size_t(shape.emitter_idx)];
    if (emitter.texture_idx < 0) return {};
    const UvSlide uv = uv_along(at, slide);
    const auto gradient = scene_.textures[std::size_t(emitter.texture_idx)].eval_colour_gradient(uv.uv);
    Rgb<double> rate;
    for (int c = 0; c < 3; ++c)
        rate[c] =
            double(emitter.radiance[c]) * (double(gradient.by_u[c]) * uv.rate.x + double(gradient.by_v[c]) * uv.rate.y);
    return rate;
}

}  // namespace loom::derive
