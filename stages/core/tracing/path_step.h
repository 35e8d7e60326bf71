#pragma once
// One step of a path, shared by the tracer that follows a single path and the one that takes many side by
// side: what happens when a ray has arrived, up to the next ray and the shadow ray that it asks for.

#include <type_traits>

#include "stages/core/scene/media.h"
#include "stages/core/tracing/path_tracer.h"

namespace loom {

// Pairs of random numbers, by bounce: indexed by place, never by consumption, so that an edit which skips a
// decision leaves all others as they were.
inline constexpr std::uint32_t film_pair = 0;
enum class Place : std::uint32_t { light = 1, direction = 2, lobe = 3, roulette = 4 };
constexpr std::uint32_t dimension(int depth, Place place) {
    return std::uint32_t(depth - 1) * 4 + std::uint32_t(place);
}

/// A path under way: the ray that is about to arrive and all that led to it. What every step touches lies in the
/// first cache lines, what only dielectrics touch in the last.
struct alignas(64) PathState {
    Ray ray;
    Spectrum beta{1};     // of the ray: includes the last BSDF sample and roulette
    float eta_scale = 1;  // product of squared relative indices: undoes radiance scaling for roulette
    float pdf_w = 0;      // of the ray's direction, roulette folded in; for a delta lobe its pmf
    Point3f from;         // vertex that it left
    Lobe lobe = Lobe::none;
    bool is_straight = true;  // nothing has scattered it since the camera: see goes_straight_on()
    PathResult result;
    Sampler sampler;
    MediumStack media;

    /// in: u_film  sampler.pair(film_pair)
    PathState(const Scene& scene, const Sampler& numbers, PathId id, Point2f u_film)
        : ray(scene.sensor.sample_ray(std::uint32_t(id.pixel % scene.sensor.width),
                                      std::uint32_t(id.pixel / scene.sensor.width), u_film)),
          sampler(numbers) {
        if (!scene.sensor_media.vacuum) media = scene.sensor_media.at(scene, ray.o);
    }
    /// One that others will say how it began.
    explicit PathState(const Sampler& numbers) : sampler(numbers) {}

