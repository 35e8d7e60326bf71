#pragma once
// Captures around a corner: a sensor and a laser look at a relay wall, from which light goes on to what they do not
// see, and back. What the scene file says of it, and what follows before any path is traced.
//                                            conventions of mitransient 1.3                [Royo2022]

#include <cstdint>
#include <vector>

#include "stages/core/sampling/distribution.h"
#include "stages/core/scene/scene.h"

namespace loom {

/// The value is what `nlos/capture` of a path graph holds.
enum class CaptureType : std::uint8_t { single = 0, confocal = 1, exhaustive = 2 };

struct NlosCapture {
    struct Grid {
        std::uint32_t width = 0, height = 0;
        std::size_t size() const { return std::size_t(width) * height; }
    };
    /// What the ray of a sensor, or of the laser, meets.
    struct Point {
        Hit hit;  // of that ray; none: it meets nothing
        Ray ray;
        Point3f p;
        Normal3f ng;    // geometric
        Normal3f flat;  // of the triangle itself: ng before it was rounded
        float hit_error = 0;

        RayEnd end() const { return {p, ng, hit_error}; }
    };
    struct LaserPoint : Point {
        Framef beam;       // the projector's axes when it aims here
        bool lit = false;  // the first thing along the axis of the beam
    };

    CaptureType type = CaptureType::single;
    static constexpr std::uint32_t no_wall = ~0u;
    std::uint32_t relay_wall = no_wall;  // shape that the sensor scans; none: a camera looks at the scene
    Point3f sensor_origin;               // of a scan
    Grid sensor_grid, laser_grid;
    // of a scan, row by row of the wall's v, along its u: ((i + 1/2) / width, (j + 1/2) / height)
    std::vector<Point> sensor_points;
    std::vector<LaserPoint> laser_points;  // single: one; confocal: of each sensor point

    bool laser_sampling = false;   // a lit spot is a light; else the projector itself is
    bool discard_direct = false;   // no light that only one surface has reflected
    int filter_depth = -1;         // only paths of that many edges; -1: all
    float hidden_probability = 0;  // of sampling hidden geometry instead of the BSDF at a vertex
    int hidden_depth = -1;         // at this many first vertices only; -1: all

    /// Surfaces whose points are sampled, uniformly by area.
    struct Element {
        std::uint32_t shape, primitive;
    };
    std::vector<Element> hidden;
    Distribution1 hidden_pmf;     // by area
    double hidden_area = 0;       // m^2
    std::vector<bool> is_hidden;  // by shape

    /// Which points a pixel of the film is of.
    std::size_t sensor_point(std::uint64_t pixel) const {
        return type == CaptureType::exhaustive ? pixel / laser_points.size() : pixel;
    }
    std::size_t laser_point(std::uint64_t pixel) const {
        return type == CaptureType::single ? 0 : type == CaptureType::confocal ? pixel : pixel % laser_points.size();
    }
};

/// What a ray meets, ready to be lit.
NlosCapture::Point look(const Scene& scene, const Point3f& from, const Vector3f& d);

/// A point of the hidden geometry, uniform by area.
struct HiddenPoint {
    Point3f p;
    Normal3f n;  // geometric, of a sphere outward
    NlosCapture::Element element{};
};
HiddenPoint sample_hidden(const Scene& scene, Point2f u);

/// Density (sr^-1) with which sample_hidden(), seen from `from`, finds the point `at` as what is seen first in its
/// direction: points behind it count as failures, not as samples of this direction.
float pdf_hidden_w(const Scene& scene, const Point3f& from, const SurfacePoint& at);

class Object;

/// Fills scene.nlos, which needs all shapes, the emitter and the ray engine, from the file's integrator and sensor.
/// in:      wall        the shape that the sensor is nested in; null: the sensor is a camera
///          relay_wall  its number
/// throws:  InputError with the place
void build_nlos(const Object& root, const Object* wall, std::uint32_t relay_wall, Scene& scene);

}  // namespace loom
