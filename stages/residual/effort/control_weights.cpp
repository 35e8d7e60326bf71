#include "stages/residual/effort/control_weights.h"

#include "stages/residual/effort/blur.h"

namespace loom::residual {

std::vector<Spectrum> control_weights(const Sensor& sensor, const Effort& effort, const Image& old_picture) {
    // Weights beyond are noise: where an emitter was almost off, a new image is better.
    constexpr double most = 64;
    const char* const var_mean[] = {"VarMean.R", "VarMean.G", "VarMean.B"};
    std::vector<Spectrum> alpha(effort.per_pixel.size());
    for (int c = 0; c < 3; ++c) {
        const auto of_old = old_picture.find(var_mean[c]);
        const std::vector<double> V = blurred(sensor, {of_old.begin(), of_old.end()}, true);
        const std::vector<double> C = blurred(sensor, effort.covariance[c]),
                                  W = blurred(sensor, effort.old_variance[c]);
        for (std::size_t p = 0; p < alpha.size(); ++p) {
            const double n = effort.per_pixel[p], of_pairs = V[p] + W[p] / n;
            alpha[p][c] = of_pairs > 0 ? float(clamp(1 - (V[p] - C[p] / n) / of_pairs, 0.0, most)) : 1.0f;
        }
    }
    return alpha;
}

}  // namespace loom::residual
