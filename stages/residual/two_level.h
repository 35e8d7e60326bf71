#pragma once
// Images by two levels of paths: with a radiance cache, and without its bias.                                     [NIRC]

#include "stages/residual/cached_estimator.h"

namespace loom::residual {

/// Smallest R; the variance of what is traced on grows as 1 / R.
inline constexpr double smallest_share = 0.001;

/// Renders the new scene. For each camera sample,
///   L = L_1 + b / R (L_path - L_1)       b = 1 with probability R, else 0, by a random number of its own
/// L_path is the path tracer's. L_1 is the same path up to its second vertex, where the cache stands for what comes after
/// it: emission and light samples before, with their weights, are those of the path, and mirrors, glass and nearly
/// specular surfaces do not count as vertices. The mean over b is L_path, so L is unbiased whatever the cache contains.
/// A path goes on past vertices where the cache cannot answer: on what the edit changes, on emitters, on materials with a
/// validation above largest_relative_l2. L = L_path where it ends before the cache, or is far from the cache's points.
/// This is [HY] eq. (10) of such an L of the static scene, with the difference f_new - f_old traced for the same share of
/// the samples: f_old = L_path cancels, and M has no more use.
/// in:      share  R, smallest_share to 1; at 1 the image is the path tracer's
/// out:     image  R, G, B, VarMean, Albedo, N, Depth
/// needs:   as render_cached()
Image render_corrected(const ScenePair& scenes, const Edit& edit, const CacheReader& cache, double share,
                       const PathOptions& path, const Work& work, app::Report& report, CachedCounts& counts);

}  // namespace loom::residual
