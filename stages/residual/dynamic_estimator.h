#pragma once
// The residual from paths that meet the edit: all techniques of [RP] §4 from all sites, joined by multiple importance
// sampling in each scene, and the two scenes joined by the same random numbers and by path mappings.

#include <optional>
#include <string>

#include "formats/image.h"
#include "stages/residual/effort/effort.h"
#include "stages/residual/estimators.h"

namespace loom::residual {

struct DynamicOptions {
    PathPairs::Options pairs;
    /// By a pilot, for what spp pairs of camera paths would cost: samples of each family and camera paths of each
    /// pixel; with fewer than least_spp camera paths alone, evenly. Else spp samples per pixel of each.
    bool pilot = false;
    bool adaptive_map = true;  // as PilotOptions
    double must_gain = PilotOptions().must_gain;
    /// With VarMean: also work out the new picture with it as control variate. Borrowed; null: not asked for.
    const Image* old_picture = nullptr;
    /// Only the paths that this family finds, for looking at one technique: not weighted, or weighted; never mapped.
    int only_family = -1;
    bool weighted = true;
};

/// The new picture with the old one as control variate, control.h; where there was a pilot, and camera paths alone.
struct ControlledPicture {
    Image image;                 // R, G, B and VarMean of the new picture, and the rest of the residual
    double old_variance = 1;     // what is left of the old picture's variance: sum alpha^2 V / sum V
    double var_mean = 0;         // of the edit's samples in it, mean over pixels and channels
    double least = 1, most = 1;  // weights
};

struct DynamicCounts {
    Counts counts;                    // nonfinite: paths whose contribution or density is not, which are left out
    std::uint64_t n_unrelocated = 0;  // samples of ghosts that a second look at their segment does not find
    double var_sample = 0;            // of one camera path's radiance in the new scene, mean over pixels and channels
    std::optional<ControlledPicture> controlled;  // only with an old picture
    std::string effort;                           // how it was spent and why, in one line; empty without a pilot
};

/// new minus old:  sum over samples of F_new(p) - F_old(q), F = f / sum_l n_l p_l in its own scene     [RP] Eq. (5),
/// (16)
/// out:     image  R, G, B signed, VarMean; Albedo, N, Depth of the new scene
/// needs:   roulette by albedo or none; spp of work >= 1
Image render_dynamic(const ScenePair& scenes, const Edit& edit, const DynamicOptions& options, const PathOptions& path,
                     const Work& work, app::Report& report, DynamicCounts& counts);

}  // namespace loom::residual
