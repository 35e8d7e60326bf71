#include "stages/core/scene/media.h"

#include <algorithm>
#include <map>
#include <vector>

#include "stages/core/scene/scene.h"

namespace loom {
namespace {

constexpr int n_directions = 64;
constexpr int most_surfaces = 256;  // along one ray

/// Evenly over the sphere, along no axis.
Vector3f direction(int i) {
    constexpr double golden_angle = 2.399963229728653;
    const double z = 1 - (2 * i + 1.0) / n_directions, r = std::sqrt(1 - z * z), phi = golden_angle * (i + 0.5);
    return Vector3f(Vector3<double>{r * std::cos(phi), r * std::sin(phi), z});
}

bool lets_through(const Material& m) {
    return is_interface(m.model) || m.model.kind == BsdfKind::thin_dielectric || m.model.kind == BsdfKind::null ||
           m.model.opacity < 1 || m.opacity_idx >= 0;
}

/// Counts of rays that leave or enter one shape first.
struct Votes {
    int inside = 0, outside = 0;
    int rank = 0;  // sum over rays of how many others were left before
    SurfaceIdx surface;
    float int_ior = 1, ext_ior = 1;
};

class Survey {
  public:
    explicit Survey(const Scene& scene) : scene_(scene) {}

    void look(const Point3f& p, const Vector3f& d) {
        MediumStack media;
        Ray ray{p, d};
        std::vector<std::uint32_t> seen;
        int n_left = 0;
        for (int k = 0; k < most_surfaces; ++k) {
            const Hit hit = scene_.intersect(ray);
            if (!hit) return;
            const SurfacePoint at = scene_.surface(ray, hit);
            const Material& material = scene_.materials[at.material_idx];
            if (!lets_through(material)) return;
            ray = spawn_ray(at.end(), d);
            const BsdfModel& model = material.model;
            if (!is_interface(model)) continue;
            const bool entering = dot(at.ns_smooth, d) < 0,
                       first = std::find(seen.begin(), seen.end(), at.shape_idx) == seen.end();
            if (entering && seen.empty()) ++outer[model.ext_ior];
            seen.push_back(at.shape_idx);
            const SurfaceIdx surface{at.shape_idx, at.material_idx};
            const bool entered = media.pass(surface, entering, model);
            if (!first) continue;
            Votes& votes = shapes[at.shape_idx];
            votes.surface = surface;
            votes.int_ior = model.int_ior;
            votes.ext_ior = model.ext_ior;
            if (entering) ++votes.outside;
            if (entered) continue;
            ++votes.inside;
            votes.rank += n_left++;
        }
    }

    std::map<std::uint32_t, Votes> shapes;
    std::map<float, int> outer;  // rays by the outer index of what they enter first

  private:
    const Scene& scene_;
};

}  // namespace

MediumStack media_at(const Scene& scene, const Point3f& p) {
    Survey survey(scene);
    for (int i = 0; i < n_directions; ++i) survey.look(p, direction(i));
    std::vector<std::pair<double, std::uint32_t>> around;
    for (const auto& [shape, votes] : survey.shapes)
        if (votes.inside > votes.outside) around.emplace_back(-double(votes.rank) / votes.inside, shape);
    std::sort(around.begin(), around.end());  // the outermost first
    MediumStack media;
    for (const auto& [rank, shape] : around) {
        const Votes& votes = survey.shapes[shape];
        media.cross(votes.surface, true, votes.int_ior, votes.ext_ior);
    }
    if (around.empty() && !survey.outer.empty())
        media.start_outside(
            std::max_element(survey.outer.begin(), survey.outer.end(), [](const auto& a, const auto& b) {
                return a.second < b.second;
            })->first);
    return media;
}

SensorMedia find_sensor_media(const Scene& scene) {
    SensorMedia media;
    if (!scene.features.dielectric) return media;
    const Sensor& sensor = scene.sensor;
    if (sensor.kind != SensorKind::orthographic) {
        media.everywhere = media_at(scene, sensor.origin);
    } else {
        // One stack will do when no object reaches the sensor and its corners agree.
        Box3f box;
        std::vector<Point3f> origins;
        for (const std::uint32_t x : {0u, sensor.width - 1})
            for (const std::uint32_t y : {0u, sensor.height - 1}) {
                origins.push_back(sensor.sample_ray(x, y, {x == 0 ? 0.0f : 1.0f, y == 0 ? 0.0f : 1.0f}).o);
                box.add(origins.back());
            }
        origins.push_back(box.lo + (box.hi - box.lo) * 0.5f);
        media.everywhere = media_at(scene, origins[0]);
        for (const Point3f& origin : origins) media.varies |= !(media_at(scene, origin) == media.everywhere);
        for (const Shape& shape : scene.shapes) {
            if (!is_interface(scene.materials[shape.material_idx].model)) continue;
            const Box3f other = shape.bounds();
            bool apart = false;
            for (int k = 0; k < 3; ++k) apart |= other.hi[k] < box.lo[k] || other.lo[k] > box.hi[k];
            media.varies |= !apart;
        }
    }
    media.vacuum = !media.varies && media.everywhere == MediumStack();
    return media;
}

}  // namespace loom
