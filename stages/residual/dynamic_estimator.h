#pragma once
// The residual from paths that meet the edit: all techniques of [RP] §4 from all sites, joined by multiple importance
// sampling in each scene, and the two scenes joined by the same random numbers and by path mappings.

#include <string>

#include "formats/image.h"
#include "stages/residual/estimators.h"
#include "stages/residual/path_mapper.h"

namespace loom::residual {

/// A technique in each scene, fed with the same random numbers: what is dynamic in one may be a ghost in the other.
struct Family {
    const char* name;
    Technique in_new, in_old;
    Site site_new, site_old;
};

/// The families that an edit calls for, path tracing last. No ghosts without something that moves.
std::vector<Family> families_of(const DynamicScenes& scenes);

struct DynamicOptions {
    bool mapping = true;
    MappingLimits limits;
    /// Samples per pixel of each family over --spp; those that are missing: 1.
    std::vector<double> shares;
    /// Only the paths that this family finds, for looking at one technique: not weighted, or weighted.
    int only_family = -1;
    bool weighted = true;
};

struct DynamicCounts {
    Counts counts;                    // nonfinite: paths whose contribution or density is not, which are left out
    std::uint64_t n_unrelocated = 0;  // samples of ghosts that a second look at their segment does not find
};

/// new minus old:  sum over samples of F_new(p) - F_old(q), F = f / sum_l n_l p_l in its own scene     [RP] Eq. (5), (16)
/// A pair by the same random numbers adds both as they are. A path p of one scene that is mapped to q of the other adds
///   omega (F(p) - rho F(q)),  rho = p_q |T'| / p_p,  omega = 1 / (1 + rho)
/// and the samples of the other scene do the same, so that together they cover both; where the mapping is rejected,
/// omega is 1 and the partner is left to the other scene's samples.
/// differs: each term has the weight of its own scene, and pairs have weights of their own: as printed, both are biased
/// out:     image  R, G, B signed, VarMean; Albedo, N, Depth of the new scene
/// needs:   roulette by albedo or none; spp of work >= 1
Image render_dynamic(const ScenePair& scenes, const Edit& edit, const DynamicOptions& options, const PathOptions& path, const Work& work, app::Report& report,
                     DynamicCounts& counts);

}  // namespace loom::residual
