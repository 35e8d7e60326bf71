#include "stages/core/tracing/nlos_tracer.h"

#include "stages/core/scene/media.h"
#include "stages/core/scene/nlos.h"
#include "stages/core/tracing/path_step.h"

namespace loom {
namespace {

/// Two points of one plane light each other only by rounding, which over their distance squared can be anything.
bool in_one_plane(const Normal3f& n, const Vector3f& d, const Point3f& p) {
    constexpr double flat = 1e-5;
    const double size = std::max({std::abs(p.x), std::abs(p.y), std::abs(p.z)});
    return std::abs(dot(Vector3<double>(n), Vector3<double>(d))) <
           flat * std::max(length(Vector3<double>(d)), flat * size);
}

class NlosPath {
  public:
    NlosPath(const Scene& scene, const PathOptions& options, PathId id)
        : scene_(scene),
          options_(options),
          capture_(*scene.nlos),
          laser_(capture_.laser_points[capture_.laser_point(id.pixel)]),
          projector_(scene.emitters[0]),
          sampler_(options.sampler, options.seed, id.pixel, id.sample),
          media_(scene.sensor_media.everywhere) {
        if (capture_.relay_wall == NlosCapture::no_wall) {
            const std::uint64_t width = scene.sensor.width;
            ray_ = scene.sensor.sample_ray(std::uint32_t(id.pixel % width), std::uint32_t(id.pixel / width),
                                           sampler_.pair(film_pair));
            hit_ = scene.intersect(ray_);
            ++result_.n_rays;
        } else {
            const NlosCapture::Point& seen = capture_.sensor_points[capture_.sensor_point(id.pixel)];
            ray_ = seen.ray;
            hit_ = seen.hit;
        }
        longest_ = options.max_depth < 0 ? no_limit : options.max_depth;
        if (capture_.filter_depth >= 0) longest_ = std::min(longest_, capture_.filter_depth);
    }

    template <bool recording>
    PathResult trace(PathRecorder record) {
        if constexpr (recording) record.path().origin = ray_.o;
        int depth = 1;
        while (hit_ && step<recording>(depth, record)) ++depth;
        return result_;
    }

  private:
    /// The light that a spot sends to a vertex.
    struct Light {
        Vector3f wi;
        Spectrum Li;
        Point3f y;
        Normal3f n;
        RayEnd end;  // of its shadow ray
    };
    static constexpr int no_limit = 1 << 30;

    /// At hit_: takes light, chooses a direction, and traces it. False when the path ends.
    template <bool recording>
    bool step(int depth, PathRecorder record) {
        const SurfacePoint at = scene_.surface(ray_, hit_);
        const ShadingPoint here = shading_point(scene_, at, -ray_.d);
        const BsdfModel& model = *here.bsdf.model;
        ++result_.n_vertices;
        if (depth == 1) result_.first = {albedo(here.bsdf, here.wo_local), here.frame.n, hit_.t};
        if constexpr (recording) {
            VertexRecord& vertex = record.add(VertexRecord{});
            vertex.describe(here, scene_.features);
            vertex.shape = at.shape;
            vertex.material = std::uint16_t(at.material);
            vertex.eta = media_.index();
        }
        const auto end = [&](Ending ending) {
            if constexpr (recording) record.last().end(ending);
            return false;
        };

        const int lit = depth + (capture_.laser_sampling ? 2 : 1);  // edges of a path that is lit here
        const bool smooth = has_smooth_lobe(here.bsdf);
        const bool wanted = lit <= longest_ && (capture_.filter_depth < 0 || lit == capture_.filter_depth) &&
                            !(capture_.discard_direct && lit == 2);
        if (wanted && smooth) {
            if constexpr (recording) record.last().flags |= vertex_flag::attempted_nee;
            add_light<recording>(here, at, depth, record);
        }
        if (lit >= longest_) return end(Ending::max_depth);

        float q = 1;
        if (depth >= options_.rr_depth && options_.roulette != Roulette::off) {
            Spectrum survival = albedo(here.bsdf, here.wo_local);
            if (options_.roulette == Roulette::throughput) survival *= beta_ * eta_scale_;
            q = std::min(max_channel(survival), max_survival);
        }
        if constexpr (recording) {
            record.last().q = q;
            record.last().flags |= vertex_flag::attempted_bsdf;
        }
        if (q < 1 && sampler_.pair(dimension(depth, Place::roulette)).x >= q) return end(Ending::roulette);

        const bool hidden_here = smooth && (capture_.hidden_depth < 0 || depth <= capture_.hidden_depth);
        const float c = hidden_here ? capture_.hidden_probability : 0.0f;
        const Point2f choice = sampler_.pair(dimension(depth, Place::lobe)),
                      u = sampler_.pair(dimension(depth, Place::direction));
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
                       matte = model.kind == BsdfKind::diffuse || model.kind == BsdfKind::rough_diffuse;
            s.lobe = !reflected ? Lobe::glossy_transmission : matte ? Lobe::diffuse : Lobe::glossy_reflection;
            s.eta = s.wi.z > 0 ? model.ext_ior / model.int_ior : model.int_ior / model.ext_ior;
        } else {
            s = sample(here.bsdf, here.wo_local, choice.x, u);
            if (s.lobe == Lobe::none || is_black(s.weight)) return end(Ending::invalid_sample);
            wi = here.frame.to_world(s.wi);
        }
        const bool delta = !aims && is_delta(s.lobe);
        const BsdfValue<float> value = delta ? BsdfValue<float>{} : f_cos_pdf(here, wi);
        if (!delta && is_black(value.f_cos)) return end(Ending::invalid_sample);

