#include "stages/core/tracing/nlos_tracer.h"

#include <utility>

#include "stages/core/scene/delta_light.h"
#include "stages/core/scene/nlos.h"
#include "stages/core/tracing/vertex_rules.h"

namespace loom {
namespace {

class NlosPath {
  public:
    NlosPath(const Scene& scene, const PathOptions& options, PathId id)
        : NlosPath(scene, options, id.pixel, PathState(Sampler(options.sampler, options.seed, id.pixel, id.sample))) {
        path_.media = scene.sensor_media.everywhere;
        if (capture_.relay_wall == NlosCapture::no_wall) {
            const std::uint64_t width = scene.sensor.width;
            path_.ray = scene.sensor.sample_ray(std::uint32_t(id.pixel % width), std::uint32_t(id.pixel / width),
                                                path_.sampler.pair(film_pair));
            hit_ = scene.intersect(path_.ray);
            ++path_.result.n_rays;
        } else {
            const NlosCapture::Point& seen = capture_.sensor_points[capture_.sensor_point(id.pixel)];
            path_.ray = seen.ray;
            hit_ = seen.hit;
        }
    }
    NlosPath(const Scene& scene, const PathOptions& options, const GivenRay& start)
        : NlosPath(scene, options, start.pixel,
                   PathState(Sampler(options.sampler, options.seed, start.id.pixel, start.id.sample), start)) {
        hit_ = start.hit ? start.hit : scene.intersect(path_.ray);
        ++path_.result.n_rays;
    }

    template <bool recording>
    PathResult trace(PathRecorder record) {
        if constexpr (recording) record.path().origin = path_.ray.o;
        const int first = path_.depth();
        int depth = first;
        while (hit_ && step<recording>(depth, record)) ++depth;
        path_.result.n_vertices -= std::uint32_t(first - 1);
        return path_.result;
    }

  private:
    /// in:      pixel  of the film
    NlosPath(const Scene& scene, const PathOptions& options, std::uint64_t pixel, const PathState& start)
        : scene_(scene),
          options_(options),
          capture_(*scene.nlos),
          laser_(capture_.laser_points[capture_.laser_point(pixel)]),
          projector_(scene.emitters[0]),
          path_(start) {
        longest_ = options.max_depth < 0 ? no_limit : options.max_depth;
        if (capture_.filter_depth >= 0) longest_ = std::min(longest_, capture_.filter_depth);
    }

    /// Light that reaches a vertex from the projector or the laser spot. pmf is 1: the point is not sampled.
    struct Light : LightSample {
        RayEnd end;  // end of its shadow ray
        Light() { pmf = 1; }
    };
    static constexpr int no_limit = 1 << 30;

    /// Adds light at hit_, samples a direction and traces it. Returns false when the path ends.
    template <bool recording>
    bool step(int depth, PathRecorder record) {
        const SurfacePoint at = scene_.surface(path_.ray, hit_);
        const ShadingPoint here = shading_point(scene_, at, -path_.ray.d);
        const BsdfModel& model = *here.bsdf.model;
        ++path_.result.n_vertices;
        if (std::exchange(path_.is_first, false)) path_.result.first = first_hit(here, hit_.t);
        if constexpr (recording) record.add(scene_, at, here, path_.media.medium());
        const auto end = [&](Ending ending) {
            if constexpr (recording) record.last().end(ending);
            return false;
        };

        const int lit = depth + (capture_.laser_sampling ? 2 : 1);  // edges of a path that the laser lights here
        const bool smooth = has_smooth_lobe(here.bsdf);
        const bool wanted = lit <= longest_ && (capture_.filter_depth < 0 || lit == capture_.filter_depth) &&
                            !(capture_.discard_direct && lit == 2);
        if (wanted && smooth) {
            if constexpr (recording) record.last().flags |= vertex_flag::attempted_nee;
            add_light<recording>(here, at, depth, record);
        }
        if (lit >= longest_) return end(Ending::max_depth);

        const float q = survival(roulette_at(options_, depth), here, path_);
        if constexpr (recording) {
            record.last().q = q;
            record.last().flags |= vertex_flag::attempted_bsdf;
        }
        if (roulette_ends(q, path_.sampler, depth)) return end(Ending::roulette);

        const bool hidden_here = smooth && (capture_.hidden_depth < 0 || depth <= capture_.hidden_depth);
        const float c = hidden_here ? capture_.hidden_probability : 0.0f;
        const Point2f choice = path_.sampler.pair(dimension(depth, Dimension::lobe)),
                      u = path_.sampler.pair(dimension(depth, Dimension::direction));
        BsdfSample<float> s;
        Vector3f wi;
        HiddenPoint aimed;
        const bool aims = choice.y < c;
        if (aims) {
            aimed = sample_hidden(scene_, u);
            const Vector3f d = aimed.p - here.p;
            wi = d / length(d);
            s.wi = here.frame.to_local(wi);
            const bool reflected = s.wi.z * here.wo_local.z > 0,
                       diffuse = model.kind == BsdfKind::diffuse || model.kind == BsdfKind::rough_diffuse;
            s.lobe = !reflected ? Lobe::glossy_transmission : diffuse ? Lobe::diffuse : Lobe::glossy_reflection;
            s.eta = s.wi.z > 0 ? model.ext_ior / model.int_ior : model.int_ior / model.ext_ior;
        } else {
            s = sample(here.bsdf, here.wo_local, choice.x, u);
            if (s.lobe == Lobe::none || is_black(s.weight)) return end(Ending::invalid_sample);
            wi = here.frame.to_world(s.wi);
        }
        const bool delta = !aims && is_delta(s.lobe);
        const BsdfValue<float> value = delta ? BsdfValue<float>{} : f_cos_pdf(here, wi);
        if (!delta && is_black(value.f_cos)) return end(Ending::invalid_sample);

        path_.ray = spawn_ray(here.end(), wi);
        if (aims) {
            // Aim at the sampled point from the ray's origin off the surface, then treat the ray as starting at the
            // vertex. Along wi the hit points would lie closer together than the sampled points.
            const Vector3f d = aimed.p - path_.ray.o;
            hit_ = scene_.intersect({path_.ray.o, d / length(d)});
            path_.ray.o = here.p;
            hit_.t = length(aimed.p - here.p);
        } else {
            hit_ = scene_.intersect(path_.ray);
        }
        ++path_.result.n_rays;
        if (aims && !hit_first(aimed)) return end(Ending::invalid_sample);
        if (!hit_) return end(Ending::escaped);

        if (delta) {
            if (here.perturbed && s.lobe != Lobe::null) s.weight *= bump_shadowing(here, wi, s.wi.z);
            const float chosen = q * (1 - c);
            pass_vertex(path_, here.p, model, {at.shape_idx, at.material_idx}, s, chosen, s.pmf * chosen);
        } else {
            const float p_hidden = c > 0 ? pdf_hidden_w(scene_, here.p, scene_.surface(path_.ray, hit_)) : 0.0f;
            const float pdf_w = q * (c * p_hidden + (1 - c) * value.pdf_w);
            if (!(pdf_w > 0)) return end(Ending::invalid_sample);
            s.weight = value.f_cos * (1 / pdf_w);  // roulette included
            pass_vertex(path_, here.p, model, {at.shape_idx, at.material_idx}, s, 1, pdf_w);
        }
        if constexpr (recording) {
            record.last().lobe = s.lobe;
            record.last().pdf_w = path_.density;
            record.last().flags |= vertex_flag::continued;
        }
        return true;
    }

