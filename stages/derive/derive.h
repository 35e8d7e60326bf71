#pragma once
// loom-derive: derivatives of the light of stored paths by parameters of their scene: of every path, without tracing,
// and of the boundaries between light and shadow that move.                     [TR] "Differentiable Transient Rendering"

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "formats/derivative.h"
#include "formats/path_graph.h"
#include "stages/derive/doppler.h"
#include "stages/derive/scene_tangents.h"

namespace loom::app {
class Command;
class Report;
}  // namespace loom::app

namespace loom::derive {

/// How shadow edges of area lights are sampled at first hits.
enum class Direct : std::uint8_t {
    automatic,  // by a pilot, emitter by emitter
    vertices,   // from stored vertices
    lights      // from light points
};

/// What a vertex beyond a scattering keeps while the scene moves.
enum class Attachment : std::uint8_t {
    automatic,  // the direction near its start, its place far from it
    surface,    // its place on its surface
    ray         // the direction that was sampled
};

struct Options {
    std::string scene, graph, output;
    std::vector<std::string> wrt;      // $parameters or named parts
    std::vector<std::string> defines;  // name=value
    std::string adjoint;               // weights of a histogram: one backward sweep; empty: forward
    std::string sensor;                // id or index, from 0; empty: the first
    std::vector<std::string> off;      // parts to leave out
    std::optional<double> effort;      // of boundary samples, over that of tracing and binning the graph; none: least
                                       // variance times cost
    Direct direct = Direct::automatic;
    Attachment attachment = Attachment::automatic;
    /// Of a light that a first hit sees wholly; none: as many as pay.
    std::optional<int> light_points_per_side;
    std::uint64_t seed = 0;
    bool exact_times = false;            // sample the borders of bins, for a delta pulse
    std::optional<double> start, width;  // of these bins, m; default: the film's
    std::optional<std::uint32_t> bins;
    int threads = 0;    // 0: all
    bool plan = false;  // print the plan and stop
    DopplerRequest doppler;
};

void declare(app::Command& command, Options& options);

class Adjoint;

/// Parts of a derivative that a scene and its parameters require.
struct Parts {
    bool interior = true, primary = false, direct = false, indirect = false, media = false;
    std::string plan;         // one line: what is on, what is off and why, what is not sampled
    std::string not_sampled;  // borders that may move and that no part looks for: a bias

    bool any_boundary() const { return primary || direct || indirect; }
};
Parts required_parts(const Scene& scene, const PathGraph& graph, const SceneTangents& tangents,
                     const std::vector<std::string>& off, Attachment attachment = Attachment::automatic);

/// Sampling of boundary terms.
struct BoundaryOptions {
    std::optional<double> effort = {};  // over that of tracing and binning; none: least variance times cost
    std::uint64_t seed = 0;
    int threads = 0;
    Direct direct = Direct::automatic;
    Attachment attachment = Attachment::automatic;
    const Adjoint* adjoint = nullptr;               // weights of a loss: contract the rows
    std::optional<int> light_points_per_side = {};  // of the interior: WholeLightOptions; none: as many as pay
    std::vector<double> interior_variance = {};     // [parameter], of InteriorPilot; empty: 0
};

struct Attached;
/// Returns how far vertices keep their directions; in an NLOS capture always their places.
Attached attached_of(const Scene& scene, Attachment attachment);

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
