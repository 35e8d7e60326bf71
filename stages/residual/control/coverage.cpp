#include "stages/residual/control/coverage.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "stages/core/compute/parallel.h"
#include "stages/core/sampling/streams.h"

namespace loom::residual {
namespace {

constexpr std::size_t n_rays = 16;  // of a pixel

/// Pixels [lo, hi) of the film that may show something.
struct FilmBox {
    std::array<float, 2> lo{INFINITY, INFINITY}, hi{-INFINITY, -INFINITY};

    void add(const Sensor& sensor, const Box3f& box) {
        for (int corner = 0; corner < 8; ++corner) {
            const Point3f p{corner & 1 ? box.hi.x : box.lo.x, corner & 2 ? box.hi.y : box.lo.y,
                            corner & 4 ? box.hi.z : box.lo.z};
            const std::optional<FilmPoint> at = sensor.project(p);
            if (!at) {  // beside or behind the camera
                lo = {0, 0}, hi = {float(sensor.width), float(sensor.height)};
                return;
            }
            for (std::size_t k = 0; k < 2; ++k) {
                const float x = k == 0 ? at->film.x : at->film.y;
                lo[k] = std::min(lo[k], x), hi[k] = std::max(hi[k], x);
            }
        }
    }
    /// Grows to what filters reach, and ends at the borders of the film.
    void finish(const Sensor& sensor) {
        const float reach = sensor.filter_radius + 1;
        lo = {std::max(std::floor(lo[0] - reach), 0.0f), std::max(std::floor(lo[1] - reach), 0.0f)};
        hi = {std::min(std::ceil(hi[0] + reach), float(sensor.width)),
              std::min(std::ceil(hi[1] + reach), float(sensor.height))};
    }
    bool empty() const { return !(lo[0] < hi[0] && lo[1] < hi[1]); }
};

/// How the first hit of a camera ray differs in the new scene.
enum class Seen { same, other, light_went };
Seen compare(const ScenePair& scenes, const Ray& ray) {
    const Hit before = scenes.old_scene.intersect(ray), after = scenes.new_scene.intersect(ray);
    if (!before && !after) return Seen::same;
    // Equal surfaces may be hit at distances that differ by rounding.
    constexpr float rounding = 1e-5f;
    if (!before == !after && !(std::abs(before.t - after.t) > rounding * before.t)) return Seen::same;
    return before && scenes.old_scene.shapes[before.shape_idx].emitter_idx >= 0 ? Seen::light_went : Seen::other;
}

/// Share of the camera rays of a pixel whose first hits differ; above 1 where one of them hit a light.
float coverage(const ScenePair& scenes, const EditReach& reach, std::uint64_t seed, std::uint32_t x, std::uint32_t y) {
    const Sensor& sensor = scenes.new_scene.sensor;
    std::array<Ray, n_rays> rays;
    std::array<const Ray*, n_rays> pointers;
    for (std::size_t k = 0; k < n_rays; ++k) {
        const Sampler sampler(SamplerKind::independent, seed, std::uint64_t(y) * sensor.width + x, k);
        rays[k] = sensor.sample_ray(x, y, sampler.pair(film_pair));
        pointers[k] = &rays[k];
    }
    bool met[2][n_rays] = {};
    if (!reach.old_places.empty()) reach.old_places.meet(pointers.data(), n_rays, met[0]);
    if (!reach.new_places.empty()) reach.new_places.meet(pointers.data(), n_rays, met[1]);
    int n_differ = 0;
    for (std::size_t k = 0; k < n_rays; ++k) {
        const Seen seen = met[0][k] || met[1][k] ? compare(scenes, rays[k]) : Seen::same;
        if (seen == Seen::light_went) return 2;
        n_differ += seen == Seen::other;
    }
    return float(n_differ) / n_rays;
}

/// Returns 1 - coverage() of all pixels.
std::vector<Spectrum> uncovered(const ScenePair& scenes, const EditReach& reach, std::uint64_t seed, int threads) {
    const Sensor& sensor = scenes.new_scene.sensor;
    FilmBox film;
    for (const Obstacles* places : {&reach.old_places, &reach.new_places})
        for (const Box3f& box : places->boxes()) film.add(sensor, box);
    film.finish(sensor);
    std::vector<Spectrum> alpha(sensor.n_pixels(), Spectrum(1));
    if (film.empty()) return alpha;
    const auto width = std::uint32_t(film.hi[0] - film.lo[0]), height = std::uint32_t(film.hi[1] - film.lo[1]);
    std::vector<float> covered(std::size_t(width) * height);
    parallel_chunks(covered.size(), 256, threads, [&](std::uint64_t, std::uint64_t begin, std::uint64_t end) {
        for (std::uint64_t i = begin; i < end; ++i)
            covered[i] =
                coverage(scenes, reach, streams::coverage(seed), std::uint32_t(film.lo[0]) + std::uint32_t(i % width),
                         std::uint32_t(film.lo[1]) + std::uint32_t(i / width));
    });
    // The radiance of a light that went would be most of the noise: its neighbours may see it, too, by rare rays.
    const auto near_light = [&](std::uint32_t x, std::uint32_t y) {
        for (std::uint32_t v = std::max(y, 1u) - 1; v < std::min(y + 2, height); ++v)
            for (std::uint32_t u = std::max(x, 1u) - 1; u < std::min(x + 2, width); ++u)
                if (covered[std::size_t(v) * width + u] > 1) return true;
        return false;
    };
    for (std::uint32_t y = 0; y < height; ++y)
        for (std::uint32_t x = 0; x < width; ++x)
            alpha[(std::size_t(film.lo[1]) + y) * sensor.width + std::size_t(film.lo[0]) + x] =
                Spectrum(near_light(x, y) ? 0 : 1 - covered[std::size_t(y) * width + x]);
    return alpha;
}

}  // namespace

std::optional<ControlSums> graph_control(const ScenePair& scenes, const EditReach& reach, std::uint64_t seed,
                                         int threads) {
    ControlSums control(uncovered(scenes, reach, seed, threads));
    control.fits = reach.any_emitter || reach.any_relit || !reach.everything.empty();
    const auto is_one = [](const Spectrum& a) { return a == Spectrum(1); };
    if (!control.fits && std::all_of(control.alpha.begin(), control.alpha.end(), is_one)) return {};
    return control;
}

}  // namespace loom::residual
