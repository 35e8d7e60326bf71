#pragma once
// How many samples each technique and each pixel gets, from a pilot whose samples are not used again.

#include <string>
#include <vector>

#include "stages/core/edit/scene_pair.h"
#include "stages/core/tracing/pixel_loop.h"
#include "stages/residual/dynamic/path_pairs.h"

namespace loom::residual {

struct Effort {
    std::vector<double> samples;           // of each family, of the whole picture; of path tracing: unused
    std::vector<std::uint32_t> per_pixel;  // camera paths of each pixel
    bool first_to_camera = false;          // as SampleCounts
    std::string why;                       // in one line; empty when not asked for
    /// By channel and pixel, of one pair: covariance of its difference with its old path, and variance of the old path.
    /// Empty without a pilot.
    std::vector<double> covariance[3], old_variance[3];

    /// No family but path tracing: pairs of camera paths alone, not weighted against anything.
    bool cameras_alone() const;
};

/// One sample per pixel of each family for each of spp.
Effort equal_effort(const std::vector<Family>& families, const Sensor& sensor, std::uint64_t spp);

/// Camera paths alone, spp in every pixel.
Effort camera_effort(const std::vector<Family>& families, const Sensor& sensor, std::uint64_t spp);

struct PilotOptions {
    PathPairs::Options pairs;
    bool adaptive_map = true;  // else all pixels get as many camera paths
    double must_gain = 1.25;  // families beside path tracing must promise as many times less variance: a pilot is noisy
};

/// Effort for what spp pairs of camera paths would cost, in rays; samples of families by effort_model.h, camera paths
/// of a pixel
/// by the deviation sigma of theirs, blurred:                                             [001] Eq. (7), (8)
///     s_p = n (1/2 + 1/2 sigma_p sum c / sum (c sigma)),  c: rays of a pair;  rounded by dithering, at least 2
/// differs: [001] takes maps from earlier frames and divides by min(1, s); here the pilot is drawn apart, so that
///          nothing steers the samples that it weighs, and no pixel goes without samples.
/// out:     counts  of the pilot are added
/// needs:   spp >= least_spp
Effort effort_by_pilot(const DynamicScenes& scenes, const std::vector<Family>& families, const PilotOptions& options,
                       const PathOptions& path, const Work& work, Counts& counts);
/// A pilot takes two camera paths in every pixel.
inline constexpr std::uint64_t least_spp = 16;

}  // namespace loom::residual
