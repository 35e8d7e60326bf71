#pragma once
// How much the image of the old scene says about that of the new one, before any path is traced: nothing in pixels in
// which the camera sees what an edit has changed.

#include <cstdint>
#include <optional>
#include <vector>

#include "stages/core/edit/edit_reach.h"
#include "stages/core/edit/scene_pair.h"
#include "stages/core/sampling/sampler.h"
#include "stages/residual/control/controlled.h"

namespace loom::residual {

/// What determines the weight of the old image in the new one.
enum class Mask : std::uint8_t {
    coverage,  // graph_control(); of least variance where a pilot has found it
    none,      // 1
    first_hit  // first_hit_control()
};

/// Weights of the old image (ControlSums) for pairs of paths with the numbers of a graph.
///
/// By the first hits of the camera: alpha = 1 - the share of the rays of a pixel whose first hit differs between the scenes.
/// There the paths of the two scenes have nothing in common, and old paths are noise alone. The rays have random numbers of
/// their own, so that no sample determines the weight of itself: the sum is unbiased.   [HY] Eq. (10), as a weight in place
/// of a mask
///
/// Where lights differ, ControlSums::fits is set: they change most of what they reach in the same way, dimmed ones by a
/// factor. Where shapes differ most paths bring the same, and weights near 1 would only add their noise.
/// in:      seed  of the samples
/// out:     none where all are 1
std::optional<ControlSums> graph_control(const ScenePair& scenes, const EditReach& reach, std::uint64_t seed,
                                         int threads);

/// Weights 0 in pixels where the first hit of a sample differs between the scenes, else 1: [HY] Eq. (10) for the pixels of
/// an image. The samples determine their own weights: biased where some rays of a pixel hit what differs and others do not.
/// in:      sampler, seed  of the pairs of paths
///          samples        indices of those of each pixel
/// out:     none where all are 1
std::optional<ControlSums> first_hit_control(const ScenePair& scenes, const EditReach& reach, SamplerKind sampler,
                                             std::uint64_t seed, const std::vector<std::uint64_t>& samples,
                                             int threads);

}  // namespace loom::residual
