#pragma once
// Where the image of the old scene says nothing: pixels in which the camera sees what an edit has changed.

#include <optional>

#include "stages/core/edit/edit_reach.h"
#include "stages/core/edit/scene_pair.h"
#include "stages/residual/control/controlled.h"

namespace loom::residual {

/// Weights of the old image (control_weights()) from the first hits of the camera: alpha = 1 - the share of the
/// rays of a pixel whose first hit differs between the scenes. There the paths of the two scenes have nothing in common,
/// and old paths are noise alone. The rays have random numbers of their own, so that no sample determines the weight of
/// itself: the sum is unbiased.                                       [HY] Eq. (10), as a weight in place of a mask
/// in:      seed  of the samples
/// out:     none where all are 1
std::optional<ControlSums> coverage_control(const ScenePair& scenes, const EditReach& reach, std::uint64_t seed,
                                            int threads);

}  // namespace loom::residual
