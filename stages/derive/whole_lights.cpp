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

double radius_of(const Shape& round) {
    if (round.kind == ShapeKind::sphere) return double(round.round.radius);
    return std::max(length(Vec(round.round.u_axis)), length(Vec(round.round.v_axis)));
}

/// Surfaces that end at the border of a light, as its case does, do not cut it.
constexpr double touching = 1e-5;  // of its size

/// A flat light, to find what cuts it.
class FlatLight {
  public:
    explicit FlatLight(const std::array<Point3f, 4>& corners)
        : origin_(corners[0]),
          u_(Pt(corners[1]) - origin_),
          v_(Pt(corners[3]) - origin_),
          n_(normalize(cross(u_, v_))) {
        size_ = std::max(length(u_), length(v_));
    }

    bool is_cut_by(const TriangleRecord& t) const {
        const Pt p0(t.p0);
        const Pt corners[3] = {p0, p0 + Vec(t.e1), p0 + Vec(t.e2)};
        double d[3];
        for (int i = 0; i < 3; ++i) d[i] = dot(n_, corners[i] - origin_);
        const double near = touching * size_;
        const auto [low, high] = std::minmax({d[0], d[1], d[2]});
        if (low > near || high < -near) return false;
        // Where the triangle meets the light's plane, in the light's coordinates, [0, 1]^2.
        double low_u = INFINITY, low_v = INFINITY, high_u = -INFINITY, high_v = -INFINITY;
        const auto add = [&](const Pt& p) {
            const Vec at = p - origin_;
            const double uu = length2(u_), uv = dot(u_, v_), vv = length2(v_), det = uu * vv - uv * uv;
            const double pu = dot(at, u_), pv = dot(at, v_);
            const double u = (pu * vv - pv * uv) / det, v = (pv * uu - pu * uv) / det;
            low_u = std::min(low_u, u), high_u = std::max(high_u, u);
            low_v = std::min(low_v, v), high_v = std::max(high_v, v);
        };
        for (int i = 0; i < 3; ++i) {
            const int j = (i + 1) % 3;
            if (std::abs(d[i]) <= near) add(corners[i]);
            if ((d[i] < 0) != (d[j] < 0)) add(corners[i] + (corners[j] - corners[i]) * (d[i] / (d[i] - d[j])));
        }
        return low_u < 1 - touching && high_u > touching && low_v < 1 - touching && high_v > touching;
    }
    bool may_be_cut_by(const Pt& center, double radius) const {
        const Pt middle = origin_ + (u_ + v_) * 0.5;
        return std::abs(dot(n_, center - origin_)) < radius &&
               length(center - middle) < radius + 0.5 * std::max(length(u_ + v_), length(u_ - v_));
    }

  private:
    Pt origin_;
    Vec u_, v_, n_;
    double size_ = 0;
};

/// Whether a triangle may reach into a ball.
bool may_cut(const TriangleRecord& t, const Pt& center, double radius) {
    const double inside = radius * (1 - touching);
    const Pt p0(t.p0);
    const Vec n = cross(Vec(t.e1), Vec(t.e2));
    if (std::abs(dot(n, center - p0)) > inside * length(n)) return false;
    double beyond = 0;  // square of the distance to the triangle's box
    for (int c = 0; c < 3; ++c) {
        const auto [low, high] = std::minmax({0.0, double(t.e1[c]), double(t.e2[c])});
        beyond += sqr(std::max({p0[c] + low - center[c], center[c] - p0[c] - high, 0.0}));
    }
    return beyond < sqr(inside);
}

/// Whether by_round(center, radius) or by_triangle(triangle) holds for any surface but the light.
template <class ByRound, class ByTriangle>
bool any_cuts(const Scene& scene, std::uint32_t light_idx, ByRound&& by_round, ByTriangle&& by_triangle) {
    for (std::uint32_t k = 0; k < scene.shapes.size(); ++k) {
        const Shape& shape = scene.shapes[k];
        if (k == light_idx) continue;
        if (shape.kind != ShapeKind::mesh && by_round(Pt(shape.round.center), radius_of(shape))) return true;
        if (std::any_of(shape.triangles.begin(), shape.triangles.end(), by_triangle)) return true;
    }
    return false;
}

bool is_cut(const Scene& scene, std::uint32_t light_idx) {
    const Shape& light = scene.shapes[light_idx];
    if (light.kind == ShapeKind::sphere) {
        const Pt center(light.round.center);
        const double size = radius_of(light);
        return any_cuts(
            scene, light_idx, [&](const Pt& other, double radius) { return length(other - center) < radius + size; },
            [&](const TriangleRecord& t) { return may_cut(t, center, size); });
    }
    const FlatLight flat(corners_of_flat_light(light));
    return any_cuts(
        scene, light_idx, [&](const Pt& center, double radius) { return flat.may_be_cut_by(center, radius); },
        [&](const TriangleRecord& t) { return flat.is_cut_by(t); });
}

}  // namespace

