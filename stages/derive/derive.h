#pragma once
// loom-derive: derivatives of the light of stored paths by parameters of their scene: of every path, without tracing,
// and of the boundaries between light and shadow that move.                     [TR] "Differentiable Transient Rendering"

#include <cstdint>
#include <string>
#include <vector>

#include "formats/derivative.h"
#include "formats/path_graph.h"
#include "stages/derive/scene_tangents.h"

namespace loom::app {
class Command;
class Report;
}  // namespace loom::app

namespace loom::derive {

struct Options {
    std::string scene, graph, output;
    std::vector<std::string> wrt;      // $parameters or named parts
    std::vector<std::string> defines;  // name=value
    std::string adjoint;               // weights of a histogram: one backward sweep; empty: forward
    std::string sensor;                // id or index, from 0; empty: the first
    std::vector<std::string> off;      // parts to leave out
    double effort = 1;                 // boundary samples per path of the graph
    std::uint64_t seed = 0;
    int threads = 0;    // 0: all
    bool plan = false;  // print the plan and stop
};

void declare(app::Command& command, Options& options);

class Adjoint;

/// Parts of a derivative that a scene and its parameters require.
struct Parts {
    bool interior = true, primary = false, direct = false, indirect = false;
    std::string plan;  // one line: what is on, what is off and why
};
Parts required_parts(const Scene& scene, const PathGraph& graph, const SceneTangents& tangents,
                     const std::vector<std::string>& off);

/// Sampling of boundary terms.
struct BoundaryOptions {
    double effort = 1;  // samples per path
    std::uint64_t seed = 0;
    int threads = 0;
    const Adjoint* adjoint = nullptr;  // weights of a loss: contract the rows
};

/// Number of paths and rays that a derivative took.
struct DeriveCounts {
    std::uint64_t touched_paths = 0, rays = 0;
};

/// Differentiates the paths of a graph of `scene`.
Derivative differentiate(const PathGraph& graph, const Scene& scene, const SceneTangents& tangents, const Parts& parts,
                         const BoundaryOptions& boundary, app::Report& report, DeriveCounts& counts);

/// throws:  InputError
void run(const Options& options, app::Report& report);

}  // namespace loom::derive
