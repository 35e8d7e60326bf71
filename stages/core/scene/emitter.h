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
    int texture_idx = -1;           // area: factor on radiance by uv; spot, projector: by position in the beam
    std::uint32_t shape_idx = 0;    // area
    double area = 0;                // area: m^2
    bool parallelogram = false;     // area on a rectangle: its two triangles are sampled as one
    Distribution1 triangles;        // area on a mesh: by area
    std::vector<Normal3f> normals;  // area on a mesh: geometric, by triangle
    Frame<float> frame;             // world from local; spot and directional emit along +z; envmap axes
    Point3f position;               // point, spot, projector
    float cutoff_rad = 0, beam_rad = 0;  // spot
    float tan_x = 0, tan_y = 0;          // projector: half the width and height of its beam at distance 1
    std::shared_ptr<EnvironmentMap> map;
    std::shared_ptr<const SkyProposals> proposals;  // envmap, constant: of its light samples; null: its own density

    bool is_delta() const {
        return kind == EmitterKind::point || kind == EmitterKind::spot || kind == EmitterKind::directional ||
               kind == EmitterKind::projector;
    }
    bool is_infinite() const {
        return kind == EmitterKind::directional || kind == EmitterKind::constant || kind == EmitterKind::envmap;
    }
};

/// A light point and what a surface point receives from it.
template <class T>
struct LightSampleOf {
    Vector3<T> wi;        // unit, towards the light
    Rgb<T> Li;            // f_cos * Li / density() estimates the reflected light
    T pdf_w{};            // sr^-1, choice of the emitter included; 0 for delta lights
    T pmf{};              // of a delta light, choice of the emitter; 0 for any other
    Point3<T> y;          // light point; meaningless when at_infinity
    Normal3<T> n;         // normal at y (area lights)
    float hit_error = 0;  // Shape::hit_error, m (area lights)
    bool at_infinity = false;
    bool delta = false;
    std::uint16_t emitter_idx = 0;

    /// Density in the measure of the light: pdf_w or pmf.
    T density() const { return pdf_w + pmf; }
    RayEnd end() const requires std::is_same_v<T, float> { return {y, n, hit_error}; }
};
using LightSample = LightSampleOf<float>;

/// A point on an emitter, or a direction towards one, sampled independently of the surface point.
template <class T>
struct LightPointOf {
    Rgb<T> Li;            // emitted on the side of n
    Point3<T> y;          // or the direction towards the emitter, when at_infinity
    Normal3<T> n;         // unit, on the emitting side; meaningless when at_infinity
    float hit_error = 0;  // Shape::hit_error, m
    T area{1};            // m^2; y is uniform over it
    T pdf_w{};            // density of a direction, sr^-1; meaningless for a point
    float pmf = 1;        // probability of the emitter
    bool at_infinity = false;
    std::uint16_t emitter_idx = 0;
};
using LightPoint = LightPointOf<float>;

/// Returns the light sample at a surface point from a light point.
template <class T>
inline LightSampleOf<T> seen_from(const LightPointOf<T>& point, const Point3<T>& from) {
    using std::sqrt;
    const Vector3<T> d = point.y - from;
    const T d2 = length2(d);
    const Vector3<T> towards = d / sqrt(d2);
    const T cos_light = -dot(point.n, towards);
    const T by_area = select(cos_light > T(0), d2 / (cos_light * point.area), T(0));
    LightSampleOf<T> s;
    s.wi = select(point.at_infinity, Vector3<T>(point.y), towards);
    s.Li = point.Li;
    s.pdf_w = select(is_black(point.Li), T(0), select(point.at_infinity, point.pdf_w, by_area) * T(point.pmf));
    s.y = point.y;
    s.n = point.n;
    s.hit_error = point.hit_error;
    s.at_infinity = point.at_infinity;
    s.emitter_idx = point.emitter_idx;
    return s;
}

/// Samples a point of an area light, uniform by area, with its radiance.
/// out:     point  all but emitter_idx and pmf
void sample_area_point(const Scene& scene, const Emitter& e, Point2f u, LightPoint& point);

/// Light query of a path step, independent of its surface: at a hit, an emitter chosen by its weight and a point on it;
/// at a miss, the radiance from infinity.
struct LightQuery {
    enum class Kind : std::uint8_t {
        nothing,
        point,
        environment
    } kind = Kind::point;  // point at a hit, environment at a miss
    Point2f u;             // at a hit; uniform again once an emitter is chosen
    Vector3f d;            // at a miss: unit direction of the ray
    // out, at a hit
    LightPoint point;
    // false: the point, or its radiance, depends on the surface point (spheres, delta lights)
    bool placed = false;
    // out, at a miss
    Spectrum Le;
    float pdf_w = 0;  // sr^-1, with which a hit's query samples this direction
};
void look_up_light(const Scene& scene, LightQuery& query);
/// Runs look_up_light() for many queries, with overlapping cache misses of an environment map's tables.
void look_up_lights(const Scene& scene, std::span<LightQuery> queries);

/// Returns the light of a query at a point; pdf_w = 0 when no light arrives.
LightSample sample_light(const Scene& scene, const Point3f& from, const LightQuery& query);
LightSample sample_light(const Scene& scene, const Point3f& from, Point2f u);

/// Density (sr^-1, including the choice of the emitter) with which sample_light(from) samples the point `at` of an area
/// emitter.
float pdf_light_w(const Scene& scene, const Point3f& from, const SurfacePoint& at);

/// Density (sr^-1) with which sample_light samples the environment in direction d.
float pdf_environment_w(const Scene& scene, const Vector3f& d);

/// Radiance that an area emitter emits from `at` towards wo; zero on its back.
Spectrum emitted(const Scene& scene, const SurfacePoint& at, const Vector3f& wo);

/// Radiance that arrives from direction d at infinity.
Spectrum environment(const Scene& scene, const Vector3f& d);

}  // namespace loom
