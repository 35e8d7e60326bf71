#pragma once
#include "stages/learn/learn.h"
#include "stages/learn/train.h"

namespace loom::learn {

/// Whether a cache covers surfaces of the graph's scene whose radiance depends on direction: others than diffuse ones.
bool needs_directions(const PathGraph& graph);
/// Whether reflectance is textured, so that radiance changes faster along a surface than the light that arrives.
bool needs_demodulation(const PathGraph& graph);

/// Fills a cache with a hash grid and a network, trained on the vertices that the cache covers, preferred ones
/// (PreferredVertices) that are not held back. Their positions are mapped to [0, 1]^3 by a cube around the 0.1 % and
/// 99.9 % quantiles of each axis.
/// in:      report  shows the progress; null: nothing does
/// out:     grid, mlp, inputs, demodulated, domain, training, settings; settings.samples is 0 when there is no such vertex
void fill_grid(const std::vector<LearnInput>& inputs, const LearnOptions& options, RadianceCache& cache,
               app::Report* report);

}  // namespace loom::learn
