#include "stages/core/scene/sensor.h"

#include "stages/core/scene/scene.h"

namespace loom {

void Sensor::prepare() {
    const auto& m = world_from_camera;
    for (int k = 0; k < 3; ++k) axes_[k] = {float(m[k]), float(m[4 + k]), float(m[8 + k])};
    origin = {float(m[3]), float(m[7]), float(m[11])};
    const double aspect = double(width) / height;
    scale_x_ = kind == SensorKind::perspective ? tan_half_fov_x : 1.0;
    scale_y_ = scale_x_ / aspect;
    if (filter == Filter::gaussian) {
        // Mitsuba's gaussian: shifted down so that it ends at 0 at the radius.
        const double alpha = -0.5 / (double(gaussian_stddev) * gaussian_stddev);
        const double r = filter_radius, floor = std::exp(alpha * r * r);
        double sum = 0;
        constexpr int cells = 256;
        for (int i = 0; i < cells; ++i) {
            const double x = ((i + 0.5) / cells * 2 - 1) * r;
            gaussian_cdf_[i] = float(sum);
            sum += std::exp(alpha * x * x) - floor;
        }
        gaussian_cdf_[cells] = float(sum);
        for (float& c : gaussian_cdf_) c = float(c / sum);
    }
}

float Sensor::sample_offset(float u, float low, float high) const {
    const float r = filter_radius;
    low = std::max(low, -r);
    high = std::min(high, r);
    switch (filter) {
        case Filter::box: return low + u * (high - low);
        case Filter::tent: {
            if (low == -r && high == r) return r * (u < 0.5f ? std::sqrt(2 * u) - 1 : 1 - std::sqrt(2 * (1 - u)));
            auto cdf = [&](float x) {
                const float s = 1 - std::abs(x) / r;
                return x < 0 ? 0.5f * s * s : 1 - 0.5f * s * s;
            };
            const float c = lerp(u, cdf(low), cdf(high));
            const float x = c < 0.5f ? r * (std::sqrt(2 * c) - 1) : r * (1 - std::sqrt(2 * (1 - c)));
            return clamp(x, low, high);
        }
        case Filter::gaussian: {
            constexpr int cells = 256;
            auto cdf = [&](float x) {
                const float s = clamp((x / r + 1) * 0.5f * cells, 0.0f, float(cells));
                const int i = std::min(int(s), cells - 1);
                return lerp(s - float(i), gaussian_cdf_[i], gaussian_cdf_[i + 1]);
            };
            const float c = lerp(u, cdf(low), cdf(high));
            const auto above = std::upper_bound(gaussian_cdf_.begin(), gaussian_cdf_.end(), c);
            const int i = std::clamp(int(above - gaussian_cdf_.begin()) - 1, 0, cells - 1);
            const float s = float(i) + (c - gaussian_cdf_[i]) / (gaussian_cdf_[i + 1] - gaussian_cdf_[i]);
            return clamp((s / cells * 2 - 1) * r, low, high);
        }
    }
    return 0;
}

Ray Sensor::sample_ray(std::uint32_t px, std::uint32_t py, Point2f u) const {
    const float cx = float(px) + 0.5f, cy = float(py) + 0.5f;
    float dx, dy;
    if (filter == Filter::box) {
        dx = (u.x - 0.5f) * 2 * filter_radius;
        dy = (u.y - 0.5f) * 2 * filter_radius;
    } else {
        dx = sample_offset(u.x, -cx, float(width) - cx);
        dy = sample_offset(u.y, -cy, float(height) - cy);
    }
    const double sx = (cx + dx) / width + principal_x, sy = (cy + dy) / height + principal_y;
    // The camera looks along +z, its x points to the left of the film.
    const float x = float((1 - 2 * sx) * scale_x_), y = float((1 - 2 * sy) * scale_y_);
    if (kind == SensorKind::perspective) {
        const Vector3f d = axes_[0] * x + axes_[1] * y + axes_[2];
        const float slant = length(d);
        return {origin, d / slant, float(near_clip) * slant, float(far_clip) * slant};
    }
    const float unit = length(axes_[2]);
    return {origin + axes_[0] * x + axes_[1] * y, axes_[2] / unit, float(near_clip) * unit, float(far_clip) * unit};
}

}  // namespace loom
