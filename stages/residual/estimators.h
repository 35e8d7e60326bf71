#pragma once
// Estimators of the difference of two images from pairs of paths, one in each scene.

#include <cmath>
#include <cstdint>

#include "formats/image.h"
#include "stages/core/edit/scene_pair.h"
#include "stages/core/stats/moments.h"
#include "stages/core/tracing/path_tracer.h"
#include "stages/core/tracing/pixel_loop.h"

namespace loom::app {
class Report;
}

namespace loom::residual {

class PartSums;

enum class Method : std::uint8_t { automatic, correlated, independent, dynamic };

const char* method_name(Method method);

using tracing::Counts;
using tracing::Work;

/// Variance of one path of a pixel, summed over channels; channels with non-finite values are left out.
class PathVariance {
  public:
    void add(const Spectrum& L) {
        for (int c = 0; c < 3; ++c) L_[c].add(L[c]);
    }
    /// Returns the variance and starts the next pixel.
    double take() {
        double sum = 0;
        for (Moments& m : L_) {
            if (std::isfinite(m.m2)) sum += m.var_sample();
            m = {};
        }
        return sum;
    }

  private:
    Moments L_[3];
};

/// Seeds of the new and the old scene's paths. They never equal the seed of loom-trace: an old image traced with the
/// same --seed would share its noise with the residual, and variances would not add up.
struct Seeds {
    std::uint64_t new_scene, old_scene;
};
Seeds seeds_of(Method method, std::uint64_t seed);

inline PathOptions with_seed(PathOptions path, std::uint64_t seed) {
    path.seed = seed;
    return path;
}

/// Renders the mean difference of pairs of paths, new minus old.
///   delta_L = 1/n sum_i [L_new(u_i) - L_old(v_i)];  var_mean from the spread of the differences     [RP] §6
/// independent: v_i is independent of u_i; var_mean is the sum of those of the two images.
/// correlated:  v_i = u_i, the random stream by (seed, pixel, sample, bounce, dimension).
///   Shared: point on the film; at each bounce samples for light, direction, lobe and roulette. A path that does not
///   touch the edit is the same in both scenes; its difference is 0 to the last bit (except for ties of coincident
///   surfaces). Roulette at a vertex depends on its albedo alone, so a path whose light changed survives equally in
///   both. Where the albedos differ, one sample is compared with two thresholds, and one path may continue alone.
///   Not shared: directions and light points after the paths have diverged. They use equal samples at different places.
///   The choice among lights is by index: an added or removed light shifts it for all vertices. A lobe of only one of
///   the two BSDFs is sampled in that scene alone.
/// out:     image  R, G, B signed, VarMean of the differences, Albedo, N, Depth of the new scene; ledger: its link,
///          without the edit's text and scene; its var_sample is from the new scene's paths
/// in, out: parts  null, or takes the parts of each pair; correlated only
/// needs:   equal film sizes of the two scenes; method is not automatic
Image render_residual(const ScenePair& scenes, Method method, const PathOptions& path, const Work& work,
                      app::Report& report, Counts& counts, PartSums* parts = nullptr);

}  // namespace loom::residual
