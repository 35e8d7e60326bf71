#pragma once
// Collects paths that have hit plain diffuse surfaces and steps them as a structure of arrays (SoA), with results equal
// to those of the general step, arrive().

#include <array>
#include <vector>

#include "stages/core/tracing/diffuse_columns.h"
#include "stages/core/tracing/path_step.h"

namespace loom::tracing {

class DiffuseBlock {
  public:
    DiffuseBlock(const Scene& scene, const PathOptions& options) : scene_(scene), options_(options) {
        for (const Shape& shape : scene.shapes) {
            const Material& material = scene.materials[shape.material_idx];
            const BsdfModel& model = material.model;
            Surface& surface = surfaces_.emplace_back();
            surface.is_diffuse = model.kind == BsdfKind::diffuse && model.opacity == 1 && material.opacity_idx < 0 &&
                                 material.back_idx < 0 && !material.perturbed() && shape.kind == ShapeKind::mesh &&
                                 shape.emitter_idx < 0 && !scene.features.anisotropic;
            surface.textured = material.diffuse_idx >= 0;
            surface.two_sided = model.two_sided ? 1.0f : 0.0f;
            surface.side = shape.flip_normals ? -1.0f : 1.0f;
            surface.hit_error = shape.hit_error;
            surface.reflectance = model.diffuse;
            surface.vertex.set_surface(std::uint32_t(surfaces_.size() - 1), shape.material_idx, Bsdf<float>(model),
                                       scene.features);
            surface.vertex.flags =
                vertex_flag::attempted_bsdf | (scene.emitters.empty() ? 0 : vertex_flag::attempted_nee);
        }
    }

    std::size_t size() const { return size_; }
    bool full() const { return size_ == DiffuseColumns::capacity; }
    void clear() { size_ = 0; }
    /// Returns the ray index that `add` received for path m of the block.
    std::uint32_t ray(std::size_t m) const { return rays_[m]; }

    /// Adds a path whose ray, with index `ray`, has hit `hit`. Returns false for paths that need arrive(): surfaces
    /// that are not diffuse or that emit, and lights that depend on the surface point.
    bool add(std::uint32_t ray, const Hit& hit, const PathState& path, const LightQuery& lights, Point2f u_direction,
             float u_roulette) {
        if (!hit || !surfaces_[hit.shape_idx].is_diffuse) return false;
        if (!scene_.emitters.empty() && !lights.placed) return false;
        const LightPoint& light = lights.point;
        const Surface& surface = surfaces_[hit.shape_idx];
        const Shape& shape = scene_.shapes[hit.shape_idx];
        const TrianglePoint at = triangle_point(shape, hit, surface.textured);
        DiffuseColumns& c = columns_;
        const std::size_t m = size_++;
        rays_[m] = ray;
        c.p.set(m, at.p);
        c.ng.set(m, at.ng);
        c.hit_error[m] = surface.hit_error;
        c.n.set(m, at.n);
        c.side[m] = length2(at.n) > 0 ? surface.side : 0.0f;
        c.reflectance.set(
            m, surface.textured ? scene_.diffuse(scene_.materials[shape.material_idx], at.uv) : surface.reflectance);
        c.two_sided[m] = surface.two_sided;
        c.wo.set(m, -path.ray.d);
        c.beta.set(m, path.beta);
        c.eta_scale[m] = path.eta_scale;
        c.u_direction_x[m] = u_direction.x;
        c.u_direction_y[m] = u_direction.y;
        c.u_roulette[m] = u_roulette;
        c.light_y.set(m, light.y);
        c.light_n.set(m, light.n);
        c.light_hit_error[m] = light.hit_error;
        c.light_Li.set(m, light.Li);
        c.light_area[m] = light.area;
        c.light_pdf_w[m] = light.pdf_w;
        c.light_pmf[m] = light.pmf;
        c.light_at_infinity[m] = light.at_infinity ? 1.0f : 0.0f;
        emitters_[m] = light.emitter_idx;
        return true;
    }

