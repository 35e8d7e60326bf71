#pragma once
// The old image as a control variate of the new one:  new = alpha old + mean of (f_new - alpha f_old), unbiased for any
// alpha that is independent of the samples.

#include <algorithm>
#include <array>
#include <cstdint>
#include <vector>

#include "formats/image.h"
#include "stages/core/math/vector.h"
#include "stages/core/scene/sensor.h"

namespace loom::residual {

/// Moments of what pairs of paths bring in the two scenes.
struct PairMoments {
    std::uint64_t n = 0;
    double before = 0, after = 0;                     // means
    double of_before = 0, of_after = 0, of_both = 0;  // sums of squares and products about them

    void add(double old_value, double new_value) {
        ++n;
        const double d_old = old_value - before, d_new = new_value - after;
        before += d_old / double(n), after += d_new / double(n);
        of_before += d_old * (old_value - before), of_after += d_new * (new_value - after);
        of_both += d_old * (new_value - after);
    }
    double mean(double alpha) const { return after - alpha * before; }
    /// Variance of the mean of f_new - alpha f_old.
    double var_mean(double alpha) const {
        const double sum = of_after - 2 * alpha * of_both + alpha * alpha * of_before;
        return n > 1 ? std::max(sum, 0.0) / (double(n) * double(n - 1)) : 0;
    }
};

/// Pairs of paths with the old image as control variate, [pixel].
struct ControlSums {
    std::vector<Spectrum> alpha;
    bool fits;  // fit() follows

    /// in:      fits       keep moments of all pixels
    ///          needs_all  the same without fit()
    explicit ControlSums(std::vector<Spectrum> weights, bool fits = false, bool needs_all = false);

    /// Returns the moments of a pixel's pairs, [rgb]; null where the residual says all: with weight 1.
    std::array<PairMoments, 3>* pairs(std::uint64_t pixel) {
        return slots_[pixel] == none ? nullptr : &pairs_[slots_[pixel]];
    }
    const std::array<PairMoments, 3>* pairs(std::uint64_t pixel) const {
        return slots_[pixel] == none ? nullptr : &pairs_[slots_[pixel]];
    }

    /// Multiplies each weight by the one of least variance that the surrounding pixels have in common:
    ///   alpha = C / (W (1 + n / n_old)),  C = Cov(f_new, f_old), W = Var(f_old) of a pair, W / n_old the old image's variance,
    /// and nearer to 1 where these say little. No pixel determines its own weight, so that the sum is unbiased where pixels
    /// are independent. (The old image's own VarMean, which a few bright samples make, would say less than n_old.)
    void fit(const Sensor& sensor, std::uint64_t old_samples);

  private:
    static constexpr std::uint32_t none = ~0u;
    std::vector<std::uint32_t> slots_;  // [pixel] in pairs_
    std::vector<std::array<PairMoments, 3>> pairs_;
};

/// Weight of the old image in  new = alpha old + mean of (f_new - alpha f_old)  of least variance.
/// in:      of_image  variance of the old image;  of_old, of_both  Var(f_old), Cov(f_new, f_old) of the mean of the pairs
double best_control_weight(double of_image, double of_old, double of_both);

/// The new image with the old one as control variate.
struct ControlledPicture {
    Image image;                 // R, G, B, VarMean of the new image, its Weight; the other layers of the residual
    double old_variance = 1;     // remaining share of the old image's variance: sum alpha^2 V / sum V
    double var_mean = 0;         // of the edit's samples, mean over pixels and channels
    double least = 1, most = 1;  // smallest and largest weight
};

class SeenEmission;
/// in:      seen  emission that the pairs lack, and the residual has; null: none
ControlledPicture controlled_picture(const Image& old_picture, const Image& residual, const ControlSums& control,
                                     const SeenEmission* seen = nullptr);

}  // namespace loom::residual
