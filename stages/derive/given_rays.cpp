#include "stages/derive/given_rays.h"

namespace loom::derive {

PathOptions options_of(const PathGraph& graph, std::uint64_t seed) {
    PathOptions options;
    options.seed = seed;
    options.sampler = SamplerKind::independent;
    options.max_depth = graph.tracing.max_depth;
    options.rr_depth = graph.tracing.roulette_depth;
    options.roulette = graph.tracing.roulette == "albedo"       ? Roulette::albedo
                       : graph.tracing.roulette == "throughput" ? Roulette::throughput
                                                                : Roulette::off;
    if (!graph.nlos.true_area.empty() && graph.nlos.true_area[0]) options.laser_spot = LaserSpot::true_area;
    return options;
}

}  // namespace loom::derive
