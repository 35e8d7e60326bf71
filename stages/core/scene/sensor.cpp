#include "stages/core/scene/sensor.h"

#include "stages/core/scene/scene.h"

namespace loom {

namespace {

float tent_distribution(float x, float radius) {
    const float s = 1 - std::abs(x) / radius;
    return x < 0 ? 0.5f * s * s : 1 - 0.5f * s * s;
}

}  // namespace

void Sensor::prepare() {
    const auto& m = world_from_camera;
    for (int k = 0; k < 3; ++k) axes_[k] = {float(m[k]), float(m[4 + k]), float(m[8 + k])};
    origin = {float(m[3]), float(m[7]), float(m[11])};
    const double aspect = double(width) / height;
    scale_x_ = kind == SensorKind::perspective ? tan_half_fov_x : 1.0;
    scale_y_ = scale_x_ / aspect;
    const Vector3<double> x(axes_[0]), y(axes_[1]), z(axes_[2]);
    const double det = dot(x, cross(y, z));
    film_axes_ = {cross(y, z) / det, cross(z, x) / det, cross(x, y) / det};
    cell_ = std::abs(det) * (2 * scale_x_ / width) * (2 * scale_y_ / height);
    if (filter == Filter::gaussian) {
        // Mitsuba's gaussian: shifted down so that it is 0 at the radius.
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

float Sensor::gaussian_distribution(float x) const {
    constexpr int cells = 256;
    const float s = clamp((x / filter_radius + 1) * 0.5f * cells, 0.0f, float(cells));
    const int i = std::min(int(s), cells - 1);
    return lerp(s - float(i), gaussian_cdf_[i], gaussian_cdf_[i + 1]);
}

float Sensor::sample_offset(float u, float low, float high) const {
    const float r = filter_radius;
    low = std::max(low, -r);
    high = std::min(high, r);
    switch (filter) {
        case Filter::box:
            return low + u * (high - low);
        case Filter::tent: {
            if (low == -r && high == r) return r * (u < 0.5f ? std::sqrt(2 * u) - 1 : 1 - std::sqrt(2 * (1 - u)));
            const float c = lerp(u, tent_distribution(low, r), tent_distribution(high, r));
            const float x = c < 0.5f ? r * (std::sqrt(2 * c) - 1) : r * (1 - std::sqrt(2 * (1 - c)));
            return clamp(x, low, high);
        }
        case Filter::gaussian: {
            constexpr int cells = 256;
            const float c = lerp(u, gaussian_distribution(low), gaussian_distribution(high));
            const auto above = std::upper_bound(gaussian_cdf_.begin(), gaussian_cdf_.end(), c);
            const int i = std::clamp(int(above - gaussian_cdf_.begin()) - 1, 0, cells - 1);
            const float s = float(i) + (c - gaussian_cdf_[i]) / (gaussian_cdf_[i + 1] - gaussian_cdf_[i]);
            return clamp((s / cells * 2 - 1) * r, low, high);
        }
    }
    return 0;
}

float Sensor::offset_density(float x, float low, float high) const {
    const float r = filter_radius;
    low = std::max(low, -r);
    high = std::min(high, r);
    if (!(x >= low && x <= high)) return 0;
    switch (filter) {
        case Filter::box:
            break;
        case Filter::tent:
            return (1 - std::abs(x) / r) / r / (tent_distribution(high, r) - tent_distribution(low, r));
        case Filter::gaussian: {
            constexpr int cells = 256;
            const int i = clamp(int((x / r + 1) * 0.5f * cells), 0, cells - 1);
            return (gaussian_cdf_[i + 1] - gaussian_cdf_[i]) * (cells / (2 * r)) /
                   (gaussian_distribution(high) - gaussian_distribution(low));
        }
    }
    return 1 / (high - low);
}

float Sensor::filter_density(std::uint32_t px, std::uint32_t py, Point2f film) const {
    const float cx = float(px) + 0.5f, cy = float(py) + 0.5f;
    // A box is not truncated at the border of the film.
    const bool box = filter == Filter::box;
    return offset_density(film.x - cx, box ? -filter_radius : -cx, box ? filter_radius : float(width) - cx) *
           offset_density(film.y - cy, box ? -filter_radius : -cy, box ? filter_radius : float(height) - cy);
}

std::optional<FilmPoint> Sensor::project(const Point3f& p) const {
    const Vector3<double> v(p - origin);
    const double a = dot(film_axes_[0], v), b = dot(film_axes_[1], v), c = dot(film_axes_[2], v);
    const double unit = length(Vector3<double>(axes_[2]));
    if (!(c > near_clip && c < far_clip)) return std::nullopt;
    const bool perspective = kind == SensorKind::perspective;
    const double x = perspective ? a / c : a, y = perspective ? b / c : b;
    FilmPoint at;
    at.film = {float((0.5 * (1 - x / scale_x_) - principal_x) * width),
               float((0.5 * (1 - y / scale_y_) - principal_y) * height)};
    if (perspective) {
        const double distance = length(v), slant = distance / c;
        at.from = origin;
        at.d = Vector3f(v / distance);
        at.t = float(distance);
        at.t_min = float(near_clip * slant);
        at.scale = slant * slant * slant / (cell_ * distance * distance);
    } else {
        at.from = p - axes_[2] * float(c);
        at.d = axes_[2] / float(unit);
        at.t = float(c * unit);
        at.t_min = float(near_clip * unit);
        at.scale = unit / cell_;
    }
    return at;
}

FilmPoint Sensor::film_of(const Ray& ray, float t) const {
    FilmPoint at = project(ray.o + ray.d * t).value_or(FilmPoint{});
    at.from = ray.o;
    at.d = ray.d;
    at.t = t;
    at.t_min = ray.t_min;
    return at;
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
