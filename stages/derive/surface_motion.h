#pragma once
// Motion of a stored vertex with each parameter: as a material point of its shape, and as a point that slides over it.

#include <algorithm>
#include <array>
#include <cmath>
#include <span>
#include <vector>

#include "stages/core/graph/graph_reader.h"
#include "stages/derive/scene_tangents.h"

namespace loom::derive {

/// One number per parameter, padded to n.
template <int n>
struct Tangent {
    std::array<double, n> d;

    // An empty initialiser becomes an instruction (rep stos) that costs more than the numbers of few parameters.
    constexpr Tangent() {
        for (double& x : d) x = 0;
    }
    Tangent& operator+=(const Tangent& o) {
        for (int p = 0; p < n; ++p) d[p] += o.d[p];
        return *this;
    }
    Tangent& add(double scale, const Tangent& o) {
        for (int p = 0; p < n; ++p) d[p] += scale * o.d[p];
        return *this;
    }
    bool is_zero() const {
        for (const double x : d)
            if (x != 0) return false;
        return true;
    }
};

/// A vector per parameter.
template <int n>
struct VectorTangent {
    Tangent<n> x, y, z;

    Tangent<n>& operator[](int k) { return k == 0 ? x : k == 1 ? y : z; }
    const Tangent<n>& operator[](int k) const { return k == 0 ? x : k == 1 ? y : z; }
    void add(int p, const Vector3<double>& v) { x.d[p] += v.x, y.d[p] += v.y, z.d[p] += v.z; }
    VectorTangent& add(double scale, const VectorTangent& o) {
        x.add(scale, o.x), y.add(scale, o.y), z.add(scale, o.z);
        return *this;
    }
    Vector3<double> operator()(int p) const { return {x.d[p], y.d[p], z.d[p]}; }
    bool is_zero() const { return x.is_zero() && y.is_zero() && z.is_zero(); }
    /// Adds v times a number per parameter.
    VectorTangent& add(const Vector3<double>& v, const Tangent<n>& by) {
        x.add(v.x, by), y.add(v.y, by), z.add(v.z, by);
        return *this;
    }
};

template <int n>
Tangent<n> dot(const Vector3<double>& v, const VectorTangent<n>& t) {
    Tangent<n> sum;
    for (int p = 0; p < n; ++p) sum.d[p] = v.x * t.x.d[p] + v.y * t.y.d[p] + v.z * t.z.d[p];
    return sum;
}

/// Changes of a surface point and its normals.
template <int n>
struct PointMotion {
    VectorTangent<n> p;       // m
    VectorTangent<n> ng, ns;  // of the geometric and the shading normal
    Tangent<n> twist;         // turn of the shading frame about its normal, rad
    Tangent<n> area;          // relative growth of the area around a material point
};

/// A point of a shape, as the graph or the scene gives it.
struct SurfacePlace {
    std::uint32_t shape_idx = 0, primitive_idx = 0;
    Point3<double> p;
    Vector3<double> ng, ns, tangent;  // unit
};

/// Whether a surface has a lobe without width besides masks: vertices on it keep the direction that leads to them.
inline bool has_delta_lobe(BsdfKind kind) {
    return kind == BsdfKind::conductor || kind == BsdfKind::dielectric || kind == BsdfKind::thin_dielectric ||
           kind == BsdfKind::plastic;
}

/// How far the end of a scattered ray keeps its direction, and from where on its place on the surface. Any smooth choice
/// gives the same sum of interior and boundary. Near its start a vertex must keep the direction, or the variance has no
/// bound where surfaces meet; far from it the place, or it slides far at grazing angles.
///   v = V + w(r) (v_ray - V),  w = 1 / (1 + (r / reach)^2)
struct Attached {
    std::vector<double> reach;  // [shape], m; 0: all to the surface, infinite: all to the ray. Empty: 0 for all

