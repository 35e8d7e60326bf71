#pragma once
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "formats/image.h"
#include "formats/path_graph.h"
#include "stages/core/scene/scene.h"
#include "stages/core/tracing/graph_builder.h"
#include "stages/core/tracing/path_tracer.h"
#include "stages/core/tracing/pixel_loop.h"

namespace loom::app {
class Command;
class Report;
}  // namespace loom::app

namespace loom::trace {

struct Options {
    std::string scene;                 // Mitsuba XML
    std::string output;                // .h5: path graph; .exr: path-traced image; % stands for the index of the pass
    std::vector<std::string> defines;  // name=value
    std::string sensor;                // id or index, from 0; empty: the first
    std::string static_frames;         // table of frames: only what they have in common is traced
    std::string absent;                // value of a parameter whose shapes a frame lacks
    std::string frames, only;          // table of frames: each is traced by itself, or those that `only` names
    std::uint64_t spp = 1;             // samples per pixel
    std::uint64_t first_sample = 0;    // index of the first sample
    std::uint64_t passes = 1;          // files of spp samples each, traced one after the other
    std::uint64_t seed = 0;
    int threads = 0;  // 0: all
    SamplerKind sampler = SamplerKind::sobol;
    Roulette roulette = Roulette::albedo;
    std::optional<int> rr_depth;   // unset: that of the scene file
    std::optional<int> max_depth;  // unset: that of the scene file; -1: no limit
    LaserSpot laser_spot = LaserSpot::unit_area;
    OptionalColumns columns;  // of a graph
    bool plan = false;        // print the plan and stop
    std::string replay;       // x,y,sample: trace that one path and print it
};

using tracing::Counts;
using tracing::Work;

/// Renders a path-traced image with auxiliary layers; stores nothing but the film. Equal values for any number of
/// threads.
Image render_image(const Scene& scene, const PathOptions& path, const Work& work, app::Report& report, Counts& counts);

/// Traces the same paths as a graph to be written, in the given memory. The memory of an earlier graph may be reused;
/// that graph is then invalid.
/// in:      columns  an NLOS capture has no misses
PathGraphInPieces render_graph(const Scene& scene, const PathOptions& path, const Work& work, app::Report& report,
                               Counts& counts, std::shared_ptr<Arena> memory = std::make_shared<Arena>(),
                               const OptionalColumns& columns = {});

void declare(app::Command& command, Options& options);

/// Traces a scene file into options.output, pass by pass. A pass has the same bytes as if it was traced alone.
/// throws: InputError
void run(const Options& options, app::Report& report);

/// Describes in one line what the scene requires, and what is off.
/// in: graph  optional columns of a graph; null: an image
std::string plan(const Scene& scene, const PathOptions& path, const OptionalColumns* graph);

}  // namespace loom::trace
