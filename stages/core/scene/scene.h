#pragma once
// The scene of a path tracer: ray hits, surface points, materials and emitters. Built once by build_scene(), then
// read-only and shared by all threads.

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "stages/core/assets/mesh.h"
#include "stages/core/assets/texture.h"
#include "stages/core/math/box.h"
#include "stages/core/math/frame.h"
#include "stages/core/math/vector.h"
#include "stages/core/scattering/bsdf.h"
#include "stages/core/scene/emitter.h"
#include "stages/core/scene/media.h"
#include "stages/core/scene/ray.h"
#include "stages/core/scene/sensor.h"
#include "stages/core/scene/shading.h"
#include "stages/core/scene/stored_values.h"
#include "stages/core/scene/surface_geometry.h"

namespace loom {

class RayEngine;     // Embree, in embree.cpp
struct NlosCapture;  // nlos.h

/// Result of a ray query.
struct Hit {
    float t = INFINITY;
    float u = 0, v = 0;  // barycentric coordinates on a triangle, (u, v) of an analytic shape
    std::uint32_t shape_idx = no_shape;
    std::uint32_t primitive_idx = 0;

    static constexpr std::uint32_t no_shape = ~0u;
    explicit operator bool() const { return shape_idx != no_shape; }
};

/// A BsdfModel with its textures (index into Scene::textures, -1: the model's constant).
struct Material {
    std::string id;
    int diffuse_idx = -1, specular_idx = -1, transmittance_idx = -1;
    int alpha_u_idx = -1, alpha_v_idx = -1;
    int opacity_idx = -1;
    int exponent_idx = -1;
    int eta_c_idx = -1, k_c_idx = -1;
    float reflectance_scale = 1;  // for textured diffuse and specular: keeps the sum of two lobes below 1
    float index_scale = 1;        // for textured eta_c and k_c: 1 / index outside
    int normal_map_idx = -1, bump_map_idx = -1;
    float bump_scale = 1;
    bool flips_invalid_normals = true;  // see perturbed_normal()
    int back_idx = -1;                  // material of the back; -1: this one
    BsdfModel model;
    bool textured() const {
        return diffuse_idx >= 0 || specular_idx >= 0 || transmittance_idx >= 0 || alpha_u_idx >= 0 ||
               alpha_v_idx >= 0 || opacity_idx >= 0 || exponent_idx >= 0 || textured_index();
    }
    bool textured_index() const { return eta_c_idx >= 0 || k_c_idx >= 0; }
    bool perturbed() const { return normal_map_idx >= 0 || bump_map_idx >= 0; }
    bool needs_uv() const { return textured() || perturbed(); }
    /// Whether it reflects and transmits nothing for any directions: a path ends there.
    bool black() const {
        return model.kind == BsdfKind::diffuse && diffuse_idx < 0 && is_black(model.diffuse) && model.opacity == 1 &&
               opacity_idx < 0;
    }
};

enum class ShapeKind : std::uint8_t { mesh, sphere, disk };

/// A triangle of a mesh in one cache line, instead of four look-ups.
struct TriangleRecord : TriangleGeometry<float> {
    Normal3f ng;  // flipped by Shape::flip_normals; rounded as the path graph stores it
};

struct Shape {
    std::string id;
    ShapeKind kind = ShapeKind::mesh;
    std::uint32_t material_idx = 0;
    int emitter_idx = -1;
    Mesh mesh;                              // world space; empty for analytic shapes
    std::vector<TriangleRecord> triangles;  // [triangle of the mesh]
    RoundGeometry<float> round;             // sphere or disk only
    bool flip_normals = false;
    // m along the normal: how far a hit point may be off the plane that the ray engine tests, due to the size of the
    // shape; surface_offset() adds the share of its distance from the origin
    float hit_error = 0;

    Box3f bounds() const;  // world space
};

/// Computes Shape::hit_error of a shape.
float hit_error(const Shape& shape);

/// A point on a surface, ready for shading. Normals as in Mitsuba: ng has the geometry's own orientation, ns is
/// interpolated; neither is turned towards the viewer.
struct SurfacePoint {
    Point3f p;
    Normal3f ng;
    Normal3f ns_smooth;  // before bump or normal map
    Frame<float> frame;  // of the BSDF
    Point2f uv;
    std::uint32_t shape_idx = 0, primitive_idx = 0, material_idx = 0;
    float hit_error = 0;  // Shape::hit_error
    bool perturbed = false;

