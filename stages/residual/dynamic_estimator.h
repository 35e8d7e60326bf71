#pragma once
// Residual from paths through the edit: all techniques of [RP] §4 from all sites. Multiple importance sampling combines
// them in each scene; the same random stream and path mappings pair the two scenes.

#include <optional>
#include <string>

#include "formats/image.h"
#include "stages/residual/control/controlled.h"
#include "stages/residual/effort/effort.h"
#include "stages/residual/estimators.h"

namespace loom::residual {

struct DynamicOptions {
    PathPairs::Options pairs;
    /// Uses a pilot to set the samples of each family and the camera paths of each pixel, at the cost of spp pairs of
    /// camera paths. Below least_spp: camera paths alone, evenly. Without a pilot: spp samples per pixel of each.
    bool pilot = false;
    bool adaptive_map = true;  // as PilotOptions
    double must_gain = PilotOptions().must_gain;
    /// With VarMean: also computes the new image with it as control variate. Borrowed; null: off.
    const Image* old_picture = nullptr;
    /// Only the paths of this family, to examine one technique; weighted or not, but never mapped.
    int only_family = -1;
    bool weighted = true;
};

struct DynamicCounts {
    Counts counts;                    // nonfinite: dropped paths whose contribution or density is not finite
    std::uint64_t n_unrelocated = 0;  // samples of ghosts whose point is not among the crossings of the final segment
    double var_sample = 0;            // of one camera path's radiance in the new scene, mean over pixels and channels
    std::optional<ControlledPicture> controlled;  // only with an old image
    std::string effort;  // distribution of the effort and its reason, in one line; empty without a pilot
};

/// Renders new minus old:  sum over samples of F_new(p) - F_old(q), F = f / sum_l n_l p_l in its own scene   [RP] Eq.
/// (5), (16)
/// out:     image  R, G, B signed, VarMean; Albedo, N, Depth of the new scene
/// needs:   roulette by albedo or none; spp of work >= 1
Image render_dynamic(const ScenePair& scenes, const Edit& edit, const DynamicOptions& options, const PathOptions& path,
                     const Work& work, app::Report& report, DynamicCounts& counts);

}  // namespace loom::residual
