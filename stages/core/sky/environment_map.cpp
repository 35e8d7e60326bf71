#include "stages/core/sky/environment_map.h"

#include "stages/core/sampling/warp.h"

namespace loom {

Point2f EnvironmentMap::point(const Vector3f& d) {
    const float u = std::atan2(d.x, -d.z) / (2 * pi<float>);
    return {u - std::floor(u), std::acos(clamp(d.y, -1.0f, 1.0f)) * inv_pi<float>};
}

Vector3f EnvironmentMap::direction(Point2f uv) {
    const SinCos phi = sin_cos_turn(uv.x - std::floor(uv.x)), theta = sin_cos_turn(0.5f * uv.y);
    return {phi.sin * theta.sin, theta.cos, -phi.cos * theta.sin};
}

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
