#pragma once
// Positions on the film of points and curves in space, and their velocities there.

#include "stages/derive/boundary.h"

namespace loom::derive {

/// Projection onto the film in double precision, with its derivatives; equals Sensor::project().
class FilmMap {
  public:
    explicit FilmMap(const Sensor& sensor);

    /// Camera coordinates; z is the distance along the axis.
    Vector3<double> in_camera(const Point3<double>& p) const;
    Vector3<double> in_camera(const Vector3<double>& v) const;
    /// Film position of camera coordinates, pixels.
    Point2<double> film(const Vector3<double>& c) const;
    /// Velocity on the film of a point that moves by v in space, pixels.
    Point2<double> velocity(const Vector3<double>& c, const Vector3<double>& v) const;
    /// Change with the relative change of the field of view's tangent.
    Point2<double> lens_velocity(const Vector3<double>& c) const;
    bool perspective() const { return perspective_; }
    /// Returns the camera ray through a film position.
    Ray ray(const Sensor& sensor, const Point2<double>& film) const;
    /// At the middle of the film; orthographic: per metre.
    double pixels_per_radian() const { return width_ / (2 * scale_x_); }

  private:
    bool perspective_;
    Point3<double> origin_;
    std::array<Vector3<double>, 3> axes_, rows_;  // of the camera, and rows of their inverse
    double scale_x_, scale_y_, width_, height_, principal_x_, principal_y_;
};

}  // namespace loom::derive