    /// Number of the edge that its ray is about to make.
    int depth() const { return int(result.n_vertices) + 1; }
};

/// A lobe that leaves a ray as it was: of a mask, a null surface or a thin pane.
constexpr bool goes_straight_on(Lobe lobe, BsdfKind kind) {
    return lobe == Lobe::null || (lobe == Lobe::delta_transmission && kind == BsdfKind::thin_dielectric);
}

/// Whether a ray that leaves the scene finds the sky black: that of a camera, in a scene that hides its emitters.
inline bool hides_sky(const Scene& scene, bool is_straight) {
    return scene.hides_emitters && is_straight;
}

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

/// Index of the medium from a vertex towards wi. in: media  of the segment that arrives there
inline float index_towards(const MediumStack& media, const ShadingPoint& here, std::uint32_t shape,
                           const Vector3f& wi) {
    const BsdfModel& model = *here.bsdf.model;
    const float side = dot(here.n_side, wi);
    if (!is_interface(model) || side * dot(here.n_side, here.wo) >= 0) return media.index();
    MediumStack beyond = media;
    beyond.cross(shape, side < 0, model.int_ior, model.ext_ior);
    return beyond.index();
}

/// The visibility that next-event estimation waits for, and what it is worth.
struct alignas(64) ShadowRequest {
    Ray ray;
    Spectrum contribution;
    LightEdgeRecord edge;  // filled when recording
};

enum class Step : std::uint8_t { ends = 0, goes_on = 1, asks_shadow = 2 };
constexpr bool has(Step step, Step bit) {
    return (std::uint8_t(step) & std::uint8_t(bit)) != 0;
}
constexpr Step operator|(Step a, Step b) {
    return Step(std::uint8_t(a) | std::uint8_t(b));
}

/// Light found by the ray that has just arrived, weighted against next-event estimation.
/// in: pdf_nee   density of next-event estimation for the same light point, 0 where it has none
template <bool recording>
void add_arrived_light(PathState& path, PathRecorder record, const Spectrum& Li, float pdf_nee, int emitter,
                       bool at_infinity, const SurfacePoint* at) {
    path.result.L += path.beta * Li * power_heuristic(path.pdf_w, pdf_nee);
    if constexpr (recording) {
        LightEdgeRecord edge;
        edge.vertex = record.last_number();
        edge.technique = LightTechnique::bsdf_hit;
        // Along the very direction of the sample from the vertex itself: the ray started off the surface, and the
        // point that it hit lies in a direction that differs by that offset over the distance.
        edge.y = at_infinity ? Point3f(path.ray.d) : path.from + path.ray.d * dot(at->p - path.from, path.ray.d);
        edge.at_infinity = at_infinity;
        edge.n = normal_code(at_infinity ? Normal3f{0, 0, 1} : at->ng);
        edge.Li = Li;
        edge.pdf_nee_w = pdf_nee;
        edge.pdf_bsdf_w = path.pdf_w;
        edge.emitter = std::uint16_t(emitter);
        edge.eta = path.media.index();
        record.add(edge);
    }
}

/// The direction that a path draws at its vertex number `depth`. Its weight has the shadows of bumps in it.
[[gnu::always_inline]] inline BsdfSample<float> draw(const ShadingPoint& here, const Sampler& sampler, int depth,
                                                     Point2f u_direction) {
    const bool one_lobe = here.bsdf.model->kind == BsdfKind::diffuse && here.bsdf.opacity == 1;
    const float u_lobe = one_lobe ? 0.0f : sampler.pair(dimension(depth, Place::lobe)).x;
    BsdfSample<float> s = sample(here.bsdf, here.wo_local, u_lobe, u_direction);
    if (here.perturbed && s.lobe != Lobe::none && s.lobe != Lobe::null)
        s.weight *= bump_shadowing(here, here.frame.to_world(s.wi), s.wi.z);
    return s;
}

/// Next-event estimation from `here`. True when a shadow ray is to decide.
template <bool recording>
bool sample_next_event(const Scene& scene, const PathState& path, const ShadingPoint& here, std::uint32_t shape,
                       float q, const LightQuery& lights, ShadowRequest& shadow, std::uint32_t vertex) {
    const LightSample light = sample_light(scene, here.p, lights);
    if (!(light.pdf_w > 0)) return false;
    const BsdfValue<float> value = f_cos_pdf(here, light.wi);
    if (is_black(value.f_cos)) return false;
    const float pdf_bsdf = light.delta ? 0.0f : value.pdf_w * q;
    const float weight = power_heuristic(light.pdf_w, pdf_bsdf) / light.pdf_w;
    shadow.contribution = path.beta * value.f_cos * light.Li * weight;
    shadow.ray = light.at_infinity ? spawn_ray(here.end(), light.wi) : spawn_segment(here.end(), light.end());
    if constexpr (recording) {
        LightEdgeRecord& edge = shadow.edge;
        edge = {};
        edge.vertex = vertex;
        edge.y = light.y;
        edge.at_infinity = light.at_infinity;
        edge.n = normal_code(light.n == Normal3f{} ? Normal3f{0, 0, 1} : light.n);
        edge.Li = light.Li;
        edge.pdf_nee_w = light.pdf_w;
        edge.pdf_bsdf_w = pdf_bsdf;
        edge.emitter = light.emitter;
        edge.eta = index_towards(path.media, here, shape, light.wi);
    }
    return true;
}

template <bool recording>
Step leave(const Scene& scene, const PathOptions& options, int depth, const ShadingPoint& here, std::uint32_t shape,
           const LightQuery& lights, Point2f u_direction, PathState& path, ShadowRequest& shadow, PathRecorder record);

/// The ray of `path` has met `hit` (or nothing) as its edge number `depth`: adds emission, samples a light and
/// the next direction.
/// in:  lights  answered for this hit or miss
/// out: path.ray is the next ray when the path goes on; shadow is filled when asked for
template <bool recording>
Step arrive(const Scene& scene, const PathOptions& options, int depth, const Hit& hit, const LightQuery& lights,
            Point2f u_direction, PathState& path, ShadowRequest& shadow, PathRecorder record) {
    const Vector3f wo = -path.ray.d;
    const bool mis = depth > 1 && !is_delta(path.lobe);
    const bool dark = options.max_depth == 0;  // not even light that is directly visible
    if (!hit) {
        const Spectrum Le = dark || hides_sky(scene, path.is_straight) ? Spectrum(0) : lights.Le;
        if (depth == 1) {
            path.result.L = Le;
            if constexpr (recording) record.path().Le = Le;
            return Step::ends;
        }
        if (!is_black(Le))
            add_arrived_light<recording>(path, record, Le, mis ? lights.pdf_w : 0.0f, scene.environment, true, nullptr);
        else if constexpr (recording)
            record.miss(path.ray.d);
        if constexpr (recording) record.last().end(Ending::escaped);
        return Step::ends;
    }
    const bool last_vertex = options.max_depth >= 0 && depth >= options.max_depth;
    if constexpr (!recording)
        if (last_vertex && depth > 1 && scene.shapes[hit.shape].emitter < 0) {
            ++path.result.n_vertices;  // where it lies, nobody asks
            return Step::ends;
        }
    const SurfacePoint at = scene.surface(path.ray, hit);
    if (const int emitter = scene.shapes[at.shape].emitter; emitter >= 0) {
        const Spectrum Le = dark ? Spectrum(0) : emitted(scene, at, wo);
        if (depth == 1) {
            path.result.L = Le;
            if constexpr (recording) record.path().Le = Le;
        } else {
            if (!is_black(Le))
                add_arrived_light<recording>(path, record, Le, mis ? pdf_light_w(scene, path.from, at) : 0.0f, emitter,
                                             false, &at);
            // An emitter that reflects nothing ends the path as a light point.
            if (scene.materials[at.material].black()) {
                if constexpr (recording) {
                    if (is_black(Le)) record.miss(path.ray.d);
                    record.last().end(Ending::hit_emitter);
                }
                return Step::ends;
            }
        }
    }
    if constexpr (recording)
        if (depth > 1) record.last().flags |= vertex_flag::continued;

    ++path.result.n_vertices;
    const ShadingPoint here = shading_point(scene, at, wo);
    if (depth == 1) path.result.first = {albedo(here.bsdf, here.wo_local), here.frame.n, hit.t};
    if constexpr (recording) {
        VertexRecord& vertex = record.add(VertexRecord{});
        vertex.describe(here, scene.features);
        vertex.shape = at.shape;
        vertex.material = std::uint16_t(at.material);
        vertex.eta = path.media.index();
    }
    if (last_vertex) {
        if constexpr (recording) record.last().end(Ending::max_depth);
        return Step::ends;
    }
    return leave<recording>(scene, options, depth, here, at.shape, lights, u_direction, path, shadow, record);
}

/// What comes of a path at its vertex number `depth`, not the last that it may have: samples a light, plays roulette
/// and samples the next direction.
/// in, out: as arrive()
template <bool recording>
[[gnu::always_inline]] inline Step leave(const Scene& scene, const PathOptions& options, int depth,
                                         const ShadingPoint& here, std::uint32_t shape, const LightQuery& lights,
                                         Point2f u_direction, PathState& path, ShadowRequest& shadow,
                                         PathRecorder record) {
    const BsdfModel& model = *here.bsdf.model;
    float q = 1;
    if (depth >= options.rr_depth && options.roulette != Roulette::off) {
        Spectrum survival = albedo(here.bsdf, here.wo_local);
        if (options.roulette == Roulette::throughput) survival *= path.beta * path.eta_scale;
        q = std::min(max_channel(survival), max_survival);
    }
    Step step = Step::ends;
    const bool next_event = !scene.emitters.empty() && has_smooth_lobe(here.bsdf);
    if (next_event &&
        sample_next_event<recording>(scene, path, here, shape, q, lights, shadow, recording ? record.last_number() : 0))
        step = Step::asks_shadow;
    else if constexpr (recording)
        if (next_event) record.miss(lights.point.emitter);
    if constexpr (recording) {
        record.last().q = q;
        record.last().flags |= vertex_flag::attempted_bsdf | (next_event ? vertex_flag::attempted_nee : 0);
    }

    if (q < 1 && path.sampler.pair(dimension(depth, Place::roulette)).x >= q) {
        if constexpr (recording) record.last().end(Ending::roulette);
        return step;
    }
    const BsdfSample<float> s = draw(here, path.sampler, depth, u_direction);
    const Vector3f wi = here.frame.to_world(s.wi);
    if (s.lobe == Lobe::none || is_black(s.weight)) {
        if constexpr (recording) record.last().end(Ending::invalid_sample);
        return step;
    }
    path.lobe = s.lobe;
    path.is_straight &= goes_straight_on(s.lobe, model.kind);
    path.pdf_w = s.pdf_w * q;
    path.from = here.p;
    path.beta *= s.weight * (1 / q);
    if (s.lobe == Lobe::delta_transmission || s.lobe == Lobe::glossy_transmission) {
        path.eta_scale *= sqr(s.eta);
        if (is_interface(model)) path.media.cross(shape, s.wi.z < 0, model.int_ior, model.ext_ior);
    }
    path.ray = spawn_ray(here.end(), wi);
    if constexpr (recording) {
        record.last().lobe = s.lobe;
        record.last().pdf_w = path.pdf_w;
    }
    return step | Step::goes_on;
}

/// The shadow ray of a step is answered: the light is seen, or it is not.
template <bool recording>
void end_next_event(PathState& path, const ShadowRequest& shadow, bool blocked, PathRecorder record) {
    if (!blocked) path.result.L += shadow.contribution;
    if constexpr (recording) blocked ? record.miss(shadow.edge) : record.add(shadow.edge);
}

}  // namespace loom