    /// Whether the ray has hit the point at which it was aimed, and nothing before it.
    bool hit_first(const HiddenPoint& aimed) const {
        if (!hit_ || hit_.shape_idx != aimed.element.shape || hit_.primitive_idx != aimed.element.primitive)
            return false;
        if (scene_.shapes[hit_.shape_idx].kind != ShapeKind::sphere) return true;
        // A line hits a sphere twice: from outside the ray hits the front point, from inside the only one ahead.
        const Shape& sphere = scene_.shapes[hit_.shape_idx];
        const bool inside = length2(path_.ray.o - sphere.round.center) < sqr(sphere.round.radius);
        return (dot(aimed.n, path_.ray.d) < 0) != inside;
    }

    template <bool recording>
    void add_light(const ShadingPoint& here, const SurfacePoint& at, int depth, PathRecorder record) {
        Light light;
        if (!(capture_.laser_sampling ? light_of_spot(here, depth, light) : light_of_projector(here, light))) return;
        const Spectrum f_cos = f_cos_pdf(here, light.wi).f_cos;
        if (is_black(f_cos) || is_black(light.Li)) return;
        ++path_.result.n_rays;
        if (scene_.occluded(spawn_segment(here.end(), light.end))) return;
        path_.result.L += path_.beta * f_cos * light.Li;
        if constexpr (recording)
            record.add(light_edge(record.last_number(), LightTechnique::next_event, light, 0,
                                  medium_towards(path_.media, here, {at.shape_idx, at.material_idx}, light.wi)));
    }

    bool light_of_projector(const ShadingPoint& here, Light& light) const {
        light.Li = projected(scene_, projector_, EmitterPose<float>(projector_, laser_.beam), here.p);
        if (is_black(light.Li)) return false;
        light.y = projector_.position;
        light.wi = normalize(light.y - here.p);
        light.n = laser_.beam.n;
        light.end = {light.y};
        return true;
    }

    bool light_of_spot(const ShadingPoint& here, int depth, Light& light) {
        const bool true_area = options_.laser_spot == LaserSpot::true_area;
        path_.result.n_rays += true_area;
        const Point2f u = true_area ? path_.sampler.pair(dimension(depth, Dimension::light)) : Point2f{};
        const LitSpot spot = lit_spot(scene_, laser_, true_area, u);
        if (!spot.is_lit || !see_spot(scene_, spot, here.p, light)) return false;
        light.end = spot.point.end();
        return true;
    }

    const Scene& scene_;
    const PathOptions& options_;
    const NlosCapture& capture_;
    const NlosCapture::LaserPoint& laser_;
    const Emitter& projector_;
    PathState path_;
    int longest_ = no_limit;
    Hit hit_;
};

}  // namespace

template <class Start>
void trace_nlos(const Scene& scene, const PathOptions& options, std::span<const Start> starts,
                std::span<PathResult> results, PathRecords* records) {
    if (records) records->start(starts.size());
    for (std::size_t i = 0; i < starts.size(); ++i) {
        NlosPath path(scene, options, starts[i]);
        results[i] = records ? path.trace<true>(PathRecorder(*records, std::uint32_t(i))) : path.trace<false>({});
    }
}

template void trace_nlos(const Scene&, const PathOptions&, std::span<const PathId>, std::span<PathResult>,
                         PathRecords*);
template void trace_nlos(const Scene&, const PathOptions&, std::span<const GivenRay>, std::span<PathResult>,
                         PathRecords*);

}  // namespace loom
