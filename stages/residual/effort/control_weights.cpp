#include "stages/residual/effort/control_weights.h"

#include "stages/residual/control/blur.h"
#include "stages/residual/control/controlled.h"

namespace loom::residual {

std::vector<Spectrum> control_weights(const Sensor& sensor, const Effort& effort, const Image& old_picture) {
    const char* const var_mean[] = {"VarMean.R", "VarMean.G", "VarMean.B"};
    std::vector<Spectrum> alpha(effort.per_pixel.size());
    for (int c = 0; c < 3; ++c) {
        const auto of_old = old_picture.find(var_mean[c]);
        const std::vector<double> V = blurred(sensor, {of_old.begin(), of_old.end()}, true);
        const std::vector<double> C = blurred(sensor, effort.covariance[c]),
                                  W = blurred(sensor, effort.old_variance[c]);
        for (std::size_t p = 0; p < alpha.size(); ++p) {
            const double n = effort.per_pixel[p];
            alpha[p][c] = float(best_control_weight(V[p], W[p] / n, (W[p] + C[p]) / n));
        }
    }
    return alpha;
}

}  // namespace loom::residual
