#pragma once
// States of a path before each of its edges, for tests that start paths midway.

#include <vector>

#include "stages/core/scene/embree.h"
#include "stages/core/tracing/path_step.h"

namespace loom::testing {

/// Returns a path's states before each of its edges, by the plain step; rays are traced as in a batch.
inline std::vector<PathState> states_of(const Scene& scene, const PathOptions& options, PathId id) {
    const Sampler sampler(options.sampler, options.seed, id.pixel, id.sample);
    PathState path(scene, sampler, id, sampler.pair(film_pair));
    std::vector<PathState> states;
    for (int depth = 1;; ++depth) {
        states.push_back(path);
        const Ray* ray = &path.ray;
        Hit hit;
        (depth == 1 ? scene.camera_rays : scene.rays)->intersect(&ray, 1, &hit, depth == 1);
        ++path.result.n_rays;
        LightQuery lights;
        lights.kind = !hit                         ? LightQuery::Kind::environment
                      : depth == options.max_depth ? LightQuery::Kind::nothing
                                                   : LightQuery::Kind::point;
        lights.u = sampler.pair(dimension(depth, Dimension::light));
        lights.d = path.ray.d;
        look_up_light(scene, lights);
        tracing::ShadowRequest shadow;
        const tracing::Step step = tracing::arrive<false>(
            scene, options, depth, hit, lights, sampler.pair(dimension(depth, Dimension::direction)), path, shadow, {});
        if (tracing::has(step, tracing::Step::needs_shadow_ray)) {
            const Ray* segment = &shadow.ray;
            bool blocked = false;
            scene.rays->occluded(&segment, 1, &blocked);
            ++path.result.n_rays;
            tracing::end_next_event<false>(path, shadow, blocked, {});
        }
        if (!tracing::has(step, tracing::Step::goes_on)) return states;
    }
}

}  // namespace loom::testing
