#pragma once
// A look at the interior part of a derivative: its noise, and how many points of a light that is seen wholly pay.

#include <optional>
#include <vector>

#include "stages/derive/interior.h"

namespace loom::derive {

/// Cost of tracing a path and binning it, in rays.
double cost_of_path(const PathGraph& graph);

struct InteriorPilot {
    int points_per_side = 1;       // of WholeLightOptions
    std::vector<double> variance;  // [parameter], summed over pixels, bins and channels
};

/// Looks at the paths of some pixels, whose light edges count as independent. Counts work, not time: equal inputs give
/// equal results.
/// in:      whole   with the edges of the scene; null edges: stored points alone
///          wanted  points per side; none: those of the least variance times cost of tracing, interior and binning
InteriorPilot look_at_interior(const PathGraph& graph, const Scene& scene, const SceneTangents& tangents,
                               const Attached& attached, WholeLightOptions whole, std::optional<int> wanted);

}  // namespace loom::derive
