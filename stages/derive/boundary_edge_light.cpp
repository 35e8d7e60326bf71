// Family 2: from a point of an emitter, the silhouettes seen from there; behind each the surface on which the shadow
// moves, as the camera sees it.
//   integral of h(film) scale cos_cam f(x_1) Le swept cos_y / r_y^2 over edges and the emitter, r_y = |x_B y|

#include <tbb/enumerable_thread_specific.h>

#include <algorithm>

#include "stages/core/sampling/streams.h"
#include "stages/core/scene/delta_light.h"
#include "stages/core/tracing/vertex_rules.h"
#include "stages/derive/outline.h"

namespace loom::derive {
namespace {

using Vec = Vector3<double>;
using Pt = Point3<double>;

constexpr int n_points = 16;  // silhouette points per light point

class Sampling {
  public:
    Sampling(const BoundaryScene& s, std::uint64_t n, const std::vector<double>& weights)
        : s_(s), n_(n), choice_(weights), outline_(s), v_light_(s.n()), v_surface_(s.n()), rates_(s.n()) {}

    std::uint64_t n_rays = 0;
    std::uint64_t n_listed() const { return outline_.n_found(); }

    void sample(std::uint64_t i, BoundaryRows& rows) {
        const Scene& scene = s_.scene;
        const Sampler sampler = s_.sampler(2, i);
        float u_choice = sampler.pair(0).x;
        const std::size_t emitter_idx = choice_.sample(u_choice);
        const Emitter& e = scene.emitters[emitter_idx];
        const double pmf = double(choice_.pmf(emitter_idx));

        // Place a point on the emitter.
        Light light;
        light.emitter_idx = emitter_idx;
        if (e.kind == EmitterKind::area) {
            sample_area_point(scene, e, sampler.pair(1), light.point);
            light.y = Pt(light.point.y);
            light.density = pmf / double(light.point.area);
        } else {
            light.infinite = e.is_infinite();
            light.y = light.infinite ? Pt(-Vec(e.frame.n)) : Pt(e.position);
            light.density = pmf;
        }
        s_.emitter_velocity(emitter_idx, light.y, v_light_);
        const RayEnd from{Point3f(light.y), light.point.n, light.point.hit_error};
        const Shaft shaft = light.infinite ? Shaft::along(Vector3f(light.y)) : Shaft::to_infinity(from);
        // Seen from the camera, surfaces that move or slide make every edge matter.
        const bool all = s_.tangents.camera_moves() || s_.tangents.any_shape_moves() || s_.emitter_moves(emitter_idx);
        if (!outline_.collect(shaft, light.y, light.infinite, v_light_, s_.film_speed, s_.edges(all), all,
                              sampler.pair(std::uint32_t(2 + n_points)).x))
            return;
        for (int k = 0; k < n_points; ++k) {
            const Point2f u = sampler.pair(std::uint32_t(2 + k));
            OutlinePoint b;
            if (outline_.sample({(float(k) + u.x) / n_points, u.y}, b)) shade(i, light, b, rows);
        }
    }

  private:
    struct Light {
        std::size_t emitter_idx = 0;
        LightPoint point;
        Pt y;  // or the direction towards it
        bool infinite = false;
        double density = 1;
    };

