#pragma once
// NLOS captures: sensor and laser look at a relay wall, from which light reaches hidden surfaces and returns. The
// parameters of the scene file, and what is computed before any path is traced.
//                                            conventions of mitransient 1.3                [Royo2022]

#include <cstdint>
#include <vector>

#include "stages/core/sampling/distribution.h"
#include "stages/core/scene/emitter.h"
#include "stages/core/scene/scene.h"

namespace loom {

/// The value is stored in `nlos/capture` of a path graph.
enum class CaptureType : std::uint8_t { single = 0, confocal = 1, exhaustive = 2 };

struct NlosCapture {
    struct Grid {
        std::uint32_t width = 0, height = 0;
        std::size_t size() const { return std::size_t(width) * height; }
    };
    /// First hit of the ray of a sensor, or of the laser.
    struct Point {
        Hit hit;  // hit of that ray; none: it misses
        Ray ray;
        Point3f p;
        Normal3f ng;    // geometric
        Normal3f flat;  // of the triangle itself: ng before rounding
        float hit_error = 0;

        RayEnd end() const { return {p, ng, hit_error}; }
    };
    struct LaserPoint : Point {
        Framef beam;       // the projector's axes when aimed at this point
        bool lit = false;  // the point is the first hit along the axis of the beam
    };

    CaptureType type = CaptureType::single;
    static constexpr std::uint32_t no_wall = ~0u;
    std::uint32_t relay_wall = no_wall;  // shape that the sensor scans; none: the sensor is a camera
    Point3f sensor_origin;               // with a relay wall
    Grid sensor_grid, laser_grid;
    // with a relay wall: row by row along its v, in each row along its u: ((i + 1/2) / width, (j + 1/2) / height)
    std::vector<Point> sensor_points;
    std::vector<LaserPoint> laser_points;  // single: one; confocal: one per sensor point

    bool laser_sampling = false;   // the laser spot is sampled as an emitter; else the projector itself
    bool discard_direct = false;   // omit light that only one surface has reflected
    int filter_depth = -1;         // only paths of this many edges; -1: all
    float hidden_probability = 0;  // probability of sampling hidden geometry instead of the BSDF at a vertex
    int hidden_depth = -1;         // only at this many first vertices; -1: all

    /// A primitive whose points are sampled, uniformly by area.
    struct Element {
        std::uint32_t shape, primitive;
    };
    std::vector<Element> hidden;
    Distribution1 hidden_pmf;     // by area
    double hidden_area = 0;       // m^2
    std::vector<bool> is_hidden;  // [shape]

    /// Returns the sensor point, or the laser point, of a pixel of the film.
    std::size_t sensor_point(std::uint64_t pixel) const {
        return type == CaptureType::exhaustive ? pixel / laser_points.size() : pixel;
    }
    std::size_t laser_point(std::uint64_t pixel) const {
        return type == CaptureType::single ? 0 : type == CaptureType::confocal ? pixel : pixel % laser_points.size();
    }
};

/// Returns the first hit along a direction.
NlosCapture::Point look(const Scene& scene, const Point3f& from, const Vector3f& d);

/// A point of a surface that the laser lights, as a light of its own.
struct LitSpot {
    NlosCapture::Point point;
    Spectrum power;  // irradiance times area
    bool is_lit = false;
};
/// in:      true_area  whether a point of the beam's section is drawn by u; else the laser point with an area of 1 m^2
LitSpot lit_spot(const Scene& scene, const NlosCapture::LaserPoint& laser, bool true_area, Point2f u);
/// Sets the light of a spot as a point receives it: Li = f_l cos_laser E A cos_l / r^2.
/// out:     light  wi, y, n and Li; returns whether the point lies outside of the spot's plane
bool see_spot(const Scene& scene, const LitSpot& spot, const Point3f& from, LightSample& light);

/// A point of the hidden geometry, uniform by area.
struct HiddenPoint {
    Point3f p;
    Normal3f n;  // geometric; outward on a sphere
    NlosCapture::Element element{};
};
HiddenPoint sample_hidden(const Scene& scene, Point2f u);

/// Density (sr^-1) with which sample_hidden() samples the point `at` as the first hit in its direction from `from`.
/// Points behind it count as failures, not as samples of this direction.
float pdf_hidden_w(const Scene& scene, const Point3f& from, const SurfacePoint& at);

class Object;

/// Fills scene.nlos from the file's integrator and sensor.
/// in:      wall        the shape that contains the sensor; null: the sensor is a camera
///          relay_wall  its index
/// needs:   all shapes, the emitter and the ray engine of `scene`
/// throws:  InputError with the location
void build_nlos(const Object& root, const Object* wall, std::uint32_t relay_wall, Scene& scene);

}  // namespace loom