    RayEnd end() const { return {p, ng, hit_error}; }
};

/// Lower bound of the roughness of microfacet surfaces.
inline constexpr float smallest_alpha = 1e-4f;

/// Features of a scene; stages enable only what it needs.
struct SceneFeatures {
    bool textured_diffuse = false, textured_specular = false, textured_transmittance = false;
    bool textured_alpha = false, textured_opacity = false;
    bool textured_exponent = false, textured_index = false;
    bool smooth_normals = false;  // shading normal may differ from the geometric one
    bool perturbed_normals = false;
    bool anisotropic = false;
    bool dielectric = false;  // light travels in more than one index of refraction
    bool null_lobes = false;
    bool delta_lobes = false;
};

/// Parameters of a time-resolved film, in optical path lengths (m).
struct TransientFilm {
    std::uint32_t n_bins = 0;  // 0: the film is not time-resolved
    double start_opl = 0, bin_width_opl = 0;
    double sigma_opl = 0;        // standard deviation of a Gaussian temporal filter; 0: box
    bool camera_segment = true;  // lengths count from camera and laser, not from the first hit and to the laser spot
};

struct Scene {
    Sensor sensor;
    TransientFilm transient;
    int max_depth = -1;  // longest path in edges; -1: no limit
    int rr_depth = 5;
    std::vector<Shape> shapes;
    std::vector<Material> materials;
    std::vector<Texture> textures;
    std::vector<Emitter> emitters;
    Distribution1 emitter_pmf;
    int environment_idx = -1;                 // index of the emitter at infinity (environment); -1: none
    std::shared_ptr<const NlosCapture> nlos;  // null unless the scene is an NLOS capture
    SceneFeatures features;
    SensorMedia sensor_media;
    Point3f center;
    float radius = 1;                // bounding sphere of all shapes
    std::uint64_t content_hash = 0;  // hash of the scene file, its overrides and all files that it refers to
    std::vector<std::string> notes;
    std::shared_ptr<const RayEngine> rays;
    // camera rays pass through area lights, and the environment is zero until a path has been scattered
    bool hides_emitters = false;
    std::shared_ptr<const RayEngine> camera_rays;  // shapes that camera rays can hit, when hides_emitters

    Hit intersect(const Ray& ray) const;
    Hit intersect_from_camera(const Ray& ray) const;
    /// Whether any surface, opaque or not, lies in (t_min, t_max). Masks and glass block shadow rays; light through
    /// them is found by BSDF sampling.
    bool occluded(const Ray& ray) const;
    SurfacePoint surface(const Ray& ray, const Hit& hit) const;
    /// Returns the reflectance of the diffuse lobe, as bsdf() does.
    Spectrum diffuse(const Material& material, Point2f uv) const;
    /// Prefetch what surface() and bsdf() read, in three dependent steps. Run each step over a whole batch so that
    /// cache misses overlap.
    void prefetch_triangle(const Hit& hit) const;
    void prefetch_corners(const Hit& hit) const;
    void prefetch_texels(const Hit& hit) const;
    /// Size of the tables that these prefetch; if it is below the size of a cache, prefetching only costs time.
    std::size_t table_bytes() const;
    /// Returns the BSDF with its textures evaluated at a point, parameters rounded as the path graph stores them.
    Bsdf<float> bsdf(const SurfacePoint& at) const;
};

/// A point on a surface as light that leaves along wo sees it.
inline ShadingPoint shading_point(const Scene& scene, const SurfacePoint& at, const Vector3f& wo) {
    ShadingPoint here;
    here.p = at.p;
    here.wo = wo;
    here.frame = at.frame;
    here.wo_local = at.frame.to_local(wo);
    here.ng = at.ng;
    here.hit_error = at.hit_error;
    here.n_side = at.ns_smooth;
    here.perturbed = at.perturbed;
    here.bsdf = scene.bsdf(at);
    return here;
}

/// Hit point on a triangle.
struct TrianglePoint {
    Point3f p;
    Normal3f ng;
    Vector3f n;  // interpolated from the vertices, not of unit length; (0, 0, 0): none, shade with ng
    Point2f uv;
};

inline TrianglePoint triangle_point(const Shape& shape, const Hit& hit, bool wants_uv) {
    const Mesh& mesh = shape.mesh;
    const TriangleRecord& triangle = shape.triangles[hit.primitive_idx];
    const std::uint32_t* i = &mesh.indices[3 * std::size_t(hit.primitive_idx)];
    TrianglePoint at;
    at.p = triangle.point(hit.u, hit.v);
    at.ng = triangle.ng;
    if (!mesh.normals.empty())
        at.n = interpolate(Vector3f(mesh.normals[i[0]]), Vector3f(mesh.normals[i[1]]), Vector3f(mesh.normals[i[2]]),
                           hit.u, hit.v);
    if (wants_uv) {
        at.uv = {hit.u, hit.v};
        if (!mesh.uvs.empty()) at.uv = interpolate(mesh.uvs[i[0]], mesh.uvs[i[1]], mesh.uvs[i[2]], hit.u, hit.v);
    }
    return at;
}

/// Returns the shading normal from the interpolated one, n: unit, negated when `side` is -1, rounded as the path graph
/// stores it.
inline Normal3f smooth_normal(const Vector3f& n, float side) {
    return Normal3f(as_stored(n * (side / std::sqrt(length2(n)))));
}

}  // namespace loom
