#pragma once
#include <array>
#include <cstdint>
#include <string>

#include "stages/core/math/vector.h"

namespace loom {

struct Ray;

/// nlos_capture_meter: its rays are those of Scene::nlos, not of sample_ray().
enum class SensorKind : std::uint8_t { perspective, orthographic, nlos_capture_meter };
enum class Filter : std::uint8_t { box, tent, gaussian };

/// A camera and its film. A path belongs to one pixel: its film position is drawn from the pixel's
/// reconstruction filter (truncated at the border of the film), so pixels stay independent.
struct Sensor {
    SensorKind kind = SensorKind::perspective;
    std::uint32_t width = 768, height = 576;
    Filter filter = Filter::gaussian;
    float filter_radius = 2;                       // pixels
    float gaussian_stddev = 0.5f;                  // pixels
    std::array<double, 16> world_from_camera{1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1};  // row-major
    double tan_half_fov_x = 1;                     // perspective
    float principal_x = 0, principal_y = 0;        // offset of the optical axis, in film widths and heights
    double near_clip = 1e-2, far_clip = 1e4;       // m along the axis; only camera rays are clipped
    Point3f origin;                                // perspective: the pinhole

    std::uint64_t n_pixels() const { return std::uint64_t(width) * height; }
    /// Derived members; call once after the others are set.
    void prepare();
    /// Ray through pixel (x, y) at a film position that u chooses inside the pixel's filter.
    Ray sample_ray(std::uint32_t x, std::uint32_t y, Point2f u) const;

  private:
    /// Inverse of the filter's cumulative distribution, truncated to [low, high] pixels from the centre.
    float sample_offset(float u, float low, float high) const;

    std::array<Vector3f, 3> axes_;  // camera x, y, z in world space
    double scale_x_ = 1, scale_y_ = 1;  // orthographic half-extents
    std::array<float, 257> gaussian_cdf_{};
};

}  // namespace loom
