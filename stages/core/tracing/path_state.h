#pragma once
// A path while it is being traced.

#include "stages/core/scene/media.h"
#include "stages/core/scene/shading.h"
#include "stages/core/tracing/path_tracer.h"

namespace loom {

/// The ray that is about to hit, and the state of the path behind it. Members that every step reads come first, those of
/// dielectrics last.
struct alignas(64) PathState {
    Ray ray;
    Spectrum beta{1};     // throughput up to the ray: includes the last BSDF sample and roulette
    float eta_scale = 1;  // product of squared relative indices: undoes radiance scaling for roulette
    float density = 0;    // of the ray's direction, sr^-1, or pmf of its delta lobe; roulette folded in
    Point3f from;         // vertex that the ray left
    Lobe lobe = Lobe::none;
    bool is_straight = true;  // all lobes since the camera keep the direction: goes_straight_on()
    bool is_first = true;     // no vertex is behind the ray
    PathResult result;
    Sampler sampler;
    MediumStack media;

    /// A path that starts at the camera.
    /// in:  u_film  sampler.pair(film_pair)
    PathState(const Scene& scene, const Sampler& sampler_, PathId id, Point2f u_film)
        : ray(scene.sensor.sample_ray(std::uint32_t(id.pixel % scene.sensor.width),
                                      std::uint32_t(id.pixel / scene.sensor.width), u_film)),
          sampler(sampler_) {
        if (!scene.sensor_media.vacuum) media = scene.sensor_media.at(scene, ray.o);
    }
    /// A path that starts with a given ray.
    PathState(const Sampler& sampler_, const GivenRay& start)
        : ray(start.ray), is_straight(start.depth == 1), sampler(sampler_), media(start.media) {
        result.n_vertices = std::uint32_t(start.depth - 1);
    }
    /// An empty state; the caller fills it in.
    explicit PathState(const Sampler& sampler_) : sampler(sampler_) {}

    /// Number of the edge that the ray is about to make, from 1.
    int depth() const { return int(result.n_vertices) + 1; }
};

}  // namespace loom