    void shade(std::uint64_t i, const Light& light, const OutlinePoint& b, BoundaryRows& rows) {
        const Scene& scene = s_.scene;
        const Emitter& e = scene.emitters[light.emitter_idx];
        const bool area = e.kind == EmitterKind::area;
        const double cos_light = area ? dot(Vec(light.point.n), b.omega) : 1;
        if (!(cos_light > 0)) return;

        // Go on beside the edge to the surface behind it.
        const double clearance = s_.clearance(b.p, light.infinite ? 0 : b.r);
        const Vec beside = b.out / length(b.out);
        Ray ray;
        double before = b.r;
        if (light.infinite) {
            const Pt start = b.p + beside * clearance;
            ++n_rays;
            if (scene.occluded({Point3f(start), Vector3f(-b.omega), 0, INFINITY})) return;
            ray = {Point3f(start), Vector3f(b.omega), 0, INFINITY};
            before = 0;
        } else {
            const Vector3f d(normalize(b.omega + beside * (clearance / b.r)));
            ray = area ? spawn_ray({Point3f(light.y), light.point.n, light.point.hit_error}, d)
                       : Ray{Point3f(light.y), d, 0, INFINITY};
        }
        const Hit hit = scene.intersect(ray);
        ++n_rays;
        if (!hit || !(double(hit.t) > before)) return;
        const SurfacePoint at = scene.surface(ray, hit);

        // See it from the camera.
        const std::optional<FilmPoint> film = scene.sensor.project(at.p);
        if (!film || !(film->film.x >= -filter_reach() && film->film.x <= float(scene.sensor.width) + filter_reach() &&
                       film->film.y >= -filter_reach() && film->film.y <= float(scene.sensor.height) + filter_reach()))
            return;
        const ShadingPoint here = shading_point(scene, at, -film->d);
        const Vector3f wi(-b.omega);
        const float cos_shading = std::abs(dot(here.frame.n, wi));
        const Spectrum f_cos = f_cos_pdf(here, wi).f_cos;
        if (is_black(f_cos) || !(cos_shading > 0)) return;
        const double cos_camera = std::abs(dot(Vec(at.ng), Vec(film->d)));
        if (!(cos_camera > 0)) return;
        ++n_rays;
        if (scene.occluded(spawn_segment(here.end(), {film->from}))) return;

        // Rate at which light appears.
        const Pt p(at.p), y = light.infinite ? Pt{} : light.y;
        const double r = light.infinite ? 0 : length(p - y);
        s_.film_velocity(at, Pt(film->from), Vec(film->d), v_surface_);
        const double share = light.infinite ? 0 : 1 - b.r / r;  // |x_S x_B| / |x_S x_L|
        bool any = false;
        for (std::size_t q = 0; q < s_.n(); ++q) {
            Vec v = outline_.velocity()[q];
            if (light.infinite) {
                // The direction turns about the surface point.
                v = v - v_surface_[q] - v_light_[q] * length(b.p - p);
                rates_[q] = swept(b.out, v);
            } else {
                rates_[q] = swept(b.out, relative_velocity(share, v, v_surface_[q], v_light_[q]));
            }
            any |= rates_[q] != 0;
        }
        if (!any) return;
        Rgb<double> Le(light.point.Li);
        if (!area)
            Le = Rgb<double>(delta_light(scene, e, EmitterPose<float>(e), at.p).Li) *
                 Rgb<double>(light.infinite ? 1 : r * r);
        const double geometry = light.infinite ? 1 : cos_light / (b.r * b.r);
        const Rgb<double> value = Rgb<double>(f_cos) * Le *
                                  Rgb<double>(film->scale * cos_camera / double(cos_shading) * geometry /
                                              (b.density * light.density * n_points * double(n_)));
        const double eta = index_of_media(at, *film), camera_opl = eta * double(film->t);
        add_to_pixels(film->film, value, light.infinite ? -1 : camera_opl + eta * r, camera_opl, i, rows);
    }

    /// Index of refraction around the camera, in which a surface that the camera sees lies.
    double index_of_media(const SurfacePoint&, const FilmPoint& film) const {
        return double(s_.scene.sensor_media.at(s_.scene, film.from).medium().ior);
    }

    float filter_reach() const { return s_.scene.sensor.filter_radius; }

    void add_to_pixels(Point2f film, const Rgb<double>& value, double opl, double camera_opl, std::uint64_t i,
                       BoundaryRows& rows) {
        for_pixels_at(s_.scene.sensor, film, [&](std::uint64_t pixel, double h) {
            rows.add(pixel, opl, camera_opl, value * Rgb<double>(h), rates_, BoundaryFamily::edge_light, i);
        });
    }

    const BoundaryScene& s_;
    std::uint64_t n_;
    Distribution1 choice_;
    Outline outline_;
    std::vector<Vec> v_light_, v_surface_;
    std::vector<double> rates_;
};

}  // namespace

Effort add_edge_light(const BoundaryScene& s, std::uint64_t n_samples, const std::vector<char>& wanted,
                      std::vector<BoundaryRows>& rows, std::span<std::uint64_t> samples, app::Report& report) {
    std::vector<double> weights;
    for (std::size_t e = 0; e < s.scene.emitters.size(); ++e)
        weights.push_back(wanted[e] ? std::max(double(s.scene.emitter_pmf.pmf(e)), 1e-3) : 0);
    tbb::enumerable_thread_specific<Sampling> workers([&] { return Sampling(s, n_samples, weights); });
    sample_in_chunks(s, n_samples, 256, "silhouettes visible from emitters", workers, rows, report,
                     [](Sampling& worker, BoundaryRows& out, std::uint64_t begin, std::uint64_t end) {
                         for (std::uint64_t k = begin; k < end; ++k) worker.sample(k, out);
                     });
    samples[std::size_t(BoundaryFamily::edge_light)] += n_samples;
    Effort effort{0, n_samples * n_points};
    for (const Sampling& worker : workers) {
        effort.rays += worker.n_rays;
        effort.steps += worker.n_listed() / 8;
    }
    return effort;
}

}  // namespace loom::derive
