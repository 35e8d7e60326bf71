#pragma once
// Samples of each technique and camera paths of each pixel, from a pilot whose samples are not reused.

#include <string>
#include <vector>

#include "stages/core/edit/scene_pair.h"
#include "stages/core/tracing/pixel_loop.h"
#include "stages/residual/dynamic/path_pairs.h"

namespace loom::residual {

struct Effort {
    std::vector<double> samples;           // of each family, for the whole image; unused for path tracing
    std::vector<std::uint32_t> per_pixel;  // camera paths of each pixel
    bool first_to_camera = false;          // as SampleCounts
    std::string why;                       // reason, in one line; empty without a pilot
    /// [channel][pixel] of one pair: covariance of its difference with its old path, and variance of the old path.
    /// Empty without a pilot.
    std::vector<double> covariance[3], old_variance[3];

    /// Whether path tracing is the only family: pairs of camera paths alone, without weights against other techniques.
    bool cameras_alone() const;
};

/// Returns one sample per pixel of each family for each of spp.
Effort equal_effort(const std::vector<Family>& families, const Sensor& sensor, std::uint64_t spp);

/// Returns camera paths alone, spp in every pixel.
Effort camera_effort(const std::vector<Family>& families, const Sensor& sensor, std::uint64_t spp);

struct PilotOptions {
    PathPairs::Options pairs;
    bool adaptive_map = true;  // else all pixels get equal numbers of camera paths
    double must_gain = 1.25;   // factor by which other families must reduce the variance, because a pilot is noisy
};

/// Computes the effort for the cost of spp pairs of camera paths, in rays. Samples of families are by effort_model.h.
/// Camera paths of a pixel are by the standard deviation sigma of their differences, blurred:      [001] Eq. (7), (8)
///     s_p = n (1/2 + 1/2 sigma_p sum c / sum (c sigma)),  c: rays of a pair;  rounded by dithering, at least 2
/// differs: [001] takes maps from earlier frames and divides by min(1, s); here the pilot is drawn separately, so that
///          no sample determines its own weight, and every pixel gets samples
/// out:     counts  of the pilot are added
/// needs:   spp >= least_spp
Effort effort_by_pilot(const DynamicScenes& scenes, const std::vector<Family>& families, const PilotOptions& options,
                       const PathOptions& path, const tracing::Work& work, tracing::Counts& counts);
/// A pilot traces two camera paths in every pixel.
inline constexpr std::uint64_t least_spp = 16;

}  // namespace loom::residual
