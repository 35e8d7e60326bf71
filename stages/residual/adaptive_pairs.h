#pragma once
// Residuals by pairs of paths where they are needed (--extra): on top of a graph's, or alone.

#include <string>

#include "stages/core/edit/scene_pair.h"
#include "stages/residual/effort/extra_pairs.h"

namespace loom::residual {

struct AdaptiveOptions {
    double mean = 1;    // pairs per pixel
    bool even = false;  // alone: without a map
    PathOptions path;   // of the pairs; its seed is that of their map, too
    int threads = 0;
};

/// Pairs on top of a residual's own.
struct ExtraPairs {
    PairSums sums;
    std::uint64_t n = 0;  // of all pixels
    tracing::Counts counts;
    std::string summary;
};
/// Traces pairs by the deviation of those that a residual has.
/// in:      samples  pairs per pixel of the residual
///          control  with weights that none of its pairs has determined; null: none
ExtraPairs trace_extra_pairs(const ScenePair& scenes, const Edit& edit, const AdaptiveOptions& options,
                             const Image& residual, std::uint64_t samples, const ControlSums* control,
                             app::Report& report);

/// A residual of sparse pairs alone.
struct SparseResidual {
    Image image;     // as render_residual() makes it; Albedo, N, Depth by camera rays of their own
    Image weighted;  // the same with R, G, B, VarMean of f_new - alpha f_old; empty without alpha
    std::uint64_t n = 0;
    tracing::Counts counts;
    std::string summary;
};
/// in:      alpha  [pixel] weights of the old image; empty: none
SparseResidual render_sparse_residual(const ScenePair& scenes, const Edit& edit, const AdaptiveOptions& options,
                                      const std::vector<Spectrum>& alpha, app::Report& report);

}  // namespace loom::residual
