#pragma once
// Pairs of paths where the difference is noisy: on top of those of a graph, or alone and less than one per pixel.

#include <array>
#include <functional>
#include <memory>
#include <span>
#include <vector>

#include "formats/image.h"
#include "stages/core/tracing/pixel_loop.h"
#include "stages/residual/control/controlled.h"
#include "stages/residual/dynamic/dynamic_scene.h"
#include "stages/residual/effort/pair_counts.h"

namespace loom::residual {

/// What one pair of paths brings in the two scenes.
struct PairValue {
    Spectrum before, after;
};

/// Traces pairs of paths. State of one thread.
class PairTracer {
  public:
    virtual ~PairTracer() = default;
    /// in:      ids     at most PathBatch::capacity
    /// out:     values  of the same length
    virtual void trace(std::span<const PathId> ids, std::span<PairValue> values) = 0;

    tracing::Counts counts;
};
using MakeTracer = std::function<std::unique_ptr<PairTracer>()>;

/// Returns tracers of camera paths with the same random numbers in both scenes. Borrows the scenes.
MakeTracer camera_pairs(const DynamicScenes& scenes, const PathOptions& path);

/// Moments of the pairs of each pixel, by channel.
using PairSums = std::vector<std::array<PairMoments, 3>>;

/// Traces `pairs[p]` pairs of each pixel p, with sample indices from `first` on.
/// in, out: counts  rays and vertices are added
PairSums trace_pairs(const Sensor& sensor, const std::vector<std::uint32_t>& pairs, std::uint64_t first,
                     const MakeTracer& make, int threads, app::Report& report, tracing::Counts& counts);

/// Pools two sets of pairs.
PairMoments pooled(const PairMoments& a, const PairMoments& b);

/// Variance of one pair of each pixel, summed over channels: of f_new - alpha f_old where `control` has the pairs, else of
/// the residual.
/// in:      samples  per pixel of the residual
///          control  null: none
std::vector<double> variances_of_pairs(const Image& residual, std::uint64_t samples, const ControlSums* control);

/// Adds pairs to a residual of `samples` pairs per pixel, and to the control's where it has any: means over all pairs of a
/// pixel. Unbiased where their number is independent of the pixel's own samples.
/// in, out: residual  R, G, B, VarMean; link's var_mean
void add_pairs(const PairSums& pairs, std::uint64_t samples, Image& residual, ControlSums* control);

/// A mean and its variance.
struct Estimated {
    double mean = 0, var_mean = 0;
};

/// Pairs of paths without a graph, `mean` per pixel, also fewer than one: one for each pixel where old paths have a weight
/// below 1; of the others three quarters evenly, and the rest by what these find in the pixels around.
///
/// Pixel p has a pair with probability s_p < 1; its estimate is the sum over its pairs divided by s_p, the number before
/// rounding. Where at least one pair is certain it is their mean.                                  [HY] Eq. (7) to (9)
/// differs: [HY] takes the map from the frame before. Here a frame has a map of its own, so that it is the same alone and
/// among others, follows what moves at once, and no frame goes without samples because the one before has found nothing
struct SparsePairs {
    PairSums sums;
    std::vector<double> expected;  // [pixel] number of pairs before rounding
    std::vector<bool> certain;     // [pixel] whether it has a pair whatever the rounding
    double mean = 0;               // pairs per pixel in fact

    /// Estimate of the mean of f_new - alpha f_old. Its variance is too large by at most the square of the mean over the number
    /// of pairs where that is below two.
    Estimated of(std::size_t pixel, int channel, double alpha) const;
};
struct SparseOptions {
    double mean = 0.25;  // pairs per pixel
    bool even = false;   // all pairs evenly
    std::uint64_t seed = 0;
    int threads = 0;
};
SparsePairs trace_sparse_pairs(const Sensor& sensor, const std::vector<Spectrum>& alpha, const SparseOptions& options,
                               const MakeTracer& make, app::Report& report, tracing::Counts& counts);

}  // namespace loom::residual
