#pragma once
// A whole path from the sensor to a light, what it contributes, and with which densities each technique finds it.
//
// Vertices are numbered from the sensor: v_0 on it, v_1 ... v_m on surfaces, v_{m+1} on a light. A path is written by
// the film position of its camera ray and the directions from v_1 ... v_m towards the light, so that
//   f_pixel = h_pixel(film) F,   F = prod_i f_cos_i(v_{i-1}; v_{i+1}) Le        h: reconstruction filter, pixels^-2
// and all densities are by the same measure, pixels^-2 sr^-m. What a technique samples by area is brought to it by
//   dA(v_{i+1}) = d_omega_i distance^2 / cos(v_{i+1}),   dA(v_1) = d_film / (scale cos(v_1)).
//
// With pL_i, pS_i the densities (sr^-1, roulette folded in) of the direction at v_i towards the light and the sensor,
//   S_1 = 1 / (scale cos(v_1)),   S_i = S_{i-1} pS_i cos_{i-1}(v_i) / cos_i(v_{i-1})          sensor prefix
//   E_m = p_light(v_{m+1} | v_m), E_i = pL_i E_{i+1}                                          emitter prefix
// each technique costs O(1) per dynamic vertex or ghost crossing:                             [RP] §4.3
//   1  dynamic from emitter   v_m dynamic            p_A S_m E_m                              [RP] Eq. (8)
//   2  dynamic from sensor    v_1 dynamic, m > 1     p_A S_1 E_1                              [RP] Eq. (9)
//   3  dynamic two ends       v_j, 1 < j < m         p_A S_j p_cos(omega_j) E_{j+1}           [RP] Eq. (10)
//   4  ghost from emitter     x_G on the light edge  p_A p_light(v_{m+1} | x_G) cos(v_m)/cos(x_G) S_m     [RP] Eq.
//      (11), (12)
//   5  ghost from sensor      on the sensor edge     p_A / (scale cos)(x_G) E_1               [RP] Eq. (13)
//   6  ghost two ends         between v_i, v_{i+1}   p_A / (2 pi) cos(v_i) S_i E_{i+1}        [RP] Eq. (14), (15)
//   7  path tracing           h_pixel E_1 by next-event estimation, h_pixel pL_1 ... pL_m by hitting the light
// differs: one technique per interior dynamic vertex, by its place, and one per crossing; path tracing counts twice;
//          6 samples its direction by |cos| / (2 pi) at the ghost, which the geometry term of Eq. (14) asks for; at a
//          perfectly specular vertex pS carries the ratio of the projected solid angles, so that one measure does for
//          both ways.

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

/// How many samples each technique takes from each site in one scene. Camera paths are counted elsewhere: their
/// densities are those of one path per pixel.
struct SampleCounts {
    struct FromSite {
        double n = 0;             // of the whole picture
        std::uint8_t family = 0;  // a name for it
    };
    std::array<std::array<FromSite, n_sites>, n_techniques> from_site{};  // by technique - 1; 7: unused
    bool first_to_camera = false;  // paths that the edit meets at first are left to camera paths alone
    FromSite& of(Technique technique, Site site) { return from_site[std::size_t(technique) - 1][std::size_t(site)]; }
    const FromSite& of(Technique technique, Site site) const {
        return from_site[std::size_t(technique) - 1][std::size_t(site)];
    }
};

/// Light that scatters at a vertex from one neighbour to the other; both directions are unit and lead away.
struct Interaction {
    Radiance f_cos;  // sr^-1, of light that leaves towards the sensor; a specular lobe: its value
    double pdf_light = 0,
           // of the direction towards the light given the other; roulette by the albedo seen from the other
        q_light = 1;
    double pdf_sensor = 0, q_sensor = 1;  // the other way
    double pdf_cosine = 0;                // of the direction towards the light by technique 3
    bool specular = false;
    std::uint8_t site = no_site;
};

/// A segment between two vertices.
struct Segment {
    float cos_sensor = 1,
          cos_light = 1;             // |cos| of the geometric normals at its two ends; 1 on the sensor, and on lights
    std::uint32_t first = 0, n = 0;  // its ghost crossings
};

struct SensorEnd {
    Point2f film;
    double scale = 0;  // pixels^2 / m^2 of area at right angles to the ray at v_1
};

struct LightEnd {
    Radiance Le;
    Point3f y;  // or the direction towards it
    Normal3f n;
    float hit_error = 0;  // of its shape
    double pdf = 0;       // of next-event estimation from v_m, sr^-1 or a pmf; 0: it does not find it
    std::uint16_t emitter = 0;
    bool at_infinity = false, delta = false, changed = false;

    RayEnd end() const { return {y, n, hit_error}; }
};

/// Vertices and segments in turn, from the sensor.
struct FullPath {
    SensorEnd sensor;
    LightEnd light;
    std::vector<Interaction> vertices;  // v_1 ... v_m
    std::vector<const Vertex*> places;  // of the same
    std::vector<Segment> segments;      // m + 1
    const std::vector<Crossing>* crossings = nullptr;

    std::size_t m() const { return vertices.size(); }
    /// Whether the edit can change it: else its difference is 0.
    bool dynamic() const;
    /// Whether the edit is on its first segment or vertex, so that the camera sees it directly.
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

/// Segments of a scene, their crossings appended.
Segment segment_between(const DynamicScene& side, const Vertex& sensor_side, const Vertex& light_side,
                        Crossings& crossings);
Segment segment_to_light(const DynamicScene& side, const Vertex& v, const LightEnd& light, Crossings& crossings);
Vector3f direction_to(const LightEnd& light, const Point3f& from);
/// The ray that finds out whether a vertex sees a light.
Ray shadow_ray(const Vertex& v, const LightEnd& light);

/// One way to find a path: expected number of samples of it per measure of the path.
struct Term {
    Technique technique;
    std::uint32_t place;      // the vertex (from 1), or the crossing
    double density;           // samples of the whole picture times density; of path tracing per h_pixel
    std::uint8_t family = 0;  // of SampleCounts; of path tracing 0
};

struct Evaluation {
    Radiance F;
    double site_density = 0;    // sum of the densities of techniques 1 to 6
    double camera_density = 0;  // of path tracing, both ways, to be multiplied by h_pixel and camera paths per pixel
    double nee_density = 0;     // the part of next-event estimation
};

/// Density of next-event estimation from a point for the light point of a path.
double light_pdf(const Scene& scene, const LightEnd& light, const Point3f& from);

/// All 0 for a path that is not dynamic.
/// in:  terms  null, or where each technique's density goes, in the order of places
Evaluation evaluate(const DynamicScenes& scenes, const DynamicScene& side, const SampleCounts& counts,
                    const PathOptions& options, const FullPath& path, std::vector<Term>* terms);

/// Density of technique 3's direction towards the light: cosine, on the side or sides that reflect.
double pdf_towards_light(const ShadingPoint& here, const Vector3f& towards_light);
bool scatters_on_both_sides(const Scene& scene, const ShadingPoint& here, const Vertex& vertex);

/// in: lobe  of the sample that joined the directions; Lobe::none for two directions that no sample has joined
Interaction interact(const DynamicScene& side, const Vertex& vertex, const Vector3f& to_sensor,
                     const Vector3f& to_light, Lobe lobe);

}  // namespace loom::residual
