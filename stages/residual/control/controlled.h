#pragma once
// The old image as a control variate of the new one:  new = alpha old + mean of (f_new - alpha f_old), unbiased for any
// alpha that is independent of the samples.

#include <vector>

#include "formats/image.h"
#include "stages/core/math/vector.h"

namespace loom::residual {

/// Pairs of paths with the old image as control variate: moments of f_new - alpha f_old, [pixel].
struct ControlSums {
    std::vector<Spectrum> alpha, mean, var_mean;

    explicit ControlSums(std::vector<Spectrum> weights)
        : alpha(std::move(weights)), mean(alpha.size()), var_mean(alpha.size()) {}
};

/// The new image with the old one as control variate.
struct ControlledPicture {
    Image image;                 // R, G, B and VarMean of the new image; the other layers of the residual
    double old_variance = 1;     // remaining share of the old image's variance: sum alpha^2 V / sum V
    double var_mean = 0;         // of the edit's samples, mean over pixels and channels
    double least = 1, most = 1;  // smallest and largest weight
};

ControlledPicture controlled_picture(const Image& old_picture, const Image& residual, const ControlSums& control);

}  // namespace loom::residual
