#pragma once
// How light samples of a sky are paired with those of the sky that replaces it.

#include <memory>
#include <string>

#include "stages/core/scene/scene.h"

namespace loom::residual {

/// Two skies, sampled with the same random numbers.
///   own     each by its own density. A sky that is turned has both directions at the same texel, and is always sampled so.
///   shared  one direction for both, by a density that neither misses: p = 1/2 |E_new - E_old| + 1/4 E_new + 1/4 E_old,
///           luminance by bilinear cells of the finer map, and a hundredth of their mean
/// [HY] §3.6 samples by |E_new - E_old| alone, which is 0 where an unequal surface may see equal skies, and noisier than a new
/// image where a sky is turned.
struct SkyPair {
    std::shared_ptr<const SkyProposals> shared;  // null: own has less variance, or the skies are equal but for a factor
    // Relative variance of one pair at a diffuse point that sees all of its hemisphere, mean over its orientations.
    double own_variance = 0, shared_variance = 0;

    std::string describe() const;  // in some words; empty where no sky was replaced
};

/// Chooses by the skies alone: no path has a part in it.
SkyPair find_sky_pair(const Scene& old_scene, const Scene& new_scene);

/// Returns the scene with light samples of its sky by another density.
std::shared_ptr<const Scene> with_proposals(const Scene& scene, std::shared_ptr<const SkyProposals> proposals);

}  // namespace loom::residual