    void shade(int depth) { shade_diffuse(columns_, size_, roulette_at(options_, depth)); }

    /// Stores the results of shade() for path m of the block, as arrive() does.
    template <bool recording>
    Step finish(std::size_t m, const Hit& hit, PathState& path, ShadowRequest& shadow, PathRecorder record) const {
        const DiffuseColumns& c = columns_;
        ++path.result.n_vertices;
        if (path.is_first) path.result.first = {c.albedo.get<Spectrum>(m), c.ns.get<Normal3f>(m), hit.t};
        if constexpr (recording) record_vertex(m, hit, path, record);
        Step step = Step::ends;
        if (c.needs_shadow_ray(m)) {
            step = Step::needs_shadow_ray;
            shadow.ray = {c.shadow_o.get<Point3f>(m), c.shadow_d.get<Vector3f>(m), 0, c.shadow_t_max[m]};
            shadow.contribution = c.contribution.get<Spectrum>(m);
            if constexpr (recording)
                shadow.edge = light_edge(record.last_number(), LightTechnique::next_event, light(m),
                                         c.shadow_pdf_bsdf_w[m], path.media.medium());
        } else if constexpr (recording) {
            if (!scene_.emitters.empty()) record.miss(emitters_[m]);
        }
        if (c.roulette_ends(m)) {
            if constexpr (recording) record.last().end(Ending::roulette);
            return step;
        }
        if (!c.has_next(m)) {
            if constexpr (recording) record.last().end(Ending::invalid_sample);
            return step;
        }
        path.lobe = Lobe::diffuse;
        path.is_straight = false;
        path.is_first = false;
        path.density = c.next_pdf_w[m];
        path.from = c.p.get<Point3f>(m);
        path.beta = c.next_beta.get<Spectrum>(m);
        path.ray = {c.next_o.get<Point3f>(m), c.next_d.get<Vector3f>(m), 0, INFINITY};
        if constexpr (recording) {
            record.last().lobe = path.lobe;
            record.last().pdf_w = path.density;
        }
        return step | Step::goes_on;
    }

  private:
    /// Properties of a shape that `add` reads, in one record, and the values that all its vertices share.
    struct Surface {
        bool is_diffuse = false, textured = false;
        float two_sided = 0, side = 1, hit_error = 0;
        Spectrum reflectance;
        VertexRecord vertex;
    };

    void record_vertex(std::size_t m, const Hit& hit, const PathState& path, PathRecorder record) const {
        const DiffuseColumns& c = columns_;
        if (!path.is_first) record.last().flags |= vertex_flag::continued;
        VertexRecord& vertex = record.add(surfaces_[hit.shape_idx].vertex);
        const auto ns = c.ns.get<Normal3f>(m);
        vertex.set_arrival(c.p.get<Point3f>(m), c.wo.get<Vector3f>(m), ns, c.ng.get<Normal3f>(m), ns,
                           path.media.medium(), scene_.features);
        if (scene_.features.textured_diffuse) vertex.diffuse = half_color(c.reflectance.get<Spectrum>(m));
        vertex.primitive_idx = hit.primitive_idx;
        vertex.q = c.q[m];
    }

    /// Returns the values of the light edge for the light point of path m.
    LightSample light(std::size_t m) const {
        const DiffuseColumns& c = columns_;
        LightSample light;
        light.Li = c.light_Li.get<Spectrum>(m);
        light.pdf_w = c.shadow_pdf_w[m];
        light.y = c.light_y.get<Point3f>(m);
        light.n = c.light_n.get<Normal3f>(m);
        light.at_infinity = c.light_at_infinity[m] != 0;
        light.emitter_idx = emitters_[m];
        return light;
    }

    const Scene& scene_;
    PathOptions options_;
    std::vector<Surface> surfaces_;  // [shape]
    DiffuseColumns columns_;
    std::array<std::uint32_t, DiffuseColumns::capacity> rays_;
    std::array<std::uint16_t, DiffuseColumns::capacity> emitters_;
    std::size_t size_ = 0;
};

}  // namespace loom::tracing
