#pragma once
// Weights of the old image as a control variate, from a pilot.

#include <vector>

#include "formats/image.h"
#include "stages/residual/effort/effort.h"

namespace loom::residual {

/// Returns the weight alpha of the old image in each pixel and channel.
///   new = alpha old + mean of (f_new - alpha f_old),  var = alpha^2 V + Var(f_new - alpha f_old) / n
/// is unbiased for any alpha that is independent of the weighted samples. With d = f_new - f_old, C = Cov(d, f_old) and
/// W = Var(f_old) of one pair, and V the variance of the old image, the variance is least at
///   alpha = 1 - beta,  beta = (V - C / n) / (V + W / n).
/// alpha = 1 is old plus residual. alpha = 0 is a new image, which is better where paths of the two scenes have little
/// in common. A brighter light gives alpha above 1. Where nothing differs alpha is n_old / (n_old + n): the new paths
/// are additional samples. C and W are from the pilot, V from the surrounding pixels, so that no sample determines its
/// own weight; all are blurred. For an old image whose pixels share samples (path graphs, denoised) the independence is
/// only approximate.
/// in:  effort  from a pilot
///      old_picture  with VarMean
std::vector<Spectrum> control_weights(const Sensor& sensor, const Effort& effort, const Image& old_picture);

}  // namespace loom::residual
