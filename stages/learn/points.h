#pragma once
#include "stages/learn/learn.h"

namespace loom::learn {

/// Fills a cache with a point per cluster: means over its members of position, normal and outgoing radiance.
///   E = sum_j L_j / sum_j rho_j,   var E = sum_j (L_j - E rho_j)^2 / (n (n - 1) rho_mean^2)
/// of the members that are not held back, with finite radiance, on surfaces that the cache covers; of preferred vertices
/// alone (PreferredVertices) where a cluster has any.
/// out:     points, metric but for its median distance, demodulated, domain, settings
void fill_points(const std::vector<LearnInput>& inputs, const LearnOptions& options, RadianceCache& cache);

}  // namespace loom::learn
