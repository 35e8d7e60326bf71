#include "stages/derive/film_map.h"

namespace loom::derive {

using Vec = Vector3<double>;
using Pt = Point3<double>;

FilmMap::FilmMap(const Sensor& s)
    : perspective_(s.kind == SensorKind::perspective),
      width_(s.width),
      height_(s.height),
      principal_x_(s.principal_x),
      principal_y_(s.principal_y) {
    const auto& m = s.world_from_camera;
    origin_ = {m[3], m[7], m[11]};
    const Vec x{m[0], m[4], m[8]}, y{m[1], m[5], m[9]}, z{m[2], m[6], m[10]};
    axes_ = {x, y, z};
    const double det = dot(x, cross(y, z));
    rows_ = {cross(y, z) / det, cross(z, x) / det, cross(x, y) / det};
    scale_x_ = perspective_ ? s.tan_half_fov_x : 1;
    scale_y_ = scale_x_ * height_ / width_;
}

Vec FilmMap::in_camera(const Vec& v) const {
    return {dot(rows_[0], v), dot(rows_[1], v), dot(rows_[2], v)};
}
Vec FilmMap::in_camera(const Pt& p) const {
    return in_camera(p - origin_);
}

Point2<double> FilmMap::film(const Vec& c) const {
    const double depth = perspective_ ? c.z : 1;
    return {(0.5 * (1 - c.x / (depth * scale_x_)) - principal_x_) * width_,
            (0.5 * (1 - c.y / (depth * scale_y_)) - principal_y_) * height_};
}

Point2<double> FilmMap::velocity(const Vec& c, const Vec& world) const {
    const Vec v = in_camera(world);
    const double depth = perspective_ ? c.z : 1, rate = perspective_ ? v.z : 0;
    return {-0.5 * width_ / scale_x_ * (v.x - c.x * rate / depth) / depth,
            -0.5 * height_ / scale_y_ * (v.y - c.y * rate / depth) / depth};
}

Point2<double> FilmMap::lens_velocity(const Vec& c) const {
    const double depth = perspective_ ? c.z : 1;
    return {0.5 * width_ / scale_x_ * c.x / depth, 0.5 * height_ / scale_y_ * c.y / depth};
}

Ray FilmMap::ray(const Sensor& sensor, const Point2<double>& film) const {
    const double x = (1 - 2 * (film.x / width_ + principal_x_)) * scale_x_,
                 y = (1 - 2 * (film.y / height_ + principal_y_)) * scale_y_;
    const Vec across = axes_[0] * x + axes_[1] * y;
    if (perspective_) {
        const Vec d = across + axes_[2];
        const double slant = length(d);
        return {Point3f(origin_), Vector3f(d / slant), float(sensor.near_clip * slant), float(sensor.far_clip * slant)};
    }
    const double unit = length(axes_[2]);
    return {Point3f(origin_ + across), Vector3f(axes_[2] / unit), float(sensor.near_clip * unit),
            float(sensor.far_clip * unit)};
}

}  // namespace loom::derive