        ray_ = spawn_ray(here.end(), wi);
        if (aims) {
            // At the very point, though the ray starts beside the vertex; then as if from the vertex itself. Along wi
            // the points that are met would lie closer together than those that are sampled.
            const Vector3f d = aimed.p - ray_.o;
            hit_ = scene_.intersect({ray_.o, d / length(d)});
            ray_.o = here.p;
            hit_.t = length(aimed.p - here.p);
        } else {
            hit_ = scene_.intersect(ray_);
        }
        ++result_.n_rays;
        if (aims && !seen_first(aimed)) return end(Ending::invalid_sample);
        if (!hit_) return end(Ending::escaped);

        float pdf_w = 0;
        if (delta) {
            if (here.perturbed && s.lobe != Lobe::null) s.weight *= bump_shadowing(here, wi, s.wi.z);
            const float chosen = q * (1 - c);
            pdf_w = s.pdf_w * chosen;
            beta_ *= s.weight * (1 / chosen);
        } else {
            const float p_hidden = c > 0 ? pdf_hidden_w(scene_, here.p, scene_.surface(ray_, hit_)) : 0.0f;
            pdf_w = q * (c * p_hidden + (1 - c) * value.pdf_w);
            if (!(pdf_w > 0)) return end(Ending::invalid_sample);
            beta_ *= value.f_cos * (1 / pdf_w);
        }
        if (s.lobe == Lobe::delta_transmission || s.lobe == Lobe::glossy_transmission) {
            eta_scale_ *= sqr(s.eta);
            if (is_interface(model)) media_.cross(at.shape, s.wi.z < 0, model.int_ior, model.ext_ior);
        }
        if constexpr (recording) {
            record.last().lobe = s.lobe;
            record.last().pdf_w = pdf_w;
            record.last().flags |= vertex_flag::continued;
        }
        return true;
    }

    /// Whether the ray has met the very point that it was aimed at, and nothing before it.
    bool seen_first(const HiddenPoint& aimed) const {
        if (!hit_ || hit_.shape != aimed.element.shape || hit_.primitive != aimed.element.primitive) return false;
        if (scene_.shapes[hit_.shape].kind != ShapeKind::sphere) return true;
        // A ray has two points on a sphere. From outside it meets the front one, from inside the only one ahead.
        const Shape& sphere = scene_.shapes[hit_.shape];
        const bool inside = length2(ray_.o - sphere.center) < sqr(sphere.radius);
        return (dot(aimed.n, ray_.d) < 0) != inside;
    }

