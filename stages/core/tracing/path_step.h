#pragma once
// One step of a path: from the arrival of its ray to its next ray and its shadow ray. The batch tracer and the replay
// share it.

#include <type_traits>

#include "stages/core/tracing/vertex_rules.h"

namespace loom::tracing {

/// A shadow ray of next-event estimation, and its contribution if it is not occluded.
struct alignas(64) ShadowRequest {
    Ray ray;
    Spectrum contribution;
    LightEdgeRecord edge;  // filled when recording
};

enum class Step : std::uint8_t { ends = 0, goes_on = 1, needs_shadow_ray = 2 };
constexpr bool has(Step step, Step bit) {
    return (std::uint8_t(step) & std::uint8_t(bit)) != 0;
}
constexpr Step operator|(Step a, Step b) {
    return Step(std::uint8_t(a) | std::uint8_t(b));
}

/// Adds the light that the path's ray has hit, weighted against next-event estimation.
/// in:      pdf_nee  density of next-event estimation for the same light point, 0 where it does not sample it
///          at       the light point; null: at infinity
template <bool recording>
void add_arrived_light(PathState& path, PathRecorder record, const Spectrum& Li, float pdf_nee, int emitter,
                       const SurfacePoint* at) {
    path.result.L += light_hit_contribution(path.beta, Li, path.density, pdf_nee);
    if constexpr (recording) {
        LightSample light;
        light.Li = Li;
        light.pdf_w = pdf_nee;
        light.emitter_idx = std::uint16_t(emitter);
        light.at_infinity = at == nullptr;
        // Exactly along the sampled direction from the vertex. The ray started off the surface, so the direction to its
        // hit point differs.
        light.y = at ? path.from + path.ray.d * dot(at->p - path.from, path.ray.d) : Point3f(path.ray.d);
        if (at) light.n = at->ng;
        record.add(
            light_edge(record.last_number(), LightTechnique::bsdf_hit, light, path.density, path.media.medium()));
    }
}

/// Evaluates a light sample at a vertex.
/// in:      here  p, end() and f_cos_pdf() of the vertex
///          q     survival probability of roulette there
/// out:     whether a shadow ray must be traced; then ray and contribution of `shadow` are filled, and
///          pdf_bsdf  density of BSDF sampling, roulette folded in
template <class Vertex>
[[gnu::always_inline]] inline bool ask_light(const Spectrum& beta, const Vertex& here, float q,
                                             const LightSample& light, ShadowRequest& shadow, float& pdf_bsdf) {
    if (!(light.density() > 0)) return false;
    const BsdfValue<float> value = f_cos_pdf(here, light.wi);
    if (is_black(value.f_cos)) return false;
    pdf_bsdf = light.delta ? 0.0f : value.pdf_w * q;
    shadow.contribution = light_sample_contribution(beta, value.f_cos, light.Li, light.density(), pdf_bsdf);
    shadow.ray = light.at_infinity ? spawn_ray(here.end(), light.wi) : spawn_segment(here.end(), light.end());
    return true;
}

/// Samples a light from a vertex of a path, as ask_light().
template <bool recording>
bool sample_next_event(const Scene& scene, const PathState& path, const ShadingPoint& here, SurfaceIdx surface, float q,
                       const LightQuery& lights, ShadowRequest& shadow, std::uint32_t vertex) {
    const LightSample light = sample_light(scene, here.p, lights);
    float pdf_bsdf = 0;
    if (!ask_light(path.beta, here, q, light, shadow, pdf_bsdf)) return false;
    if constexpr (recording)
        shadow.edge = light_edge(vertex, LightTechnique::next_event, light, pdf_bsdf,
                                 medium_towards(path.media, here, surface, light.wi));
    return true;
}

template <bool recording>
Step leave(const Scene& scene, const PathOptions& options, int depth, const ShadingPoint& here, SurfaceIdx surface,
           const LightQuery& lights, Point2f u_direction, PathState& path, ShadowRequest& shadow, PathRecorder record);

/// Ends the path's edge number `depth` at `hit`, or at a miss: adds emission, samples a light and the next direction.
/// in:      lights  looked up for this hit or miss
/// out:     path.ray is the next ray if the path continues; `shadow` is filled if the step needs a shadow ray
template <bool recording>
Step arrive(const Scene& scene, const PathOptions& options, int depth, const Hit& hit, const LightQuery& lights,
            Point2f u_direction, PathState& path, ShadowRequest& shadow, PathRecorder record) {
    const Vector3f wo = -path.ray.d;
    const bool mis = !path.is_first && !is_delta(path.lobe);
    // Beyond the longest path; at its first edge with max_depth 0, which excludes even directly visible emitters.
    const bool dark = options.max_depth >= 0 && depth > options.max_depth;
    if (!hit) {
        const Spectrum Le = dark || hides_sky(scene, path.is_straight) ? Spectrum(0) : lights.Le;
        if (path.is_first) {
            path.result.L = Le;
            if constexpr (recording) record.path().Le = Le;
            return Step::ends;
        }
        if (!is_black(Le))
            add_arrived_light<recording>(path, record, Le, mis ? lights.pdf_w : 0.0f, scene.environment_idx, nullptr);
        else if constexpr (recording)
            record.miss(path.ray.d);
        if constexpr (recording) record.last().end(Ending::escaped);
        return Step::ends;
    }
    const bool last_vertex = options.max_depth >= 0 && depth >= options.max_depth;
    if constexpr (!recording)
        if (last_vertex && !path.is_first && scene.shapes[hit.shape_idx].emitter_idx < 0) {
            ++path.result.n_vertices;  // its position is never used
            return Step::ends;
        }
    const SurfacePoint at = scene.surface(path.ray, hit);
    if (const int emitter = scene.shapes[at.shape_idx].emitter_idx; emitter >= 0) {
        const Spectrum Le = dark ? Spectrum(0) : emitted(scene, at, wo);
        if (path.is_first) {
            path.result.L = Le;
            if constexpr (recording) record.path().Le = Le;
        } else {
            if (!is_black(Le))
                add_arrived_light<recording>(path, record, Le, mis ? pdf_light_w(scene, path.from, at) : 0.0f, emitter,
                                             &at);
            // An emitter that reflects nothing ends the path as a light point.
            if (scene.materials[at.material_idx].black()) {
                if constexpr (recording) {
                    if (is_black(Le)) record.miss(path.ray.d);
                    record.last().end(Ending::hit_emitter);
                }
                return Step::ends;
            }
        }
    }
    if constexpr (recording)
        if (!path.is_first) record.last().flags |= vertex_flag::continued;

    ++path.result.n_vertices;
    const ShadingPoint here = shading_point(scene, at, wo);
    if (path.is_first) path.result.first = first_hit(here, hit.t);
    if constexpr (recording) record.add(scene, at, here, path.media.medium());
    if (last_vertex) {
        if constexpr (recording) record.last().end(Ending::max_depth);
        return Step::ends;
    }
    return leave<recording>(scene, options, depth, here, {at.shape_idx, at.material_idx}, lights, u_direction, path,
                            shadow, record);
}

/// Leaves vertex number `depth` of a path that may continue: samples a light, applies roulette and samples the next
/// direction.
/// in, out: as arrive()
template <bool recording>
[[gnu::always_inline]] inline Step leave(const Scene& scene, const PathOptions& options, int depth,
                                         const ShadingPoint& here, SurfaceIdx surface, const LightQuery& lights,
                                         Point2f u_direction, PathState& path, ShadowRequest& shadow,
                                         PathRecorder record) {
    const float q = survival(roulette_at(options, depth), here, path);
    Step step = Step::ends;
    const bool next_event = !scene.emitters.empty() && has_smooth_lobe(here.bsdf);
    if (next_event && sample_next_event<recording>(scene, path, here, surface, q, lights, shadow,
                                                   recording ? record.last_number() : 0))
        step = Step::needs_shadow_ray;
    else if constexpr (recording)
        if (next_event) record.miss(lights.point.emitter_idx);
    if constexpr (recording) {
        record.last().q = q;
        record.last().flags |= vertex_flag::attempted_bsdf | (next_event ? vertex_flag::attempted_nee : 0);
    }

    if (roulette_ends(q, path.sampler, depth)) {
        if constexpr (recording) record.last().end(Ending::roulette);
        return step;
    }
    const BsdfSample<float> s = draw(here, path.sampler, depth, u_direction);
    const Vector3f wi = here.frame.to_world(s.wi);
    if (s.lobe == Lobe::none || is_black(s.weight)) {
        if constexpr (recording) record.last().end(Ending::invalid_sample);
        return step;
    }
    pass_vertex(path, here.p, *here.bsdf.model, surface, s, q, s.density() * q);
    path.ray = spawn_ray(here.end(), wi);
    if constexpr (recording) {
        record.last().lobe = s.lobe;
        record.last().pdf_w = path.density;
    }
    return step | Step::goes_on;
}

/// Adds the light sample of a step, or records that it is occluded.
template <bool recording>
void end_next_event(PathState& path, const ShadowRequest& shadow, bool blocked, PathRecorder record) {
    if (!blocked) path.result.L += shadow.contribution;
    if constexpr (recording) blocked ? record.miss(shadow.edge) : record.add(shadow.edge);
}

}  // namespace loom::tracing
