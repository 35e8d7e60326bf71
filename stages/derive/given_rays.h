#pragma once
// Light along rays of boundary samples, traced in batches.

#include "stages/core/graph/time_of_flight.h"
#include "stages/core/tracing/given_ray_tracer.h"
#include "stages/derive/boundary.h"

namespace loom::derive {

/// Returns how the graph's paths were traced, with another seed.
PathOptions options_of(const PathGraph& graph, std::uint64_t seed);

/// Traces rays and walks along the light that arrives on each. State of one thread.
class RayLight {
  public:
    RayLight(const BoundaryScene& s, std::uint64_t seed)
        : tracer_(s.scene, options_of(s.graph, seed), OptionalColumns{false, true, false}),
          reader_(tracer_.graph()),
          lengths_(tracer_.graph(), Timing{}) {}

    /// Calls on_ray(i, graph, edge) in order; on_ray must walk path i and so advance `edge`.
    template <class OnRay>
    void trace(std::span<const GivenRay> rays, OnRay&& on_ray) {
        if (rays.empty()) return;
        const PathGraph& g = tracer_.trace(rays);
        for (const PathResult& result : tracer_.results()) n_rays += result.n_rays;
        std::size_t edge = 0;
        for (std::size_t i = 0; i < rays.size(); ++i) on_ray(i, g, edge);
    }
    /// Calls on_light(L, opl) for the light of path i; opl is infinite for lights at infinity.
    template <class OnLight>
    void walk(std::size_t i, std::size_t& edge, OnLight&& on_light) const {
        walk_in_time(reader_, lengths_, i, edge, on_light);
    }
    /// The same of an NLOS capture, on_light(L, opl, share of opl from the laser to its spot).
    template <class OnLight>
    void walk_from_laser(std::size_t i, std::size_t& edge, OnLight&& on_light) const {
        walk_edges_in_time(
            reader_, lengths_, i, edge, [](const Spectrum&, double) {},
            [&](std::size_t k, const Spectrum& L, double opl) { on_light(L, opl, lengths_.from_laser(k)); });
    }

    /// Length of path i from the ray's origin to its first hit; 0 without one.
    double to_first_hit(std::size_t i) const {
        const auto& first = reader_.graph().paths.first_vertex;
        return first[i] == first[i + 1] ? 0 : lengths_.from_camera(i);
    }

    std::uint64_t n_rays = 0;

  private:
    GivenRayTracer tracer_;
    GraphReader reader_;
    OpticalLengths lengths_;
};

}  // namespace loom::derive
