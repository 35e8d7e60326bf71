#pragma once
// A radiance cache of points, from a traced scene.

#include "stages/learn/learn.h"
#include "tests/traced_graph.h"

namespace loom::testing {

/// in:  k  members of a cluster
inline RadianceCache learnt_cache(const Scene& scene, const PathOptions& path, std::uint64_t spp, std::uint32_t k) {
    std::vector<learn::LearnInput> inputs(1);
    learn::LearnInput& in = inputs[0];
    in.graph = trace_graph(scene, path, spp);
    in.clusters = clusters_of(in.graph, k, 0, 0.03f, &scene);
    in.radiance = radiance_of(in.graph, in.clusters);
    return learn::learn(inputs, {});
}

/// A cache of points whose values are those of another, changed.
template <class Of>
RadianceCache with_values(RadianceCache cache, Of&& value) {
    std::vector<float> E(cache.points.E.begin(), cache.points.E.end());
    for (float& e : E) e = value(e);
    cache.points.E = E;
    return cache;
}

}  // namespace loom::testing