std::array<Point3f, 4> corners_of_flat_light(const Shape& shape) {
    if (shape.kind == ShapeKind::disk) {
        const auto& round = shape.round;
        return {round.disk_point(-1, -1), round.disk_point(1, -1), round.disk_point(1, 1), round.disk_point(-1, 1)};
    }
    const TriangleRecord& t = shape.triangles[0];
    return {t.p0, t.p0 + t.e1, t.p0 + t.e2, t.p0 + (t.e2 - t.e1)};
}

std::vector<char> usable_lights(const Scene& scene) {
    std::vector<char> usable;
    constexpr std::ptrdiff_t most_rounds = 64;  // all of which each proof looks at
    const bool few_rounds = std::count_if(scene.shapes.begin(), scene.shapes.end(), [](const Shape& shape) {
                                return shape.kind != ShapeKind::mesh;
                            }) <= most_rounds;
    for (const Emitter& e : scene.emitters) {
        // Textures may be black.
        bool is = few_rounds && !scene.nlos && e.kind == EmitterKind::area && e.texture_idx < 0;
        if (is) {
            const Shape& shape = scene.shapes[e.shape_idx];
            is = shape.kind == ShapeKind::mesh ? e.parallelogram : shape.kind == ShapeKind::disk || !shape.flip_normals;
        }
        usable.push_back(is && !is_cut(scene, e.shape_idx));
    }
    return usable;
}

WholeLights::WholeLights(const Scene& scene, const WholeLightOptions& options) : scene_(scene), options_(options) {
    if (!options_.on()) return;
    if (options_.lights.empty()) options_.lights = usable_lights(scene);
    for (std::uint32_t k = 0; k < scene.shapes.size(); ++k) {
        const Shape& shape = scene.shapes[k];
        if (shape.kind == ShapeKind::mesh) continue;
        rounds_.push_back({k, Pt(shape.round.center), radius_of(shape)});
    }
    cells_.emplace(scene, *options_.edges, rounds_);
    corners_.resize(scene.emitters.size());
    for (std::size_t e = 0; e < scene.emitters.size(); ++e) {
        if (!options_.lights[e]) continue;
        const Shape& shape = scene.shapes[scene.emitters[e].shape_idx];
        if (shape.kind != ShapeKind::sphere) corners_[e] = corners_of_flat_light(shape);
    }
}

bool WholeLights::is_seen(const ShadingPoint& at, std::uint32_t shape_idx, std::size_t emitter_idx) {
    const std::uint32_t light_idx = scene_.emitters[emitter_idx].shape_idx;
    const Shape& light = scene_.shapes[light_idx];
    const bool is_flat = light.kind != ShapeKind::sphere;
    const std::array<Point3f, 4>& corners = corners_[emitter_idx];
    // Above the horizons of both normals.
    const Normal3f ng = facing(at.ng, at.wo), ns = facing(at.frame.n, at.wo);
    const auto above = [&](const Point3f& p, float radius) {
        const Vector3f d = p - at.p;
        const float margin = 1e-4f * length(d) + radius;
        return dot(ng, d) > margin && dot(ns, d) > margin;
    };
    if (is_flat) {
        for (const Point3f& corner : corners)
            if (!above(corner, 0)) return false;
    } else if (!above(light.round.center, light.round.radius) ||
               length(light.round.center - at.p) < 1.01f * light.round.radius) {
        return false;
    }
    if (is_flat && cells_->is_clear(at.p, ng, shape_idx, light_idx, corners)) return true;
    const RayEnd from{at.p, ng, at.hit_error};
    const Shaft shaft =
        is_flat ? Shaft::to_polygon(from, corners) : Shaft::to_sphere(from, light.round.center, light.round.radius);
    if (shaft.empty()) return false;
    for (const RoundBounds& round : rounds_)
        if (round.shape_idx != light_idx && may_meet(shaft, round.center, round.radius, Pt(at.p))) return false;
    return options_.edges->collect(shaft, found_, most_visits) <= most_visits && found_.empty();
}

std::span<const WholeLightPoint> WholeLights::points(std::size_t vertex, std::uint32_t shape_idx,
                                                     const ShadingPoint& at, std::size_t emitter_idx, float pdf_bsdf_w,
                                                     const Vector3f& wi) {
    points_.clear();
    if (!options_.lights[emitter_idx] || at.perturbed || !reflects_all(at.bsdf)) return points_;
    const float pdf_of_stored = f_cos_pdf(at, wi).pdf_w;
    if (!(pdf_of_stored > 0) || !is_seen(at, shape_idx, emitter_idx)) return points_;
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
