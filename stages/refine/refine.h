#pragma once
#include <string>

#include "formats/radiance.h"
#include "stages/refine/solve.h"

namespace loom::app {
class Command;
class Report;
}  // namespace loom::app

namespace loom::refine {

enum class Method { fixed_point, west };
enum class Start {
    automatic,  // zero where the scene's depth limit is small enough to be kept exactly, else paths
    paths,      // each path's own estimate: near the solution except for its noise
    zero,       // zero radiance: k steps give light of k bounces
};

struct Options {
    std::string graph;     // path graph
    std::string clusters;  // of that graph; not used by Method::west
    std::string output;    // radiance
    Method method = Method::fixed_point;
    Reuse reuse = Reuse::directions;
    Clamp clamp = Clamp::column;
    Start start = Start::automatic;
    int iterations = 6;
    float epsilon = 1e-4f;
    bool as_printed = false;
    std::uint32_t neighbours = 16;    // Method::west
    float private_roughness = 0.03f;  // Method::west; else the clusters' setting is used
    int threads = 0;
    bool plan = false;
};

void declare(app::Command& command, Options& options);

/// Computes the fixed point of aggregation and propagation.
/// needs:   clusters of this graph
Radiance refine_radiance(const PathGraph& graph, const Clusters& clusters, const Options& options, app::Report& report);

/// Applies the single filter of West et al., see west.h.
Radiance west_radiance(const PathGraph& graph, const Options& options);

/// throws: InputError
void run(const Options& options, app::Report& report);

}  // namespace loom::refine
