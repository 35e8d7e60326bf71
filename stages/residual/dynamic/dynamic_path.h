#pragma once
// A whole path from the sensor to a light, its contribution, and the density of each technique that can sample it.
//
// Vertices are numbered from the sensor: v_0 on it, v_1 ... v_m on surfaces, v_{m+1} on a light. A path is
// parameterised by the film position of its camera ray and the directions from v_1 ... v_m towards the light, so that
//   f_pixel = h_pixel(film) F,   F = prod_i f_cos_i(v_{i-1}; v_{i+1}) Le        h: reconstruction filter, pixels^-2
// and all densities have the same measure, pixels^-2 sr^-m. Area densities are converted by
//   dA(v_{i+1}) = d_omega_i distance^2 / cos(v_{i+1}),   dA(v_1) = d_film / (scale cos(v_1)).
//
// Let pL_i, pS_i be the densities (sr^-1, roulette included) of the direction at v_i towards the light and the sensor.
//   S_1 = 1 / (scale cos(v_1)),   S_i = S_{i-1} pS_i cos_{i-1}(v_i) / cos_i(v_{i-1})          sensor prefix
//   E_m = p_light(v_{m+1} | v_m), E_i = pL_i E_{i+1}                                          emitter prefix
// Each technique then costs O(1) per dynamic vertex or ghost crossing:                        [RP] §4.3
//   1  dynamic from emitter   v_m dynamic            p_A S_m E_m                              [RP] Eq. (8)
//   2  dynamic from sensor    v_1 dynamic, m > 1     p_A S_1 E_1                              [RP] Eq. (9)
//   3  dynamic two ends       v_j, 1 < j < m         p_A S_j p_cos(omega_j) E_{j+1}           [RP] Eq. (10)
//   4  ghost from emitter     x_G on the light edge  p_A p_light(v_{m+1} | x_G) cos(v_m)/cos(x_G) S_m
//                                                                                             [RP] Eq. (11), (12)
//   5  ghost from sensor      on the sensor edge     p_A / (scale cos)(x_G) E_1               [RP] Eq. (13)
//   6  ghost two ends         between v_i, v_{i+1}   p_A / (2 pi) cos(v_i) S_i E_{i+1}        [RP] Eq. (14), (15)
//   7  path tracing           h_pixel E_1 by next-event estimation, h_pixel pL_1 ... pL_m by hitting the light
// differs: one technique per interior dynamic vertex, by its position, and one per crossing; path tracing counts twice.
//          Technique 6 samples its direction by |cos| / (2 pi) at the ghost, as the geometry term of Eq. (14) requires.
//          At a perfectly specular vertex pS includes the ratio of the projected solid angles, so that one measure
//          serves both directions.

#include <array>
#include <vector>

#include "stages/core/tracing/vertex_rules.h"
#include "stages/residual/dynamic/dynamic_scene.h"

namespace loom::residual {

using Radiance = Rgb<double>;

enum class Technique : std::uint8_t {
    dynamic_from_emitter = 1,
    dynamic_from_sensor = 2,
    dynamic_two_ends = 3,
    ghost_from_emitter = 4,
    ghost_from_sensor = 5,
    ghost_two_ends = 6,
    path_tracing = 7
};
inline constexpr int n_techniques = 7;
inline Start start_of(Technique technique) {
    return technique <= Technique::dynamic_two_ends ? Start::scattering : Start::passing;
}

/// Number of samples of each technique from each site in one scene. Camera paths are counted elsewhere: their densities
/// are those of one path per pixel.
struct SampleCounts {
    struct FromSite {
        double n = 0;             // of the whole image
        std::uint8_t family = 0;  // index of the family
    };
    std::array<std::array<FromSite, n_sites>, n_techniques> from_site{};  // [technique - 1]; path tracing (7) is unused
    bool first_to_camera = false;  // camera paths alone take paths with the edit at first
    FromSite& of(Technique technique, Site site) { return from_site[std::size_t(technique) - 1][std::size_t(site)]; }
    const FromSite& of(Technique technique, Site site) const {
        return from_site[std::size_t(technique) - 1][std::size_t(site)];
    }
};

/// Scattering at a vertex between its two neighbours; both directions are unit and point away from the vertex.
struct Interaction {
    Radiance f_cos;  // sr^-1, of light that leaves towards the sensor; a specular lobe: its value
    // Density of the direction towards the light given the other direction, and its roulette survival, which depends on
    // the albedo viewed from the other direction.
    double pdf_light = 0, q_light = 1;
    double pdf_sensor = 0, q_sensor = 1;  // density and survival of the direction towards the sensor
    double pdf_cosine = 0;                // density of the direction towards the light by technique 3
    bool specular = false;
    std::uint8_t site = no_site;
};

/// A segment between two vertices.
struct Segment {
    // |cos| of the geometric normals at its two ends; 1 on the sensor and on lights.
    float cos_sensor = 1, cos_light = 1;
    std::uint32_t first = 0, n = 0;  // its ghost crossings
};

struct SensorEnd {
    Point2f film;
    double scale = 0;  // pixels^2 / m^2 of area perpendicular to the ray at v_1
};

struct LightEnd {
    Radiance Le;
    Point3f y;  // or the direction towards it
    Normal3f n;
    float hit_error = 0;  // Shape::hit_error, m
    double pdf = 0;       // of next-event estimation from v_m, sr^-1 or a pmf; 0: it cannot sample this light
    std::uint16_t emitter = 0;
    bool at_infinity = false, delta = false, changed = false;