    template <bool recording>
    void add_light(const ShadingPoint& here, const SurfacePoint& at, int depth, PathRecorder record) {
        Light light;
        if (!(capture_.laser_sampling ? light_of_spot(here, depth, light) : light_of_projector(here, light))) return;
        const Spectrum f_cos = f_cos_pdf(here, light.wi).f_cos;
        if (is_black(f_cos) || is_black(light.Li)) return;
        ++result_.n_rays;
        if (scene_.occluded(spawn_segment(here.end(), light.end))) return;
        result_.L += beta_ * f_cos * light.Li;
        if constexpr (recording) {
            LightEdgeRecord edge;
            edge.vertex = record.last_number();
            edge.y = light.y;
            edge.n = normal_code(light.n);
            edge.Li = light.Li;
            edge.pdf_nee_w = 1;
            edge.eta = index_towards(media_, here, at.shape, light.wi);
            record.add(edge);
        }
    }

    bool light_of_projector(const ShadingPoint& here, Light& light) const {
        light.Li = projected(scene_, projector_, laser_.beam, here.p);
        if (is_black(light.Li)) return false;
        light.y = projector_.position;
        light.wi = normalize(light.y - here.p);
        light.n = laser_.beam.n;
        light.end = {light.y};
        return true;
    }

    bool light_of_spot(const ShadingPoint& here, int depth, Light& light) {
        if (!laser_.lit) return false;
        NlosCapture::Point spot = laser_;
        Spectrum E;  // times area
        if (options_.laser_spot == LaserSpot::unit_area) {
            E = projected(scene_, projector_, laser_.beam, spot.p);
        } else {
            const Point2f u = sampler_.pair(dimension(depth, Place::light));
            const float x = 2 * u.x - 1, y = 2 * u.y - 1;
            const Vector3f local = normalize(Vector3f{x * projector_.tan_x, y * projector_.tan_y, 1});
            spot = look(scene_, projector_.position, laser_.beam.to_world(local));
            ++result_.n_rays;
            const float cos_surface = std::abs(dot(spot.ng, spot.ray.d));
            if (!spot.hit || !(cos_surface > 0)) return false;
            // Over the beam's section, irradiance times area is constant but for the surface's slant.
            E = beam_radiance(scene_, projector_, x, y) *
                (pi<float> * 4 * projector_.tan_x * projector_.tan_y / cos_surface);
        }
        const Vector3f d = spot.p - here.p;
        if (in_one_plane(spot.flat, d, spot.p)) return false;
        const float r = length(d);
        light.wi = d / r;
        light.y = spot.p;
        spot.hit.t = r;
        const SurfacePoint at = scene_.surface({here.p, light.wi}, spot.hit);
        const ShadingPoint lit = shading_point(scene_, at, -light.wi);
        light.n = at.ng;
        light.end = spot.end();
        const Vector3f to_laser = normalize(projector_.position - spot.p);
        const float cos_l = std::abs(dot(at.ng, light.wi));
        light.Li = f_cos_pdf(lit, to_laser).f_cos * E * (cos_l / (r * r));
        return true;
    }

    const Scene& scene_;
    const PathOptions& options_;
    const NlosCapture& capture_;
    const NlosCapture::LaserPoint& laser_;
    const Emitter& projector_;
    Sampler sampler_;
    MediumStack media_;
    Spectrum beta_{1};
    float eta_scale_ = 1;
    int longest_ = no_limit;
    Ray ray_;
    Hit hit_;
    PathResult result_;
};

}  // namespace

void trace_nlos(const Scene& scene, const PathOptions& options, std::span<const PathId> ids,
                std::span<PathResult> results, PathRecords* records) {
    if (records) records->start(ids.size());
    for (std::size_t i = 0; i < ids.size(); ++i) {
        NlosPath path(scene, options, ids[i]);
        results[i] = records ? path.trace<true>(PathRecorder(*records, std::uint32_t(i))) : path.trace<false>({});
    }
}

}  // namespace loom
