#include "stages/core/sky/environment_map.h"

namespace loom {

bool EnvironmentMap::prepare() {
    const int rows = std::max(height - 1, 1);
    std::vector<double> weights(std::size_t(width) * rows);
    for (int y = 0; y < rows; ++y) {
        const double sin_theta = std::sin((y + 0.5) / rows * pi_double);
        for (int x = 0; x < width; ++x) {
            double sum = 0;
            for (int corner = 0; corner < 4; ++corner) {
                const int i = (x + (corner & 1)) % width, j = std::min(y + (corner >> 1), height - 1);
                sum += luminance(texels[std::size_t(j) * width + i]);
            }
            weights[std::size_t(y) * width + x] = std::max(sum, 0.0) * sin_theta;
        }
    }
    if (std::all_of(weights.begin(), weights.end(), [](double w) { return w == 0; })) return false;
    density = Distribution2(weights, width, rows);
    return true;
}

}  // namespace loom
