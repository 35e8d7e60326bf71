#pragma once
#include <array>
#include <cstdint>
#include <optional>
#include <string>

#include "stages/core/math/vector.h"

namespace loom {

struct Ray;

/// Position of a point of space on the film.
struct FilmPoint {
    Point2f film;      // pixels from the upper left corner; outside of the film where no camera ray passes
    Point3f from;      // origin of the camera ray through the point
    Vector3f d;        // direction of that ray
    float t = 0;       // distance of the point along the ray, m
    float t_min = 0;   // distance of the near plane along the ray, m
    double scale = 0;  // film area over area perpendicular to the ray at the point, pixels^2 / m^2
};

/// nlos_capture_meter has the rays of Scene::nlos instead of sample_ray().
enum class SensorKind : std::uint8_t { perspective, orthographic, nlos_capture_meter };
enum class Filter : std::uint8_t { box, tent, gaussian };

/// A camera and its film. A path belongs to one pixel. Its film position is sampled from the pixel's reconstruction
/// filter (truncated at the border of the film), so pixels stay independent.
struct Sensor {
    SensorKind kind = SensorKind::perspective;
    std::uint32_t width = 768, height = 576;
    Filter filter = Filter::gaussian;
    float filter_radius = 2;                                                                   // pixels
    float gaussian_stddev = 0.5f;                                                              // pixels
    std::array<double, 16> world_from_camera{1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1};  // row-major
    double tan_half_fov_x = 1;                                                                 // perspective
    float principal_x = 0, principal_y = 0;   // offset of the optical axis, in film widths and heights
    double near_clip = 1e-2, far_clip = 1e4;  // m along the axis; only camera rays are clipped
    Point3f origin;                           // perspective: the pinhole

    std::uint64_t n_pixels() const { return std::uint64_t(width) * height; }
    /// Computes derived members; call once after the others are set.
    void prepare();
    /// Returns the ray through pixel (x, y) at a film position that u samples from the pixel's filter.
    Ray sample_ray(std::uint32_t x, std::uint32_t y, Point2f u) const;

    /// Returns nothing for a point in front of the near plane or beyond the far one.
    std::optional<FilmPoint> project(const Point3f& p) const;
    /// Returns the film position of a ray of sample_ray().
    FilmPoint film_of(const Ray& ray, float t) const;
    /// Density of the film positions of pixel (x, y), pixels^-2: the reconstruction filter from which sample_ray()
    /// samples.
    float filter_density(std::uint32_t x, std::uint32_t y, Point2f film) const;

  private:
    /// Inverse of the filter's cumulative distribution, truncated to [low, high] pixels from the centre.
    float sample_offset(float u, float low, float high) const;
    float offset_density(float x, float low, float high) const;
    /// Cumulative distribution of the Gaussian over its whole support; x within it.
    float gaussian_distribution(float x) const;

    std::array<Vector3f, 3> axes_;              // camera x, y, z in world space
    std::array<Vector3<double>, 3> film_axes_;  // rows of the inverse of axes_
    double cell_ = 1;                           // |det axes_| times the size of a pixel at distance 1, squared
    double scale_x_ = 1, scale_y_ = 1;          // orthographic half-extents
    std::array<float, 257> gaussian_cdf_{};
};

}  // namespace loom
