#pragma once
// Images of a scene whose static part comes from a radiance cache.                                   [HY] eq. (10)

#include <cstdint>

#include "formats/image.h"
#include "stages/core/cache/cache_reader.h"
#include "stages/core/edit/edit.h"
#include "stages/core/edit/scene_pair.h"
#include "stages/residual/estimators.h"

namespace loom::residual {

struct CachedOptions {
    /// Leave the cache and the old path out of camera samples that see something of the edit. False: the sum of the cache
    /// and the difference for all, to measure what that costs.
    bool masked = true;
};

struct CachedCounts {
    Counts counts;
    std::uint64_t samples = 0, masked = 0;  // camera samples, and those that see something of the edit
    std::uint64_t queries = 0, far = 0;     // of the cache, and those outside of what it was made of
    std::uint64_t untrusted = 0;            // those whose answer is not used: far, or of a material that it cannot tell
    std::uint64_t touched = 0;              // paths that were traced in both scenes
    std::uint64_t traced_on = 0;            // of render_corrected(): paths that a query did not end
    // Of the samples that the edit does not touch: cache minus path over path, mean over pixels and channels; and the root of
    // the mean product of two samples of a pixel, over the mean of paths: the error of the cache in the image.
    double bias = 0, error = 0;
};

/// Relative L2 on held-back vertices of a material from which on the cache is not used for it.
inline constexpr double largest_relative_l2 = 1;

/// Paths from the camera ray of a sample whose answer by the cache is not trusted.
inline constexpr std::size_t paths_for_cache = 4;

/// First vertex at which roulette may end a path of a pair: most of them are traced to find that the edit does not touch
/// them. From the fifth on, as a path tracer has it, they take 1.4 to 1.7 times as long for .74 to .97 of the error.
inline constexpr int first_roulette_of_pairs = 2;

/// Renders the new scene. For each camera sample,
///   L = M (L_cache - f_old) + f_new,   M = 0 where the sample sees something of the edit, else 1
/// f_old and f_new are paths of the same random numbers, f_old of the static scene with the same camera. L_cache is the
/// cache at the first surface that it covers: emission that is seen, and the sky, are exact; mirrors, glass and nearly
/// specular surfaces are followed by the path's own numbers, and what is seen of the edit through them counts as seen.
/// M = 0 as well, and L is the mean of `paths_for_cache` paths from the same camera ray, where the cache cannot be trusted: far from its points, and on materials with a validation above
/// largest_relative_l2. Where the edit does not touch a pair, only one path is traced, and f_new = f_old; without an edit
/// paths are traced for M = 0 alone.
/// out:     image  R, G, B, VarMean (from the spread of L; not the error of the cache), Albedo, N, Depth, and CacheError:
///                 what the cache adds to the image, times its relative error on held-back vertices of the material
/// needs:   cameras of both scenes equal; a cache of the old scene; roulette by albedo or none; work.spp >= 2
Image render_cached(const ScenePair& scenes, const Edit& edit, const CacheReader& cache, const CachedOptions& options,
                    const PathOptions& path, const Work& work, app::Report& report, CachedCounts& counts);

}  // namespace loom::residual
