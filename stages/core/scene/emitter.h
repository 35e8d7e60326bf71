#pragma once
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "formats/path_graph.h"  // EmitterKind
#include "stages/core/math/frame.h"
#include "stages/core/math/vector.h"
#include "stages/core/sampling/distribution.h"
#include "stages/core/scene/ray.h"
#include "stages/core/sky/environment_map.h"

namespace loom {

struct Scene;
struct SurfacePoint;

struct Emitter {
    std::string id;
    EmitterKind kind = EmitterKind::area;
    float sampling_weight = 1;
    Spectrum radiance;              // area, constant: W m^-2 sr^-1; point, spot: intensity; directional: irradiance;
                                    // projector: irradiance of a plane at distance 1, over pi
    int texture = -1;               // area: factor on radiance by uv; spot, projector: by position in the beam
    std::uint32_t shape = 0;        // area
    double area = 0;                // area: m^2
    bool parallelogram = false;     // area on a rectangle: its two triangles are sampled as one
    Distribution1 triangles;        // area on a mesh: by area
    std::vector<Normal3f> normals;  // area on a mesh: geometric, by triangle
    Frame<float> frame;             // world from local; spot and directional shine along +z; envmap axes
    Point3f position;               // point, spot, projector
    float cutoff_rad = 0, beam_rad = 0;  // spot
    float tan_x = 0, tan_y = 0;          // projector: half the width and height of its beam at distance 1
    std::shared_ptr<EnvironmentMap> map;

    bool is_delta() const {
        return kind == EmitterKind::point || kind == EmitterKind::spot || kind == EmitterKind::directional ||
               kind == EmitterKind::projector;
    }
    bool is_infinite() const {
        return kind == EmitterKind::directional || kind == EmitterKind::constant || kind == EmitterKind::envmap;
    }
};

/// Irradiance of a plane at p that faces the projector, when its beam goes along z of `beam`.
///   pi irradiance r / z^3 within the beam: intensity pi irradiance / cos^3        [Mitsuba 3, "projector"]
Spectrum projected(const Scene& scene, const Emitter& projector, const Frame<float>& beam, const Point3f& p);
/// The projector's `radiance` with its texture at a point of the beam: x and y in units of half its width and height.
/// The image stands upright for who looks along the beam, as that of a camera in its place.
Spectrum beam_radiance(const Scene& scene, const Emitter& projector, float x, float y);

/// A light point seen from a surface point.
struct LightSample {
    Vector3f wi;          // unit, towards the light
    Spectrum Li;          // f_cos * Li / pdf_w estimates the reflected light
    float pdf_w = 0;      // sr^-1 with the choice of the emitter; a pmf for delta lights
    Point3f y;            // the light point; meaningless when at_infinity
    Normal3f n;           // its normal (area lights)
    float hit_error = 0;  // of its shape (area lights)
    bool at_infinity = false;
    bool delta = false;
    std::uint16_t emitter = 0;

    RayEnd end() const { return {y, n, hit_error}; }
};

/// A point on an emitter, or a direction towards one, chosen without a look at what it will light.
struct LightPoint {
    Spectrum Li;          // that it sends to the side of n
    Point3f y;            // or the direction towards it, when at_infinity
    Normal3f n;           // unit, of the side that shines; meaningless when at_infinity
    float hit_error = 0;  // of its shape
    float area = 1;       // y is uniform over it, m^2
    float pdf_w = 0;      // of a direction, sr^-1; meaningless for a point
    float pmf = 1;        // of its emitter
    bool at_infinity = false;
    std::uint16_t emitter = 0;
};

/// The light point as a surface point sees it.
inline LightSample seen_from(const LightPoint& point, const Point3f& from) {
    const Vector3f d = point.y - from;
    const float d2 = length2(d);
    const Vector3f towards = d / std::sqrt(d2);
    const float cos_light = -dot(point.n, towards);
    const float by_area = select(cos_light > 0, d2 / (cos_light * point.area), 0.0f);
    LightSample s;
    s.wi = select(point.at_infinity, Vector3f(point.y), towards);
    s.Li = point.Li;
    s.pdf_w = select(is_black(point.Li), 0.0f, select(point.at_infinity, point.pdf_w, by_area) * point.pmf);
    s.y = point.y;
    s.n = point.n;
    s.hit_error = point.hit_error;
    s.at_infinity = point.at_infinity;
    s.emitter = point.emitter;
    return s;
}

/// What a step of a path asks of the lights, whatever its surface is like: at a hit, an emitter by its weight and a
/// point on it; at a miss, what shines from infinity.
struct LightQuery {
    enum class Ask : std::uint8_t {
        nothing,
        point,
        environment
    } ask = Ask::point;  // at a hit point, at a miss environment
    Point2f u;           // of a hit; once an emitter is chosen, uniform again
    Vector3f d;          // of a miss: unit direction of the ray
    // out, for a hit
    LightPoint point;
    // false: which point, or what arrives from it, depends on what it lights (spheres, delta lights)
    bool placed = false;
    // out, for a miss
    Spectrum Le;
    float pdf_w = 0;  // sr^-1, with which a hit's query finds this direction
};
void look_up_light(const Scene& scene, LightQuery& query);
/// Many at once: the same values, but the tables of an environment map are waited for together.
void look_up_lights(const Scene& scene, std::span<LightQuery> queries);

/// The light of an answered query as seen from a point; pdf_w = 0 when nothing arrives.
LightSample sample_light(const Scene& scene, const Point3f& from, const LightQuery& query);
LightSample sample_light(const Scene& scene, const Point3f& from, Point2f u);

/// Density (sr^-1, choice of the emitter included) with which sample_light(from) finds the point `at` of an
/// area emitter.
float pdf_light_w(const Scene& scene, const Point3f& from, const SurfacePoint& at);

/// Density (sr^-1) with which sample_light finds the environment in direction d.
float pdf_environment_w(const Scene& scene, const Vector3f& d);

/// Radiance that an area emitter sends from `at` towards wo; black from behind.
Spectrum emitted(const Scene& scene, const SurfacePoint& at, const Vector3f& wo);

/// Radiance that arrives from direction d at infinity.
Spectrum environment(const Scene& scene, const Vector3f& d);

}  // namespace loom