    static double share_of(double reach, double r) { return reach > 0 ? 1 / (1 + sqr(r / reach)) : 0; }
    double share(std::uint32_t shape, double r) const { return reach.empty() ? 0 : share_of(reach[shape], r); }
    /// dw/dr
    double slope(std::uint32_t shape, double r) const {
        return slides(shape) ? -2 * r / sqr(reach[shape]) * sqr(share(shape, r)) : 0;
    }
    bool slides(std::uint32_t shape) const { return !reach.empty() && reach[shape] > 0; }
    /// Whether points of any surface keep more than their places, and whether of all they keep their directions alone.
    bool any_slides() const {
        return std::any_of(reach.begin(), reach.end(), [](double r) { return r > 0; });
    }
    bool all_to_rays() const {
        return !reach.empty() && std::all_of(reach.begin(), reach.end(), [](double r) { return std::isinf(r); });
    }
};

/// Evaluates motions of points of a scene. Borrows both arguments.
class SurfaceMotions {
  public:
    SurfaceMotions(const Scene& scene, const SceneTangents& tangents);

    /// Whether a shape moves by translations alone, or stays.
    bool only_translates(std::uint32_t shape) const { return only_translates_[shape]; }

    /// Adds the motion of a material point.
    template <int n>
    void add_material(const SurfacePlace& at, PointMotion<n>& motion) const {
        if (only_translates_[at.shape_idx]) {
            for (const auto& [p, v] : tangents_.shapes[at.shape_idx]) motion.p.add(int(p), v.offset);
        } else {
            add_general(at, motion);
        }
    }

    /// Change of the shading normal, and of the geometric one of a sphere, per metre along `slide`; zero on flat faces.
    struct Slide {
        Vector3<double> ng, ns;
    };
    Slide normals_along(const SurfacePlace& at, const Vector3<double>& slide) const;
    /// Change of textured BSDF parameters along `slide`.
    MaterialTangent texture_along(const SurfacePlace& at, std::uint32_t material, const Vector3<double>& slide) const;
    /// Change of a textured emission, as a factor on radiance.
    Rgb<double> emission_along(const SurfacePlace& at, const Vector3<double>& slide) const;

    /// Texture coordinates of a point.
    Point2f uv_of(const SurfacePlace& at) const { return uv_along(at, {}).uv; }

    /// Adds n . (gradient of the velocity of the surface along the part of d in its tangent plane).
    template <int n>
    void add_tilt(const SurfacePlace& at, const Vector3<double>& d, Tangent<n>& tilt) const {
        if (only_translates_[at.shape_idx]) return;
        const Vector3<double> along = d - at.ng * loom::dot(at.ng, d);
        for (const auto& [p, v] : tangents_.shapes[at.shape_idx]) tilt.d[p] += loom::dot(at.ng, v.turned(along));
        if (!tangents_.vertices[at.shape_idx].empty()) add_tilt_of_vertices(at, along, tilt.d);
    }
    /// Divergence over the surface of the slip T = v_ray - V between the end of a turning ray and the material point:
    ///   T = -c + d (n . c) / (n . d),  c = V - v_a - turn x d
    /// in:      growth  of the area around the material point
    ///          tilt    of add_tilt()
    ///          d       from the start of the ray;  c  its value here
    double slip_growth(const SurfacePlace& at, double growth, double tilt, const Vector3<double>& d,
                       const Vector3<double>& c, const Vector3<double>& turn) const {
        // The turn has no divergence over a plane.
        const Vector3<double>& n = at.ng;
        const double h = loom::dot(n, d), n_c = loom::dot(n, c);
        const Vector3<double> along = d - n * h;
        const double flat = -growth + (2 * n_c + tilt - loom::dot(n, cross(turn, along))) / h;
        const Shape& shape = scene_.shapes[at.shape_idx];
        if (shape.kind != ShapeKind::sphere) return flat;
        // The normal turns along the sphere.
        const double curvature =
            (loom::dot(n, at.p - Point3<double>(shape.round.center)) < 0 ? -1.0 : 1.0) / double(shape.round.radius);
        return flat + curvature * (loom::dot(along, c) / h - n_c * length2(along) / (h * h));
    }

    /// Whether shading changes when a point slides over a shape, so that its primitive must be known.
    bool varies(std::uint32_t shape) const;

