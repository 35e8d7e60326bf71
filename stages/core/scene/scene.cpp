#include "stages/core/scene/scene.h"

#include <span>

#include "stages/core/scene/embree.h"

namespace loom {
namespace {

Tangents<float> triangle_tangents(const Shape& shape, const Hit& hit, const Normal3f& ng) {
    const Mesh& mesh = shape.mesh;
    if (mesh.uvs.empty()) return TriangleRecord::any_tangents(ng);
    const std::uint32_t* i = &mesh.indices[3 * std::size_t(hit.primitive_idx)];
    return shape.triangles[hit.primitive_idx].tangents(mesh.uvs[i[0]], mesh.uvs[i[1]], mesh.uvs[i[2]], ng);
}

/// Returns the normal of a normal or bump map, in world space. A normal that faces away from the viewer while the
/// surface does not is mirrored about the surface normal, as in Mitsuba, unless the material disables it.
Normal3f perturbed_normal(const Scene& scene, const Material& m, const Framef& base, const Tangents<float>& tangents,
                          Point2f uv, const Vector3f& wo) {
    Vector3f local;
    if (m.normal_map_idx >= 0) {
        local = mapped_normal(scene.textures[m.normal_map_idx].eval(uv));
    } else {
        const Point2f gradient = scene.textures[m.bump_map_idx].eval_gradient(uv);
        local = bumped_normal(base, tangents, {m.bump_scale * gradient.x, m.bump_scale * gradient.y});
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
    if (!hit || shapes[hit.shape_idx].kind != ShapeKind::mesh) return;
    const Shape& shape = shapes[hit.shape_idx];
    __builtin_prefetch(&shape.triangles[hit.primitive_idx]);
    __builtin_prefetch(&shape.mesh.indices[3 * std::size_t(hit.primitive_idx)]);
}

void Scene::prefetch_corners(const Hit& hit) const {
    if (!hit || shapes[hit.shape_idx].kind != ShapeKind::mesh) return;
    const Mesh& mesh = shapes[hit.shape_idx].mesh;
    const std::uint32_t* i = &mesh.indices[3 * std::size_t(hit.primitive_idx)];
    for (int corner = 0; corner < 3; ++corner) {
        if (!mesh.normals.empty()) __builtin_prefetch(&mesh.normals[i[corner]]);
        if (!mesh.uvs.empty()) __builtin_prefetch(&mesh.uvs[i[corner]]);
    }
}

void Scene::prefetch_texels(const Hit& hit) const {
    if (!hit || shapes[hit.shape_idx].kind != ShapeKind::mesh) return;
    const Shape& shape = shapes[hit.shape_idx];
    const Material& material = materials[shape.material_idx];
    if (material.diffuse_idx >= 0) textures[material.diffuse_idx].prefetch(triangle_point(shape, hit, true).uv);
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
    Vector3f half{round.radius, round.radius, round.radius};
    if (kind == ShapeKind::disk)
        for (int k = 0; k < 3; ++k) half[k] = std::sqrt(sqr(round.u_axis[k]) + sqr(round.v_axis[k]));
    box.add(round.center - half);
    box.add(round.center + half);
    return box;
}

SurfacePoint Scene::surface(const Ray& ray, const Hit& hit) const {
    const Shape& shape = shapes[hit.shape_idx];
    SurfacePoint at;
    at.shape_idx = hit.shape_idx;
    at.primitive_idx = hit.primitive_idx;
    at.hit_error = shape.hit_error;
    at.material_idx = shape.material_idx;
    Tangents<float> tangents;
    const Vector3f wo = -ray.d;
    const Material* material = &materials[shape.material_idx];
    const bool wants_uv = material->needs_uv() || material->back_idx >= 0 || shape.emitter_idx >= 0;
    const bool wants_tangent = features.anisotropic || features.perturbed_normals;

    if (shape.kind == ShapeKind::mesh) {
        const TrianglePoint point = triangle_point(shape, hit, wants_uv);
        at.p = point.p;
        at.uv = point.uv;
        at.ng = at.ns_smooth = point.ng;
        if (length2(point.n) > 0) at.ns_smooth = smooth_normal(point.n, shape.flip_normals ? -1.0f : 1.0f);
        if (wants_tangent) tangents = triangle_tangents(shape, hit, at.ng);
    } else if (shape.kind == ShapeKind::sphere) {
        const Vector3f outward = normalize(ray.o + ray.d * hit.t - shape.round.center);
        at.p = shape.round.sphere_point(outward);
        at.ng = Normal3f(outward);
        at.uv = shape.round.sphere_uv(outward);
        tangents = shape.round.sphere_tangents(outward);
    } else {
        at.p = shape.round.disk_point(hit.u, hit.v);
        at.ng = shape.round.disk_normal();
        at.uv = shape.round.disk_uv(hit.u, hit.v);
        tangents = shape.round.disk_tangents(hit.u, hit.v);
    }
    if (shape.kind != ShapeKind::mesh) at.ng = at.ns_smooth = as_stored(shape.flip_normals ? -at.ng : at.ng);
    if (material->back_idx >= 0 && dot(at.ns_smooth, wo) < 0) {
        at.material_idx = std::uint32_t(material->back_idx);
        material = &materials[at.material_idx];
    }
    Normal3f ns = at.ns_smooth;
    if (material->perturbed()) {
        const Framef base = frame_along(at.ns_smooth, tangents.dp_du);
        ns = as_stored(perturbed_normal(*this, *material, base, tangents, at.uv, wo));
        at.perturbed = true;
    }
    if (features.anisotropic) {
        at.frame = frame_along(ns, as_stored(frame_along(ns, tangents.dp_du).s));
    } else {
        at.frame = Framef(ns);
    }
    return at;
}

Spectrum Scene::diffuse(const Material& m, Point2f uv) const {
    return m.diffuse_idx >= 0 ? as_stored(textures[m.diffuse_idx].eval(uv) * m.reflectance_scale) : m.model.diffuse;
}

Bsdf<float> Scene::bsdf(const SurfacePoint& at) const {
    const Material& m = materials[at.material_idx];
    Bsdf<float> b(m.model);
    if (!m.textured()) return b;
    b.diffuse = diffuse(m, at.uv);
    if (m.specular_idx >= 0) b.specular = as_stored(textures[m.specular_idx].eval(at.uv) * m.reflectance_scale);
    if (m.transmittance_idx >= 0) b.transmittance = as_stored(textures[m.transmittance_idx].eval(at.uv));
    if (m.alpha_u_idx >= 0 || m.alpha_v_idx >= 0) {
        const auto alpha = [&](int texture, float constant) {
            return as_stored(texture >= 0 ? std::max(textures[texture].eval_float(at.uv), smallest_alpha) : constant);
        };
        b.alpha_u = alpha(m.alpha_u_idx, m.model.alpha_u);
        b.alpha_v = alpha(m.alpha_v_idx, m.model.alpha_v);
    }
    if (m.opacity_idx >= 0) b.opacity = as_stored(clamp(textures[m.opacity_idx].eval_float(at.uv), 0.0f, 1.0f));
    if (m.exponent_idx >= 0) b.exponent = std::max(textures[m.exponent_idx].eval_float(at.uv), 0.0f);
    if (m.textured_index()) {
        const auto index = [&](int texture, const Spectrum& constant) {
            return as_stored(texture >= 0 ? textures[texture].eval(at.uv) * m.index_scale : constant);
        };
        b.eta_c = index(m.eta_c_idx, m.model.eta_c);
        b.k_c = index(m.k_c_idx, m.model.k_c);
    }
    return b;
}

}  // namespace loom
