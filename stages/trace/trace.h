#pragma once
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "formats/image.h"
#include "formats/path_graph.h"
#include "stages/core/scene/scene.h"
#include "stages/core/tracing/path_tracer.h"
#include "stages/core/tracing/pixel_loop.h"

namespace loom::app {
class Command;
class Report;
}  // namespace loom::app

namespace loom::trace {

struct Options {
    std::string scene;                 // Mitsuba XML
    std::string output;                // .h5: path graph; .exr: path-traced image; % is the number of the pass
    std::vector<std::string> defines;  // name=value
    std::string sensor;                // id or number, from 0; empty: the first
    std::uint64_t spp = 1;             // samples per pixel
    std::uint64_t first_sample = 0;    // number of the first one
    std::uint64_t passes = 1;          // files of spp samples each, made one after the other
    std::uint64_t seed = 0;
    int threads = 0;  // 0: all
    SamplerKind sampler = SamplerKind::sobol;
    Roulette roulette = Roulette::albedo;
    std::optional<int> rr_depth;   // of the scene file when unset
    std::optional<int> max_depth;  // of the scene file when unset; -1: no limit
    LaserSpot laser_spot = LaserSpot::unit_area;
    bool misses = false;  // of a graph: keep what found no light, too
    bool plan = false;    // print the plan and stop
    std::string replay;   // x,y,sample: trace that one path and print it
};

using loom::Counts;
using loom::Work;

/// Path-traced image with auxiliary layers; keeps nothing but the film. Same values for any number of threads.
Image render_image(const Scene& scene, const PathOptions& path, const Work& work, app::Report& report, Counts& counts);

/// The same paths as a graph, to be written, in the memory given: that of an earlier graph, which is gone then.
/// in:      misses  kept, too; a capture around a corner has none
PathGraphInPieces render_graph(const Scene& scene, const PathOptions& path, const Work& work, app::Report& report,
                               Counts& counts, std::shared_ptr<Arena> memory = std::make_shared<Arena>(),
                               bool misses = false);

void declare(app::Command& command, Options& options);

/// Traces a scene file into options.output, pass by pass. A pass has the same bytes as if it had been made alone.
/// throws: InputError
void run(const Options& options, app::Report& report);

/// What the scene calls for and what is off, in one line.
std::string plan(const Scene& scene, const PathOptions& path, bool graph);

}  // namespace loom::trace
