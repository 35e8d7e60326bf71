#include "stages/core/scene/scene.h"

#include <span>

#include "formats/io/half.h"
#include "stages/core/scene/embree.h"

namespace loom {
namespace {

// The path graph stores normals in 2 x 16 bits and texture-evaluated parameters as halves. The tracer uses
// the rounded values, so that every later stage computes with exactly what the tracer saw.

constexpr float largest_half = 65504;

float half_round(float value) {
    return float_from_half(half_from_float(std::min(value, largest_half)));
}

Spectrum half_round(const Spectrum& s) {
    return {half_round(s.r), half_round(s.g), half_round(s.b)};
}

struct Partials {
    Vector3f dp_du, dp_dv;
};

/// dp/du and dp/dv of a triangle from its texture coordinates; any two tangents where those are degenerate.
Partials triangle_partials(const Mesh& mesh, const std::uint32_t* i, const Normal3f& ng) {
    const Vector3f e1 = mesh.positions[i[1]] - mesh.positions[i[0]], e2 = mesh.positions[i[2]] - mesh.positions[i[0]];
    if (!mesh.uvs.empty()) {
        const Point2f &t0 = mesh.uvs[i[0]], &t1 = mesh.uvs[i[1]], &t2 = mesh.uvs[i[2]];
        const float du1 = t1.x - t0.x, dv1 = t1.y - t0.y, du2 = t2.x - t0.x, dv2 = t2.y - t0.y;
        const float det = du1 * dv2 - dv1 * du2;
        if (det != 0) return {(e1 * dv2 - e2 * dv1) / det, (e2 * du1 - e1 * du2) / det};
    }
    const Framef frame(ng);
    return {frame.s, frame.t};
}

/// Normal that a map asks for, in world space. A normal that turns away from the viewer while the surface
/// does not is mirrored about the surface normal, as Mitsuba does, unless the material forbids it.
Normal3f perturbed_normal(const Scene& scene, const Material& m, const Framef& base, const Partials& d, Point2f uv,
                          const Vector3f& wo) {
    Vector3f local;
    if (m.normal_map >= 0) {
        const Spectrum rgb = scene.textures[m.normal_map].eval(uv);
        local = normalize(Vector3f{2 * rgb.r - 1, 2 * rgb.g - 1, 2 * rgb.b - 1});
    } else {
        const Point2f grad = scene.textures[m.bump_map].eval_gradient(uv);
        const Vector3f n(base.n);
        const Vector3f du = d.dp_du + n * (m.bump_scale * grad.x - dot(n, d.dp_du));
        const Vector3f dv = d.dp_dv + n * (m.bump_scale * grad.y - dot(n, d.dp_dv));
        Vector3f bumped = normalize(cross(du, dv));
        if (dot(bumped, base.n) < 0) bumped = -bumped;
        local = base.to_local(bumped);
    }
    if (m.flips_invalid_normals && dot(base.n, wo) * dot(local, base.to_local(wo)) <= 0)
        local = {-local.x, -local.y, local.z};
    return Normal3f(base.to_world(local));
}

}  // namespace

Hit Scene::intersect(const Ray& ray) const {
    return rays->intersect(ray);
}
Hit Scene::intersect_from_camera(const Ray& ray) const {
    return camera_rays->intersect(ray);
}
bool Scene::occluded(const Ray& ray) const {
    return rays->occluded(ray);
}

void Scene::prefetch_triangle(const Hit& hit) const {
    if (!hit || shapes[hit.shape].kind != ShapeKind::mesh) return;
    const Shape& shape = shapes[hit.shape];
    __builtin_prefetch(&shape.triangles[hit.primitive]);
    __builtin_prefetch(&shape.mesh.indices[3 * std::size_t(hit.primitive)]);
}

void Scene::prefetch_corners(const Hit& hit) const {
    if (!hit || shapes[hit.shape].kind != ShapeKind::mesh) return;
    const Mesh& mesh = shapes[hit.shape].mesh;
    const std::uint32_t* i = &mesh.indices[3 * std::size_t(hit.primitive)];
    for (int corner = 0; corner < 3; ++corner) {
        if (!mesh.normals.empty()) __builtin_prefetch(&mesh.normals[i[corner]]);
        if (!mesh.uvs.empty()) __builtin_prefetch(&mesh.uvs[i[corner]]);
    }
}

void Scene::prefetch_texels(const Hit& hit) const {
    if (!hit || shapes[hit.shape].kind != ShapeKind::mesh) return;
    const Shape& shape = shapes[hit.shape];
    const Material& material = materials[shape.material];
    if (material.diffuse >= 0) textures[material.diffuse].prefetch(triangle_point(shape, hit, true).uv);
}

std::size_t Scene::table_bytes() const {
    std::size_t n = 0;
    for (const Shape& shape : shapes)
        n += std::span(shape.triangles).size_bytes() + std::span(shape.mesh.indices).size_bytes() +
             std::span(shape.mesh.normals).size_bytes() + std::span(shape.mesh.uvs).size_bytes();
    for (const Texture& texture : textures)
        if (texture.image) n += texture.image->bytes.size() + std::span(texture.image->floats).size_bytes();
    return n;
}

Box3f Shape::bounds() const {
    Box3f box;
    for (const Point3f& p : mesh.positions) box.add(p);
    if (kind == ShapeKind::mesh) return box;
    Vector3f half{radius, radius, radius};
    if (kind == ShapeKind::disk)
        for (int k = 0; k < 3; ++k) half[k] = std::sqrt(sqr(u_axis[k]) + sqr(v_axis[k]));
    box.add(center - half);
    box.add(center + half);
    return box;
}

SurfacePoint Scene::surface(const Ray& ray, const Hit& hit) const {
    const Shape& shape = shapes[hit.shape];
    SurfacePoint at;
    at.shape = hit.shape;
    at.primitive = hit.primitive;
    at.hit_error = shape.hit_error;
    at.material = shape.material;
    Partials partials;
    const Vector3f wo = -ray.d;
    const Material* material = &materials[shape.material];
    const bool wants_uv = material->needs_uv() || material->back >= 0 || shape.emitter >= 0;
    const bool wants_tangent = features.anisotropic || features.perturbed_normals;

    if (shape.kind == ShapeKind::mesh) {
        const TrianglePoint point = triangle_point(shape, hit, wants_uv);
        at.p = point.p;
        at.uv = point.uv;
        at.ng = at.ns_smooth = point.ng;
        if (length2(point.n) > 0) at.ns_smooth = smooth_normal(point.n, shape.flip_normals ? -1.0f : 1.0f);
        if (wants_tangent)
            partials = triangle_partials(shape.mesh, &shape.mesh.indices[3 * std::size_t(hit.primitive)], at.ng);
    } else if (shape.kind == ShapeKind::sphere) {
        const Vector3f outward = normalize(ray.o + ray.d * hit.t - shape.center);
        at.p = shape.center + outward * shape.radius;
        at.ng = Normal3f(outward);
        const Vector3f& z = shape.w_axis;
        const float x = dot(outward, shape.u_axis), y = dot(outward, shape.v_axis);
        at.uv = shape.sphere_uv(outward);
        const float rho = std::max(std::sqrt(x * x + y * y), 1e-6f), scale = shape.radius * pi<float>;
        partials.dp_du = (shape.v_axis * x - shape.u_axis * y) * (2 * scale);
        partials.dp_dv = ((shape.u_axis * (x / rho) + shape.v_axis * (y / rho)) * dot(outward, z) - z * rho) * scale;
    } else {
        at.p = shape.center + shape.u_axis * hit.u + shape.v_axis * hit.v;
        at.ng = Normal3f(normalize(cross(shape.u_axis, shape.v_axis)));
        const float r = std::max(std::sqrt(hit.u * hit.u + hit.v * hit.v), 1e-6f);
        const float phi = std::atan2(hit.v, hit.u) * (0.5f * inv_pi<float>);
        at.uv = {r, phi < 0 ? phi + 1 : phi};
        partials.dp_du = (shape.u_axis * hit.u + shape.v_axis * hit.v) / r;
        partials.dp_dv = (shape.v_axis * hit.u - shape.u_axis * hit.v) * (2 * pi<float>);
    }
    if (shape.kind != ShapeKind::mesh)
        at.ng = at.ns_smooth = Normal3f(octahedral_round(Vector3f(shape.flip_normals ? -at.ng : at.ng)));
    if (material->back >= 0 && dot(at.ns_smooth, wo) < 0) {
        at.material = std::uint32_t(material->back);
        material = &materials[at.material];
    }
    Normal3f ns = at.ns_smooth;
    if (material->perturbed()) {
        const Framef base = frame_along(at.ns_smooth, partials.dp_du);
        ns = Normal3f(octahedral_round(Vector3f(perturbed_normal(*this, *material, base, partials, at.uv, wo))));
        at.perturbed = true;
    }
    if (features.anisotropic) {
        at.frame = frame_along(ns, octahedral_round(frame_along(ns, partials.dp_du).s));
    } else {
        at.frame = Framef(ns);
    }
    return at;
}

Spectrum Scene::diffuse(const Material& m, Point2f uv) const {
    return m.diffuse >= 0 ? half_round(textures[m.diffuse].eval(uv) * m.reflectance_scale) : m.model.diffuse;
}

Bsdf<float> Scene::bsdf(const SurfacePoint& at) const {
    const Material& m = materials[at.material];
    Bsdf<float> b(m.model);
    if (!m.textured()) return b;
    b.diffuse = diffuse(m, at.uv);
    if (m.specular >= 0) b.specular = half_round(textures[m.specular].eval(at.uv) * m.reflectance_scale);
    if (m.transmittance >= 0) b.transmittance = half_round(textures[m.transmittance].eval(at.uv));
    if (m.alpha_u >= 0 || m.alpha_v >= 0) {
        const auto alpha = [&](int texture, float constant) {
            return half_round(texture >= 0 ? std::max(textures[texture].eval_float(at.uv), smallest_alpha) : constant);
        };
        b.alpha_u = alpha(m.alpha_u, m.model.alpha_u);
        b.alpha_v = alpha(m.alpha_v, m.model.alpha_v);
    }
    if (m.opacity >= 0) b.opacity = half_round(clamp(textures[m.opacity].eval_float(at.uv), 0.0f, 1.0f));
    if (m.exponent >= 0) b.exponent = std::max(textures[m.exponent].eval_float(at.uv), 0.0f);
    if (m.textured_index()) {
        const auto index = [&](int texture, const Spectrum& constant) {
            return half_round(texture >= 0 ? textures[texture].eval(at.uv) * m.index_scale : constant);
        };
        b.eta_c = index(m.eta_c, m.model.eta_c);
        b.k_c = index(m.k_c, m.model.k_c);
    }
    return b;
}

}  // namespace loom
