#pragma once
// Estimators of the difference of two pictures from pairs of paths, one in each scene.

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

enum class Method : std::uint8_t { automatic, correlated, independent, dynamic };

const char* method_name(Method method);

using loom::Counts;
using loom::Work;

/// Variance of one path of a pixel, summed over channels; a channel with values that are not finite is left out.
class PathVariance {
  public:
    void add(const Spectrum& L) {
        for (int c = 0; c < 3; ++c) L_[c].add(L[c]);
    }
    /// And begins the next pixel.
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

/// The seeds of the new and the old scene's paths. Never that of loom-trace: an old picture traced with the same
/// --seed would share its noise with the residual, and the variance of their sum would not be the sum of variances.
struct Seeds {
    std::uint64_t new_scene, old_scene;
};
Seeds seeds_of(Method method, std::uint64_t seed);

/// Mean difference of pairs of paths, new minus old.
///   delta_L = 1/n sum_i [L_new(u_i) - L_old(v_i)];  var_mean from the spread of the differences     [RP] §6
/// independent: v_i has nothing to do with u_i; var_mean is the sum of those of the two pictures.
/// correlated:  v_i = u_i, the random numbers by (seed, pixel, sample, bounce, place).
///   Joint: point on the film; at each bounce the numbers for light, direction, lobe and roulette. A path that meets
///   nothing of the edit is the same path in both scenes, its difference 0 to the last bit (but for ties of two
///   surfaces at one place). Roulette at a vertex is by its albedo alone, so that a path whose light changed survives
///   alike in both; where the albedos differ the one number is set against two thresholds, and one path may go on
///   alone. Not joint: directions and light points after the paths have parted: they are the same numbers, but at other
///   places. The choice among lights goes by their number: an added or removed light shifts it for all vertices. A lobe
///   that only one of two BSDFs has is sampled in that scene alone.
/// out:     image  R, G, B signed, VarMean of the differences, Albedo, N, Depth of the new scene; ledger: its link, but
///          for
///                 the edit's words and scene; its var_sample is from the new scene's paths
/// needs:   the film of the two scenes to have one size; method is not automatic
Image render_residual(const ScenePair& scenes, Method method, const PathOptions& path, const Work& work,
                      app::Report& report, Counts& counts);

}  // namespace loom::residual
