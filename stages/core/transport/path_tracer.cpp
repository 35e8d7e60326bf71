#include "stages/core/transport/path_tracer.h"

#include <type_traits>

#include "stages/core/transport/media.h"

namespace loom {
namespace {

// Pairs of random numbers, by bounce: indexed by place, never by consumption, so that an edit which skips a
// decision leaves all others as they were.
constexpr std::uint32_t film_pair = 0;
constexpr std::uint32_t pairs_per_bounce = 4;
enum Place : std::uint32_t { light_pair = 1, direction_pair = 2, lobe_pair = 3, roulette_pair = 4 };

constexpr std::uint32_t dimension(int depth, Place place) {
    return std::uint32_t(depth - 1) * pairs_per_bounce + place;
}

bool needs_lobe_choice(const Bsdf<float>& b) { return b.model->kind != BsdfKind::diffuse || b.opacity < 1; }

template <bool recording>
PathResult trace(const Scene& scene, const PathOptions& options, std::uint64_t pixel, std::uint64_t sample,
                 PathRecord* record) {
    const Sampler sampler(options.sampler, options.seed, pixel, sample);
    const auto width = scene.sensor.width;
    Ray ray = scene.sensor.sample_ray(std::uint32_t(pixel % width), std::uint32_t(pixel / width),
                                      sampler.pair(film_pair));
    PathResult result;
    if constexpr (recording) {
        record->clear();
        record->origin = ray.o;
    }
    Spectrum beta(1);
    float eta_scale = 1;  // product of squared relative indices: undoes radiance scaling for roulette
    MediumStack media;

    Hit hit = scene.intersect(ray);
    ++result.n_rays;
    if (!hit) {
        result.L = environment(scene, ray.d);
        if constexpr (recording) record->Le = result.L;
        return result;
    }
    SurfacePoint at = scene.surface(ray, hit);
    if (scene.shapes[at.shape].emitter >= 0) {
        result.L = emitted(scene, at, -ray.d);
        if constexpr (recording) record->Le = result.L;
    }
    result.first.n = at.frame.n;
    result.first.depth = hit.t;

    for (int depth = 1;; ++depth) {
        ++result.n_vertices;
        ShadingPoint here;
        here.p = at.p;
        here.wo = -ray.d;
        here.frame = at.frame;
        here.wo_local = at.frame.to_local(here.wo);
        here.ng = at.ng;
        here.n_side = at.ns_smooth;
        here.perturbed = at.perturbed;
        here.bsdf = scene.bsdf(at);
        const BsdfModel& model = *here.bsdf.model;
        if (depth == 1) result.first.albedo = albedo(here.bsdf, here.wo_local);

        // The record of this vertex; nothing at all when nothing is recorded.
        struct Nothing {};
        std::conditional_t<recording, VertexRecord*, Nothing> vertex;
        if constexpr (recording) {
            vertex = &record->vertices.emplace_back();
            vertex->at = here;
            vertex->shape = at.shape;
            vertex->material = std::uint16_t(at.material);
            vertex->eta = media.index();
        }
        auto finish = [&](Ending ending) {
            if constexpr (recording) vertex->ending = ending;
        };

        if (options.max_depth >= 0 && depth >= options.max_depth) {
            finish(Ending::max_depth);
            return result;
        }
        float q = 1;
        if (depth >= options.rr_depth && options.roulette != Roulette::off) {
            Spectrum survival = albedo(here.bsdf, here.wo_local);
            if (options.roulette == Roulette::throughput) survival *= beta * eta_scale;
            q = std::min(max_channel(survival), max_survival);
        }
        if constexpr (recording) vertex->q = q;

        // Next-event estimation.
        if (!scene.emitters.empty() && has_smooth_lobe(here.bsdf)) {
            if constexpr (recording) vertex->attempted_nee = true;
            const LightSample light = sample_light(scene, here.p, sampler.pair(dimension(depth, light_pair)));
            if (light.pdf_w > 0) {
                const BsdfValue<float> value = f_cos_pdf(here, light.wi);
                if (!is_black(value.f_cos)) {
                    const Ray shadow = light.at_infinity ? spawn_ray(here.p, here.ng, light.wi)
                                                         : spawn_segment(here.p, here.ng, light.y);
                    ++result.n_rays;
                    if (!scene.occluded(shadow)) {
                        const float pdf_bsdf = light.delta ? 0.0f : value.pdf_w * q;
                        const float weight = power_heuristic(light.pdf_w, pdf_bsdf);
                        result.L += beta * value.f_cos * light.Li * (weight / light.pdf_w);
                        if constexpr (recording) {
                            LightEdgeRecord edge;
                            edge.vertex = std::uint32_t(record->vertices.size() - 1);
                            edge.y = light.y;
                            edge.at_infinity = light.at_infinity;
                            edge.n = light.n;
                            edge.Li = light.Li;
                            edge.pdf_nee_w = light.pdf_w;
                            edge.pdf_bsdf_w = pdf_bsdf;
                            edge.emitter = light.emitter;
                            const bool crosses = dot(here.n_side, light.wi) * dot(here.n_side, here.wo) < 0;
                            MediumStack beyond = media;
                            if (crosses && scene.features.dielectric)
                                beyond.cross(at.shape, dot(here.n_side, light.wi) < 0, model.int_ior, model.ext_ior);
                            edge.eta = beyond.index();
                            record->light_edges.push_back(edge);
                        }
                    }
                }
            }
        }

        // BSDF sampling.
        if constexpr (recording) vertex->attempted_bsdf = true;
        if (q < 1 && sampler.pair(dimension(depth, roulette_pair)).x >= q) {
            finish(Ending::roulette);
            return result;
        }
        const float u_lobe = needs_lobe_choice(here.bsdf) ? sampler.pair(dimension(depth, lobe_pair)).x : 0.0f;
        BsdfSample<float> s =
            loom::sample(here.bsdf, here.wo_local, u_lobe, sampler.pair(dimension(depth, direction_pair)));
        const Vector3f wi = here.frame.to_world(s.wi);
        if (here.perturbed && s.lobe != Lobe::none && s.lobe != Lobe::null)
            s.weight *= bump_shadowing(here, wi, s.wi.z);
        if (s.lobe == Lobe::none || is_black(s.weight)) {
            finish(Ending::invalid_sample);
            return result;
        }
        if constexpr (recording) {
            vertex->lobe = s.lobe;
            vertex->pdf_w = s.pdf_w * q;
        }
        beta *= s.weight * (1 / q);
        if (s.lobe == Lobe::delta_transmission || s.lobe == Lobe::glossy_transmission) {
            eta_scale *= sqr(s.eta);
            if (scene.features.dielectric && model.kind != BsdfKind::thin_dielectric)
                media.cross(at.shape, s.wi.z < 0, model.int_ior, model.ext_ior);
        }

        ray = spawn_ray(here.p, here.ng, wi);
        hit = scene.intersect(ray);
        ++result.n_rays;
        auto add_light = [&](const Spectrum& Li, float pdf_nee, int emitter, bool at_infinity) {
            if (is_black(Li)) return;
            const float pdf_bsdf = s.pdf_w * q;
            if (is_delta(s.lobe)) pdf_nee = 0;
            result.L += beta * Li * power_heuristic(pdf_bsdf, pdf_nee);
            if constexpr (recording) {
                LightEdgeRecord edge;
                edge.vertex = std::uint32_t(record->vertices.size() - 1);
                edge.technique = LightTechnique::bsdf_hit;
                edge.y = at_infinity ? Point3f(wi) : at.p;
                edge.at_infinity = at_infinity;
                edge.n = at_infinity ? Normal3f{} : at.ng;
                edge.Li = Li;
                edge.pdf_nee_w = pdf_nee;
                edge.pdf_bsdf_w = pdf_bsdf;
                edge.emitter = std::uint16_t(emitter);
                edge.eta = media.index();
                record->light_edges.push_back(edge);
            }
        };
        if (!hit) {
            if (scene.environment >= 0)
                add_light(environment(scene, wi), is_delta(s.lobe) ? 0.0f : pdf_environment_w(scene, wi),
                          scene.environment, true);
            finish(Ending::escaped);
            return result;
        }
        at = scene.surface(ray, hit);
        if (const int emitter = scene.shapes[at.shape].emitter; emitter >= 0) {
            const Spectrum Le = emitted(scene, at, -wi);
            add_light(Le, is_delta(s.lobe) || is_black(Le) ? 0.0f : pdf_light_w(scene, here.p, at), emitter, false);
            // An emitter that reflects nothing ends the path as a light point.
            if (scene.materials[at.material].black()) {
                finish(Ending::hit_emitter);
                return result;
            }
        }
        if constexpr (recording) vertex->continued = true;
    }
}

}  // namespace

PathResult trace_path(const Scene& scene, const PathOptions& options, std::uint64_t pixel, std::uint64_t sample) {
    return trace<false>(scene, options, pixel, sample, nullptr);
}

PathResult trace_path(const Scene& scene, const PathOptions& options, std::uint64_t pixel, std::uint64_t sample,
                      PathRecord& record) {
    return trace<true>(scene, options, pixel, sample, &record);
}

}  // namespace loom
