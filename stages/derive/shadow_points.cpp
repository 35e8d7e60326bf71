#include "stages/derive/shadow_points.h"

#include <algorithm>

#include "stages/core/scene/delta_light.h"
#include "stages/derive/given_rays.h"

namespace loom::derive {

using Vec = Vector3<double>;
using Pt = Point3<double>;

bool ShadowPoint::rates(ConstVelocities v_surface, std::span<double> out) const {
    const double share = infinite ? 0 : 1 - b.r / r;  // |x_S x_B| / |x_S x_L|
    const double to_edge = infinite ? length(b.p - Pt(at.p)) : 0;
    bool any = false;
    for (std::size_t p = 0; p < out.size(); ++p) {
        // The direction to an emitter at infinity turns about the surface point.
        out[p] = swept(b.out, infinite ? v_edge[p] - v_surface[p] - v_emitter[p] * to_edge
                                       : relative_velocity(share, v_edge[p], v_surface[p], v_emitter[p]));
        any |= out[p] != 0;
    }
    return any;
}

ShadowPoints::ShadowPoints(const BoundaryScene& s, const std::vector<double>& weights, int per_light_point)
    : s_(s), per_light_point_(per_light_point), choice_(weights), outline_(s), v_emitter_(s.n()) {
    for (std::size_t e = 0; e < weights.size(); ++e) emitters_move_ |= weights[e] > 0 && s.emitter_moves(e);
}

void ShadowPoints::sample(const Sampler& sampler, std::span<const double> far_speed, bool all, std::uint64_t pixel,
                          const std::function<void(const ShadowPoint&)>& found) {
    float u_choice = sampler.pair(0).x;
    ShadowPoint point;
    point.emitter_idx = std::uint32_t(choice_.sample(u_choice));
    const Emitter& e = s_.scene.emitters[point.emitter_idx];
    double density = double(choice_.pmf(point.emitter_idx));
    LightPoint light;
    LitSpot spot;
    if (s_.scene.nlos) {
        const NlosCapture& capture = *s_.scene.nlos;
        const bool true_area = options_of(s_.graph, s_.seed).laser_spot == LaserSpot::true_area;
        spot = lit_spot(s_.scene, capture.laser_points[capture.laser_point(pixel)], true_area, sampler.pair(1));
        if (!spot.is_lit) return;
        point.y = Pt(spot.point.p);
        point.laser_r = length(point.y - Pt(e.position));
        // The side that the laser lights.
        const Vec to_laser = Pt(e.position) - point.y;
        light.n = dot(Vec(spot.point.ng), to_laser) < 0 ? -spot.point.ng : spot.point.ng;
        light.hit_error = spot.point.hit_error;
    } else if (e.kind == EmitterKind::area) {
        sample_area_point(s_.scene, e, sampler.pair(1), light);
        point.y = Pt(light.y);
        density /= double(light.area);
    } else {
        point.infinite = e.is_infinite();
        point.y = point.infinite ? Pt(-Vec(e.frame.n)) : Pt(e.position);
    }
    s_.emitter_velocity(point.emitter_idx, point.y, v_emitter_);
    const Shaft shaft = point.infinite ? Shaft::along(Vector3f(point.y))
                                       : Shaft::to_infinity({Point3f(point.y), light.n, light.hit_error});
    if (!outline_.collect(shaft, point.y, point.infinite, v_emitter_, far_speed, s_.edges(all), all, per_light_point_,
                          sampler.pair(std::uint32_t(2 + per_light_point_)).x))
        return;
    point.v_edge = outline_.velocity();
    point.v_emitter = v_emitter_;
    for (int k = 0; k < per_light_point_; ++k) {
        const Point2f u = sampler.pair(std::uint32_t(2 + k));
        if (outline_.sample({(float(k) + u.x) / per_light_point_, u.y}, point.b) &&
            complete(light, s_.scene.nlos ? &spot : nullptr, density, point))
            found(point);
    }
}

bool ShadowPoints::complete(const LightPoint& light, const LitSpot* spot, double density, ShadowPoint& point) {
    const Scene& scene = s_.scene;
    const Emitter& e = scene.emitters[point.emitter_idx];
    const OutlinePoint& b = point.b;
    const bool area = e.kind == EmitterKind::area;
    const double cos_light = area ? dot(Vec(light.n), b.omega) : 1;
    if (!(cos_light > 0)) return false;

    // Go on beside the edge to the surface behind it.
    const double clearance = s_.clearance(b.p, point.infinite ? 0 : b.r);
    const Vec beside = b.out / length(b.out);
    Ray ray;
    double before = b.r;
    if (point.infinite) {
        const Pt start = b.p + beside * clearance;
        ++n_rays;
        if (scene.occluded({Point3f(start), Vector3f(-b.omega), 0, INFINITY})) return false;
        ray = {Point3f(start), Vector3f(b.omega), 0, INFINITY};
        before = 0;
    } else {
        const Vector3f d(normalize(b.omega + beside * (clearance / b.r)));
        ray = area || spot ? spawn_ray({Point3f(point.y), light.n, light.hit_error}, d)
                           : Ray{Point3f(point.y), d, 0, INFINITY};
    }
    const Hit hit = scene.intersect(ray);
    ++n_rays;
    if (!hit || !(double(hit.t) > before)) return false;
    // An edge that lies on the surface ends its view: its shadow is below the occluder.
    if (s_.lies_on(b.p, hit.shape_idx, hit.primitive_idx)) return false;
    point.at = scene.surface(ray, hit);
    const Pt p(point.at.p);
    const double cos_surface = std::abs(dot(Vec(point.at.ng), b.omega));
    if (!(cos_surface > 0)) return false;
    point.r = point.infinite ? 0 : length(p - point.y);
    Rgb<double> intensity(light.Li);
    if (spot) {
        LightSample seen;
        if (!see_spot(scene, *spot, point.at.p, seen)) return false;
        intensity = Rgb<double>(seen.Li) * Rgb<double>(sqr(point.r));
    } else if (!area)
        intensity = Rgb<double>(delta_light(scene, e, EmitterPose<float>(e), point.at.p).Li) *
                    Rgb<double>(point.infinite ? 1 : sqr(point.r));
    const double geometry = point.infinite ? 1 : cos_light / sqr(b.r);
    point.light = intensity * Rgb<double>(geometry / (cos_surface * b.density * density * per_light_point_));
    return !(point.light == Rgb<double>(0));
}

std::vector<double> emitter_weights(const Scene& scene, const std::vector<char>& wanted) {
    std::vector<double> weights;
    for (std::size_t e = 0; e < scene.emitters.size(); ++e)
        weights.push_back(wanted[e] ? std::max(double(scene.emitter_pmf.pmf(e)), 1e-3) : 0);
    return weights;
}

}  // namespace loom::derive
