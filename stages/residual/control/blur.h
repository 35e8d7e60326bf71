#pragma once
#include <vector>

#include "stages/core/scene/sensor.h"

namespace loom::residual {

/// Number of independent pixels of equal weight whose mean varies as much as that of blurred().
inline constexpr double blur_pixels = 50;

/// Returns the mean over surrounding pixels, weighted by a Gaussian with a standard deviation of 2 pixels; at the image
/// border over existing pixels only.
/// in: without_own  leave out the pixel itself, so that it is independent of the mean when pixels are; a single pixel
///     gives 0
std::vector<double> blurred(const Sensor& sensor, const std::vector<double>& values, bool without_own = false);

}  // namespace loom::residual