    /// Barycentric coordinates (u, v) of a point on a triangle.
    Point2<double> barycentric_of(std::uint32_t shape, std::uint32_t primitive, const Point3<double>& p) const {
        SurfacePlace at;
        at.shape_idx = shape, at.primitive_idx = primitive;
        return barycentric(at, p - Point3<double>(scene_.shapes[shape].triangles[primitive].p0));
    }

    /// Their change along a vector in the plane of the triangle.
    Point2<double> barycentric_of_vector(std::uint32_t shape, std::uint32_t primitive, const Vector3<double>& v) const {
        SurfacePlace at;
        at.shape_idx = shape, at.primitive_idx = primitive;
        return barycentric(at, v);
    }

    const Scene& scene() const { return scene_; }
    const SceneTangents& tangents() const { return tangents_; }

  private:
    /// add_material() of motions that are not only translations.
    template <int n>
    void add_general(const SurfacePlace& at, PointMotion<n>& motion) const {
        for (const auto& [p, v] : tangents_.shapes[at.shape_idx]) {
            const int k = int(p);
            motion.p.add(k, v.at(at.p));
            motion.ng.add(k, v.of_normal(at.ng));
            motion.ns.add(k, v.of_normal(at.ns));
            motion.twist.d[p] += twist(at, v);
            motion.area.d[p] += v.area_growth(at.ng);
        }
        if (!tangents_.vertices[at.shape_idx].empty()) add_vertices(at, motion);
        for (const auto& [p, v] : tangents_.shading_normals[at.shape_idx]) {
            motion.ns.add(int(p), v.of_normal(at.ns));
            motion.twist.d[p] += twist(at, v);
        }
    }
    static double twist(const SurfacePlace& at, const AffineVelocity& v) {
        return loom::dot(cross(at.ns, at.tangent), v.turned(at.tangent));
    }
    /// Barycentric coordinates (u, v) of a vector from the first corner, or of a vector in the plane of the triangle.
    Point2<double> barycentric(const SurfacePlace& at, const Vector3<double>& from_corner) const;
    /// add_tilt() of parameters that move single vertices.
    /// in:      along  in the plane of the triangle
    void add_tilt_of_vertices(const SurfacePlace& at, const Vector3<double>& along, std::span<double> tilt) const;
    /// Texture coordinates per metre along `slide`, and those of the point.
    struct UvSlide {
        Point2f uv;
        Point2<double> rate;
    };
    UvSlide uv_along(const SurfacePlace& at, const Vector3<double>& slide) const;

    template <int n>
    void add_vertices(const SurfacePlace& at, PointMotion<n>& motion) const {
        const Mesh& mesh = scene_.shapes[at.shape_idx].mesh;
        const std::uint32_t* i = &mesh.indices[3 * std::size_t(at.primitive_idx)];
        const Point3<double> p0(mesh.positions[i[0]]), p1(mesh.positions[i[1]]), p2(mesh.positions[i[2]]);
        const Vector3<double> e1 = p1 - p0, e2 = p2 - p0, twice = cross(e1, e2);
        const double area = length(twice);
        const Vector3<double> normal = twice / area;
        const double side = loom::dot(normal, at.ng) < 0 ? -1 : 1;
        const Point2<double> b = barycentric(at, at.p - p0);
        const double weight[3] = {1 - b.x - b.y, b.x, b.y};
        const bool flat = mesh.normals.empty();
        for (int corner = 0; corner < 3; ++corner)
            for (const auto& [p, v] : tangents_.vertices[at.shape_idx][i[corner]]) {
                const int k = int(p);
                motion.p.add(k, v * weight[corner]);
                const Vector3<double> d = corner == 0 ? cross(v, e1 - e2) : corner == 1 ? cross(v, e2) : cross(e1, v);
                const Vector3<double> ng = (d - normal * loom::dot(normal, d)) * (side / area);
                motion.ng.add(k, ng);
                // Vertex normals of a file stay.
                if (flat) motion.ns.add(k, ng);
                motion.area.d[p] += loom::dot(normal, d) / area;
            }
    }

    const Scene& scene_;
    const SceneTangents& tangents_;
    std::vector<char> only_translates_;  // [shape]: no motion but translations, or none
};

}  // namespace loom::derive
