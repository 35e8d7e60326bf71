#pragma once
// The old picture as a control variate of the new one.

#include <vector>

#include "formats/image.h"
#include "stages/residual/effort/effort.h"

namespace loom::residual {

/// Weight of the old picture in each pixel and channel.
///   new = alpha old + mean of (f_new - alpha f_old),  var = alpha^2 V + Var(f_new - alpha f_old) / n
/// is unbiased for any alpha that does not look at the samples that it weighs; with d = f_new - f_old, C = Cov(d,
/// f_old) and W = Var(f_old) of one pair, V that of the old picture, it is least at
///   alpha = 1 - beta,  beta = (V - C / n) / (V + W / n).
/// 1 is old plus residual, 0 a fresh picture: where paths of the two scenes have little in common the fresh one is
/// better. A light that grows brighter gives more than 1. Where nothing differs alpha is n_old / (n_old + n): the new
/// paths are more samples. C and W are those of the pilot, V that of the pixels around, so that no sample steers
/// itself; all are blurred. Of an old picture whose pixels share samples (path graphs, denoised) that is so only
/// nearly.
/// in:  effort  by a pilot
///      old_picture  with VarMean
std::vector<Spectrum> control_weights(const Sensor& sensor, const Effort& effort, const Image& old_picture);

}  // namespace loom::residual
