#pragma once
#include <string>
#include <vector>

#include "formats/image.h"
#include "formats/path_graph.h"
#include "formats/radiance.h"
#include "stages/core/clusters/cluster_edges.h"

namespace loom {
struct Clusters;
struct Scene;
}  // namespace loom

namespace loom::app {
class Command;
class Report;
}  // namespace loom::app

namespace loom::gather {

/// Source of the light that leaves a first hit.
enum class Source {
    own,      // the path's own samples: next-event estimation and the BSDF sample
    cluster,  // all samples of its cluster
    subset,   // its own samples and those of a few other members of its cluster, drawn anew for each path
};

struct GatherOptions {
    Source direct = Source::cluster, indirect = Source::cluster;
    bool estimates = false;           // store all estimates as layers, for loom-merge to blend
    std::uint32_t members = 4;        // subset: its size, besides the vertex itself
    Reuse reuse = Reuse::directions;  // subset: the part of a continuation that is reused
    bool occlusion = false;           // subset: reconnect continuations, with visibility tested by rays
};

/// Inputs for drawing a subset and tracing its rays.
struct SubsetInputs {
    const Clusters* clusters = nullptr;  // of the graph
    const Scene* scene = nullptr;        // scene of the graph; with occlusion only
    std::uint64_t seed = 0;
};

struct Options {
    std::string graph;                 // path graph
    std::string radiance;              // refined radiance of that graph; empty: own paths only
    std::string clusters;              // of that graph; for subsets only
    std::string scene;                 // scene of the graph; for occlusion rays only
    std::vector<std::string> defines;  // of the scene, name=value
    std::string sensor;                // of the scene, id or index; empty: the first
    std::string output;                // image with layers (.exr)
    std::string png;                   // 8-bit preview
    double exposure_ev = 0;            // of the preview
    GatherOptions gather;              // with radiance only
    int threads = 0;                   // 0: all
};

void declare(app::Command& command, Options& options);

/// Sums the radiance of every stored path:
///   L = Le + sum_j beta_j sum_(light edges of j) w f cos Li / pdf,   beta_(j+1) = beta_j f cos / pdf_w
/// The BSDFs are evaluated again from the stored vertices. The image equals that of `loom-trace -o x.exr` up to
/// rounding.
Image path_traced_image(const PathGraph& graph, int threads);

/// Computes one pixel sample per path from the refined radiance:
///   own      Le + own direct light + f cos / pdf_w X(second vertex); samples of pixels stay independent given X
///                                                                          PG section 5.2, K = 1
///   cluster  Le + X(first vertex)
///   subset   between the two, see subset.h
/// The source is chosen separately for direct and indirect light. VarMean assumes independent samples of a pixel, which
/// those of one graph are not; images of several graphs give a better estimate (loom-merge). Among the layers of
/// estimates, a subset with occlusion rays replaces the own samples, a subset without rays the cluster.
/// out:     n_rays  occlusion rays
Image gathered_image(const PathGraph& graph, const Radiance& radiance, const GatherOptions& options, int threads,
                     const SubsetInputs& subset = {}, std::uint64_t* n_rays = nullptr);

/// throws: InputError
void run(const Options& options, app::Report& report);

}  // namespace loom::gather
