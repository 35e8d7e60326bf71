#pragma once
#include <vector>

#include "stages/core/scene/sensor.h"

namespace loom::residual {

/// Mean over the pixels around, by a Gaussian of 2 pixels' deviation; at the edges of the picture over those that there
/// are.
/// in: without_own  the pixel itself left out, so that it is independent of the mean when pixels are; alone it is 0
std::vector<double> blurred(const Sensor& sensor, const std::vector<double>& values, bool without_own = false);

}  // namespace loom::residual
