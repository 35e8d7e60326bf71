#pragma once
// The correlated difference of paths that are already there: those of a graph of the old scene.

#include <cstdint>
#include <string>
#include <vector>

#include "formats/image.h"
#include "formats/path_graph.h"
#include "stages/core/edit/edit.h"
#include "stages/core/edit/scene_pair.h"
#include "stages/core/tracing/pixel_loop.h"

namespace loom::residual {

/// Passes of loom-trace over the old scene, in the order of their samples, and how they were traced.
struct OldGraph {
    std::vector<PathGraph> passes;
    std::vector<std::string> files;  // by pass
    PathOptions path;                // seed, sampler, roulette and depths of all of them
    std::uint64_t spp = 0;           // samples per pixel of all together

    const Provenance& provenance() const { return passes[0].provenance; }
};

/// in:      max_depth    with which the new scene is to be traced
/// throws:  InputError with file and reason: not traced by loom-trace, or not in this scene; another film or max_depth;
///          passes that were not traced alike, or that have samples in common
OldGraph read_old_graph(const std::vector<std::string>& files, const Scene& old_scene, const std::string& scene_name,
                        int max_depth);

/// Whether a picture of the old scene has the graph's noise in it, all of it.
/// throws:  InputError with the file where it may have part of it: the seed is the same, the samples are not
bool same_samples(const Image& old_picture, const std::string& file, const OldGraph& graph);

struct GraphResidual {
    Image image;
    Counts counts;  // of what was traced again
    std::uint64_t paths = 0, touched = 0;
    std::string why_all;  // why all paths count as touched; empty otherwise
    std::vector<float>
        squares[3];  // by channel and pixel: sum of (L_new - m)^2 - (L_old - m)^2, m the old picture's mean

    std::string summary() const;
};

/// Mean difference of the graph's paths and those of the same random numbers in the new scene, new minus old. Only
/// paths that the edit touches are traced, in the new scene; what they brought in the old one the graph knows, and one
/// in 64 is traced there as well, as a probe. The others add zeros, in the order of the samples. [METHODS 2.3]
/// in:      old_picture  of the graph's own samples, for `squares`; null: none
/// out:     image  R, G, B, VarMean, samples: to the last bit those of render_residual() with these seeds; Albedo, N,
///          Depth of the
///                 new scene, but for rounding; ledger: its link, but for the edit's words and scene
/// differs: render_residual() has NaN where a path is not finite in both scenes; here it adds zero if the edit does not
///          touch it
/// throws:  InputError where more than one in a hundred of the probes has another number of vertices than in the graph,
///          or brings something else
GraphResidual render_residual(const ScenePair& scenes, const Edit& edit, const OldGraph& graph, int threads,
                              const Image* old_picture, app::Report& report);

/// old + residual where both are of the same samples: the picture that these samples have in the new scene.
/// in:      residual  paths.image, with its provenance and the scene of its link
/// out:     a picture of that scene like one traced afresh; no sum, and so without a ledger
///   n (n - 1) var_mean = sum_i (L_new,i - m_old)^2 - n (m_new - m_old)^2
Image add_residual_of_same_samples(const Image& old_picture, const Image& residual, const GraphResidual& paths);

}  // namespace loom::residual
