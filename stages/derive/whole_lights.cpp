#include "stages/derive/whole_lights.h"

#include <algorithm>
#include <cmath>

#include "stages/core/sampling/streams.h"
#include "stages/core/scene/emitter.h"

namespace loom::derive {
namespace {

using Vec = Vector3<double>;
using Pt = Point3<double>;

/// Whether a BSDF reflects light of every direction above the surface. A lobe that can vanish, or whose tail does so in
/// single precision, leaves edges out.
bool reflects_all(const Bsdf<float>& b) {
    switch (b.model->kind) {
        case BsdfKind::diffuse:
        case BsdfKind::plastic:
        case BsdfKind::rough_plastic:
        case BsdfKind::phong:
            return max_channel(b.diffuse) > 0;
        case BsdfKind::rough_conductor:
            return b.model->distribution == Microfacet::ggx;
        default:
            return false;
    }
}

/// Whether a ball reaches into a shaft, or may do so.
bool may_meet(const Shaft& shaft, const Pt& center, double radius, const Pt& apex) {
    const auto planes = shaft.planes();
    return std::all_of(planes.begin(), planes.end(), [&](const Shaft::Plane& plane) {
        return dot(plane.n, center - apex) + plane.offset >= -radius * length(plane.n);
    });
}

/// Whether a light has one radiance, a convex outline and one that a shaft can have.
bool is_usable(const Scene& scene, const Emitter& e) {
    // Textures may be black.
    if (e.kind != EmitterKind::area || e.texture_idx >= 0) return false;
    const Shape& shape = scene.shapes[e.shape_idx];
    return shape.kind == ShapeKind::disk || (shape.kind == ShapeKind::sphere && !shape.flip_normals) || e.parallelogram;
}

}  // namespace

bool may_see_whole_lights(const Scene& scene) {
    return !scene.nlos && std::any_of(scene.emitters.begin(), scene.emitters.end(),
                                      [&](const Emitter& e) { return is_usable(scene, e); });
}

WholeLights::WholeLights(const Scene& scene, const WholeLightOptions& options) : scene_(scene), options_(options) {
    constexpr std::size_t most_rounds = 64;
    for (std::uint32_t k = 0; k < scene.shapes.size(); ++k) {
        const Shape& shape = scene.shapes[k];
        if (shape.kind == ShapeKind::mesh) continue;
        const double radius = shape.kind == ShapeKind::sphere
                                  ? double(shape.round.radius)
                                  : std::max(length(Vec(shape.round.u_axis)), length(Vec(shape.round.v_axis)));
        rounds_.push_back({Pt(shape.round.center), radius});
        round_shape_.push_back(k);
    }
    for (const Emitter& e : scene.emitters) {
        Outline outline;
        if (options.on() && is_usable(scene, e) && rounds_.size() <= most_rounds) {
            const Shape& shape = scene.shapes[e.shape_idx];
            const auto& round = shape.round;
            if (shape.kind == ShapeKind::disk) {
                outline.corners = {round.disk_point(-1, -1), round.disk_point(1, -1), round.disk_point(1, 1),
                                   round.disk_point(-1, 1)};
                outline.is_flat = true;
            } else if (shape.kind == ShapeKind::mesh) {
                const TriangleRecord& t = shape.triangles[0];
                outline.corners = {t.p0, t.p0 + t.e1, t.p0 + t.e2, t.p0 + (t.e2 - t.e1)};
                outline.is_flat = true;
            }
            outline.is_usable = true;
        }
        outlines_.push_back(outline);
    }
}

bool WholeLights::is_seen(const ShadingPoint& at, std::size_t emitter_idx) {
    const Outline& outline = outlines_[emitter_idx];
    const std::uint32_t shape_idx = scene_.emitters[emitter_idx].shape_idx;
    const Shape& light = scene_.shapes[shape_idx];
    // Above the horizons of both normals.
    const Normal3f ng = facing(at.ng, at.wo), ns = facing(at.frame.n, at.wo);
    const auto above = [&](const Point3f& p, float radius) {
        const Vector3f d = p - at.p;
        const float margin = 1e-4f * length(d) + radius;
        return dot(ng, d) > margin && dot(ns, d) > margin;
    };
    if (outline.is_flat) {
        for (const Point3f& corner : outline.corners)
            if (!above(corner, 0)) return false;
    } else if (!above(light.round.center, light.round.radius) ||
               length(light.round.center - at.p) < 1.01f * light.round.radius) {
        return false;
    }
    const RayEnd from{at.p, ng, at.hit_error};
    const Shaft shaft = outline.is_flat ? Shaft::to_polygon(from, outline.corners)
                                        : Shaft::to_sphere(from, light.round.center, light.round.radius);
    if (shaft.empty()) return false;
    for (std::size_t i = 0; i < rounds_.size(); ++i)
        if (round_shape_[i] != shape_idx && may_meet(shaft, rounds_[i].first, rounds_[i].second, Pt(at.p)))
            return false;
    constexpr std::size_t most_visits = 256;
    return options_.edges->collect(shaft, found_, most_visits) <= most_visits && found_.empty();
}

std::span<const WholeLightPoint> WholeLights::points(std::size_t vertex, const ShadingPoint& at,
                                                     std::size_t emitter_idx, float pdf_bsdf_w, const Vector3f& wi) {
    points_.clear();
    if (!outlines_[emitter_idx].is_usable || at.perturbed || !reflects_all(at.bsdf)) return points_;
    const float pdf_of_stored = f_cos_pdf(at, wi).pdf_w;
    if (!(pdf_of_stored > 0) || !is_seen(at, emitter_idx)) return points_;
    const float survival = pdf_bsdf_w / pdf_of_stored;

    const Emitter& e = scene_.emitters[emitter_idx];
    const int side = options_.points_per_side;
    const Sampler sampler(SamplerKind::independent, options_.seed, vertex, 0);
    LightQuery query;
    query.point.emitter_idx = std::uint16_t(emitter_idx);
    query.point.pmf = scene_.emitters.size() > 1 ? scene_.emitter_pmf.pmf(emitter_idx) : 1.0f;
    for (int k = 0; k < side * side; ++k) {
        const Point2f u = sampler.pair(std::uint32_t(k));
        query.u = {(float(k % side) + u.x) / float(side), (float(k / side) + u.y) / float(side)};
        if (scene_.shapes[e.shape_idx].kind != ShapeKind::sphere) {
            sample_area_point(scene_, e, query.u, query.point);
            query.placed = true;
        }
        const LightSample light = sample_light(scene_, at.p, query);
        WholeLightPoint point;
        point.y = Pt(light.y);
        point.n = Normal3<double>(light.n);
        point.Li = Rgb<double>(light.Li);
        if (light.pdf_w > 0) {
            const float pdf_bsdf = survival * f_cos_pdf(at, light.wi).pdf_w;
            point.weight = double(power_heuristic(light.pdf_w, pdf_bsdf)) / (double(light.pdf_w) * side * side);
        }
        points_.push_back(point);
    }
    return points_;
}

}  // namespace loom::derive
