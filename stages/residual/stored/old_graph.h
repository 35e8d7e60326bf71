#pragma once
// Correlated difference from existing paths: those of a graph of the old scene.

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "formats/image.h"
#include "formats/path_graph.h"
#include "stages/core/edit/edit_reach.h"
#include "stages/core/edit/scene_pair.h"
#include "stages/core/tracing/pixel_loop.h"
#include "stages/residual/control/controlled.h"

namespace loom::residual {

/// Passes of loom-trace over the old scene, in the order of their samples, and their tracing options.
struct OldGraph {
    std::vector<PathGraph> passes;
    std::vector<std::string> files;  // [pass]
    PathOptions path;                // seed, sampler, roulette and depths, equal in all passes
    std::uint64_t spp = 0;           // samples per pixel of all passes together

    const Provenance& provenance() const { return passes[0].provenance; }
    /// Returns the indices of the samples of each pixel.
    std::vector<std::uint64_t> samples() const;
};

/// Reads the passes of an old graph.
/// in:      max_depth    depth limit for the new scene
/// throws:  InputError with file and reason: not traced by loom-trace, or not in this scene; another film or max_depth;
///          passes with different options, or with common samples
OldGraph read_old_graph(const std::vector<std::string>& files, const Scene& old_scene, const std::string& scene_name,
                        int max_depth);

/// Whether an image of the old scene has exactly the graph's samples, and so its noise.
/// throws:  InputError with the file where the image may have some of them: equal seed, other samples
bool same_samples(const Image& old_picture, const std::string& file, const OldGraph& graph);

class PartSums;
class SeenEmission;

struct GraphResidual {
    Image image;
    tracing::Counts counts;  // of the new tracing only
    std::uint64_t paths = 0, touched = 0;
    std::string why_all;  // reason why all paths count as touched; else empty
    // [channel][pixel] sum of (L_new - m)^2 - (L_old - m)^2, m the old image's mean.
    std::vector<float> squares[3];

    std::string summary() const;
};

/// One of the new scenes of a graph.
struct GraphJob {
    const Scene& new_scene;
    const EditReach& reach;
    const Image* old_picture = nullptr;  // of the graph's own samples, for `squares`; null: none
    ControlSums* control = nullptr;      // with weights alpha of an image of other samples; null: none
    PartSums* parts = nullptr;  // takes the parts of each touched pair, whose new path is then traced whole; null: none
    const SeenEmission* seen = nullptr;  // the pairs lack the emission that it has; null: none
};

/// Renders the mean difference of the graph's paths and those with the same random stream in a new scene, new minus old,
/// for several new scenes: each block of the graph is read, and what its vertices need is computed, once for all of them.
/// Only paths that an edit touches are traced, in its new scene. Their old contribution is read from the graph; one in 64
/// is traced in the old scene as well, as a probe. The other paths add zeros, in the order of the samples. [METHODS 2.3]
/// out:     [job] image  R, G, B, VarMean, samples: to the last bit those of render_residual() with these seeds; Albedo,
///                N, Depth of the new scene up to rounding; ledger: its link, without the edit's text and scene. No job
///                depends on the others.
///          control  pairs, of untouched paths, too, where the weight is not 1 or may change
/// differs: render_residual() has NaN where a path is not finite in both scenes; this function adds zero if the edit
///          does not touch it
/// throws:  InputError when more than one probe in a hundred has another number of vertices, or another contribution,
///          than in the graph
std::vector<GraphResidual> render_residuals(const Scene& old_scene, std::span<const GraphJob> jobs,
                                            const OldGraph& graph, int threads, app::Report& report);

/// The same, of one new scene.
GraphResidual render_residual(const ScenePair& scenes, const EditReach& reach, const OldGraph& graph, int threads,
                              const Image* old_picture, app::Report& report, ControlSums* control = nullptr,
                              PartSums* parts = nullptr);

/// Adds a residual to an old image of the same samples: returns the image of these samples in the new scene.
/// in:      residual  paths.image, with its provenance and the scene of its link
/// out:     an image like a newly traced one of that scene; no sum, so without a ledger
///   n (n - 1) var_mean = sum_i (L_new,i - m_old)^2 - n (m_new - m_old)^2
Image add_residual_of_same_samples(const Image& old_picture, const Image& residual, const GraphResidual& paths);

}  // namespace loom::residual