    RayEnd end() const { return {y, n, hit_error}; }
};

/// A path as alternating segments and vertices, from the sensor.
struct FullPath {
    SensorEnd sensor;
    LightEnd light;
    std::vector<Interaction> vertices;  // v_1 ... v_m
    std::vector<const Vertex*> places;  // surface points of v_1 ... v_m
    std::vector<Segment> segments;      // m + 1 segments
    const std::vector<Crossing>* crossings = nullptr;

    std::size_t m() const { return vertices.size(); }
    /// Whether the edit can change the path; else its difference is 0.
    bool dynamic() const;
    /// Whether the edit is on the first segment or vertex, so that it is directly visible to the camera.
    bool dynamic_at_first() const { return segments[0].n > 0 || (m() > 0 && vertices[0].site != no_site); }

    void start(const SensorEnd& from, const Segment& ahead) {
        sensor = from;
        vertices.clear();
        places.clear();
        segments.assign(1, ahead);
    }
    void add(const Interaction& x, const Vertex& place, const Segment& ahead) {
        vertices.push_back(x);
        places.push_back(&place);
        segments.push_back(ahead);
    }
    void remove_last() {
        vertices.pop_back();
        places.pop_back();
        segments.pop_back();
    }
};

/// Make segments of a scene; their ghost crossings are appended.
Segment segment_between(const DynamicScene& side, const Vertex& sensor_side, const Vertex& light_side,
                        Crossings& crossings);
Segment segment_to_light(const DynamicScene& side, const Vertex& v, const LightEnd& light, Crossings& crossings);
Vector3f direction_to(const LightEnd& light, const Point3f& from);
/// Returns the ray that tests visibility between a vertex and a light.
Ray shadow_ray(const Vertex& v, const LightEnd& light);

/// One technique that can sample a path: expected number of samples per measure of the path.
struct Term {
    Technique technique;
    std::uint32_t place;      // index of the vertex (from 1), or of the crossing
    double density;           // samples of the whole image times density; for path tracing per h_pixel
    std::uint8_t family = 0;  // of SampleCounts; 0 for path tracing
};

struct Evaluation {
    Radiance F;
    double site_density = 0;    // sum over techniques 1 to 6
    double camera_density = 0;  // path tracing by both strategies, per h_pixel and per camera path of the pixel
    double nee_density = 0;     // the part of camera_density from next-event estimation
};

/// Returns the density of next-event estimation from a point for the light point of a path.
double light_pdf(const Scene& scene, const LightEnd& light, const Point3f& from);

/// Evaluates a path; all results are 0 for a path that is not dynamic.
/// in:      terms  null, or receives each technique's density, in the order of places
Evaluation evaluate(const DynamicScenes& scenes, const DynamicScene& side, const SampleCounts& counts,
                    const PathOptions& options, const FullPath& path, std::vector<Term>* terms);

/// Returns the density of technique 3's direction towards the light: cosine, on the reflecting side or sides.
double pdf_towards_light(const ShadingPoint& here, const Vector3f& towards_light);
bool scatters_on_both_sides(const Scene& scene, const ShadingPoint& here, const Vertex& vertex);

/// in:      lobe  sampled lobe that joined the directions; Lobe::none for directions joined without sampling
Interaction interact(const DynamicScene& side, const Vertex& vertex, const Vector3f& to_sensor,
                     const Vector3f& to_light, Lobe lobe);

}  // namespace loom::residual
