#pragma once
// Rules of transport at one vertex of a path. Every walker calls them: the batch and its structure-of-arrays twin, the
// replay, NLOS captures, and what loom-residual traces, finds or resumes.

#include "stages/core/scene/scene.h"
#include "stages/core/tracing/path_state.h"

namespace loom {

/// Roulette that applies at vertex number `depth` of a path, from 1.
constexpr Roulette roulette_at(const PathOptions& options, int depth) {
    return depth >= options.rr_depth ? options.roulette : Roulette::off;
}

/// Survival probability of Russian roulette.
/// in:  throughput  with Roulette::throughput that of the path times its eta_scale, else 1
inline float survival(const Spectrum& albedo, const Spectrum& throughput = Spectrum(1)) {
    return std::min(max_channel(albedo * throughput), max_survival);
}

/// Survival probability by the albedo alone, which can be evaluated from either end of a path.
inline float survival(const ShadingPoint& here) {
    return survival(albedo(here.bsdf, here.wo_local));
}

/// Survival probability of a path at a vertex; 1 without roulette.
inline float survival(Roulette roulette, const ShadingPoint& here, const PathState& path) {
    switch (roulette) {
        case Roulette::off:
            return 1;
        case Roulette::albedo:
            return survival(here);
        case Roulette::throughput:
            return survival(albedo(here.bsdf, here.wo_local), path.beta * path.eta_scale);
    }
    return 1;
}

/// Whether roulette ends a path at its vertex number `depth`.
/// in:  q  survival probability
inline bool roulette_ends(float q, const Sampler& sampler, int depth) {
    return q < 1 && sampler.pair(dimension(depth, Dimension::roulette)).x >= q;
}

/// False for a BSDF of one lobe, whose sample() ignores u_lobe.
inline bool needs_lobe_sample(const Bsdf<float>& bsdf) {
    return bsdf.model->kind != BsdfKind::diffuse || bsdf.opacity != 1;
}

/// BSDF sample of a path at its vertex number `depth`, without the shadowing of bumps.
[[gnu::always_inline]] inline BsdfSample<float> draw_unshadowed(const ShadingPoint& here, const Sampler& sampler,
                                                                int depth, Point2f u_direction) {
    const float u_lobe = needs_lobe_sample(here.bsdf) ? sampler.pair(dimension(depth, Dimension::lobe)).x : 0.0f;
    return sample(here.bsdf, here.wo_local, u_lobe, u_direction);
}

/// BSDF sample of a path at its vertex number `depth`, the shadowing of bumps in its weight.
[[gnu::always_inline]] inline BsdfSample<float> draw(const ShadingPoint& here, const Sampler& sampler, int depth,
                                                     Point2f u_direction) {
    BsdfSample<float> s = draw_unshadowed(here, sampler, depth, u_direction);
    if (here.perturbed && s.lobe != Lobe::none && s.lobe != Lobe::null)
        s.weight *= bump_shadowing(here, here.frame.to_world(s.wi), s.wi.z);
    return s;
}

/// Throughput after a BSDF sample of this weight that has survived roulette with probability q.
inline Spectrum continued(const Spectrum& beta, const Spectrum& weight, float q) {
    return beta * (weight * (1 / q));
}

/// What a path gains by a light sample that is not occluded, weighted against BSDF sampling.
/// in:  pdf_bsdf_w  roulette folded in; 0 where BSDF sampling does not find the light
inline Spectrum light_sample_contribution(const Spectrum& beta, const Spectrum& f_cos, const Spectrum& Li,
                                          float pdf_nee_w, float pdf_bsdf_w) {
    const float weight = power_heuristic(pdf_nee_w, pdf_bsdf_w) / pdf_nee_w;
    return beta * f_cos * Li * weight;
}

/// What a path gains by light that its ray hits, weighted against next-event estimation.
/// in:  pdf_bsdf_w  of the ray, roulette folded in
///      pdf_nee_w   0 where next-event estimation does not find the light
inline Spectrum light_hit_contribution(const Spectrum& beta, const Spectrum& Li, float pdf_bsdf_w, float pdf_nee_w) {
    return beta * Li * power_heuristic(pdf_bsdf_w, pdf_nee_w);
}

/// A lobe that keeps a ray's direction: of a mask, a null surface or a thin pane.
constexpr bool goes_straight_on(Lobe lobe, BsdfKind kind) {
    return lobe == Lobe::null || (lobe == Lobe::delta_transmission && kind == BsdfKind::thin_dielectric);
}

/// Moves the state of a path past a vertex; the caller sets its next ray.
/// in:  s        direction that continues the path
///      q        probability to continue; s.weight is divided by it
///      density  of the direction in the measure of its lobe, roulette folded in
[[gnu::always_inline]] inline void pass_vertex(PathState& path, const Point3f& p, const BsdfModel& model,
                                               SurfaceIdx surface, const BsdfSample<float>& s, float q, float density) {
    path.lobe = s.lobe;
    path.is_straight &= goes_straight_on(s.lobe, model.kind);
    path.is_first = false;
    path.density = density;
    path.from = p;
    path.beta = continued(path.beta, s.weight, q);
    if (s.lobe == Lobe::delta_transmission || s.lobe == Lobe::glossy_transmission) {
        path.eta_scale *= sqr(s.eta);
        path.media.pass(surface, s.wi.z < 0, model);
    }
}

/// Medium of the segment from a vertex towards wi.
/// in:  media  of the segment that arrives there
inline Medium medium_towards(const MediumStack& media, const ShadingPoint& here, SurfaceIdx surface,
                             const Vector3f& wi) {
    const BsdfModel& model = *here.bsdf.model;
    const float side = dot(here.n_side, wi);
    if (!is_interface(model) || side * dot(here.n_side, here.wo) >= 0) return media.medium();
    MediumStack beyond = media;
    beyond.pass(surface, side < 0, model);
    return beyond.medium();
}

/// Whether a ray that leaves the scene finds the sky black: that of a camera, in a scene that hides its emitters.
inline bool hides_sky(const Scene& scene, bool is_straight) {
    return scene.hides_emitters && is_straight;
}

/// in:  distance  from the origin of the camera ray, m
inline FirstHit first_hit(const ShadingPoint& here, float distance) {
    return {albedo(here.bsdf, here.wo_local), here.frame.n, distance};
}

}  // namespace loom
