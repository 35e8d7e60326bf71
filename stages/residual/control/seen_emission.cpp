#include "stages/residual/control/seen_emission.h"

#include <algorithm>
#include <string>

#include "stages/core/compute/parallel.h"
#include "stages/core/sampling/streams.h"
#include "stages/core/scene/emitter.h"
#include "stages/residual/control/film_box.h"

namespace loom::residual {
namespace {

constexpr const char* rgb[] = {"R", "G", "B"};
constexpr std::uint64_t n_pilot = 16;  // rays of a pixel that choose
// Rays of a chosen pixel for each of its paths, and their bounds.
constexpr std::uint64_t rays_per_path = 8, fewest_rays = 64, most_rays = 4096;
// Sets of Sobol points, from whose means the variance follows: it is several times less than that of single rays.
constexpr std::uint64_t n_sets = 8;

void add_emitters(const Scene& scene, const Sensor& sensor, FilmBox& film) {
    for (const Shape& shape : scene.shapes)
        if (shape.emitter_idx >= 0) film.add(sensor, shape.bounds());
}

/// What the rays of a pixel see of emission that differs between the scenes.
enum class Differs : std::uint8_t { none, mixed, alike };

/// Camera rays of the pixels of a film in both scenes.
struct RayPairs {
    const Scene* old_scene;  // null: nothing is seen in it
    const Scene& new_scene;
    SamplerKind sampler;
    std::uint64_t seed;

    std::array<Spectrum, 2> emission(std::uint32_t x, std::uint32_t y, std::uint64_t sample) const {
        const Sensor& sensor = new_scene.sensor;
        const Sampler random(sampler, seed, std::uint64_t(y) * sensor.width + x, sample);
        const Ray ray = sensor.sample_ray(x, y, random.pair(film_pair));
        return {old_scene ? emission_at_first_hit(*old_scene, ray) : Spectrum(0),
                emission_at_first_hit(new_scene, ray)};
    }
    Differs differs(std::uint32_t x, std::uint32_t y) const {
        const std::array<Spectrum, 2> first = emission(x, y, 0);
        bool all_same = true, any = !(first[0] == first[1]);
        for (std::uint64_t k = 1; k < n_pilot; ++k) {
            const std::array<Spectrum, 2> here = emission(x, y, k);
            all_same &= here[0] == first[0] && here[1] == first[1];
            any |= !(here[0] == here[1]);
        }
        return !any ? Differs::none : all_same ? Differs::alike : Differs::mixed;
    }
};

}  // namespace

Spectrum emission_at_first_hit(const Scene& scene, const Ray& ray) {
    const Hit hit = scene.intersect_from_camera(ray);
    if (!hit || scene.shapes[hit.shape_idx].emitter_idx < 0) return Spectrum(0);
    return emitted(scene, scene.surface(ray, hit), -ray.d);
}

SeenEmission::SeenEmission(const ScenePair& scenes, const EditReach& reach, std::uint64_t seed, std::uint64_t samples,
                           int threads) {
    const Sensor& sensor = scenes.new_scene.sensor;
    FilmBox film;
    add_emitters(scenes.old_scene, sensor, film);
    add_emitters(scenes.new_scene, sensor, film);
    film.finish(sensor);
    // What moves may hide an emitter.
    if (!reach.any_emitter && !reach.any_relit && reach.everything.empty())
        film.intersect(film_of_changes(sensor, reach));
    estimate(&scenes.old_scene, scenes.new_scene, film, seed, samples, threads);
}

SeenEmission::SeenEmission(const Scene& scene, std::uint64_t seed, std::uint64_t samples, int threads) {
    FilmBox film;
    add_emitters(scene, scene.sensor, film);
    film.finish(scene.sensor);
    estimate(nullptr, scene, film, seed, samples, threads);
}

void SeenEmission::estimate(const Scene* old_scene, const Scene& new_scene, const FilmBox& film, std::uint64_t seed,
                            std::uint64_t samples, int threads) {
    if (film.empty()) return;
    const std::uint32_t left = film.left(), top = film.top(), width = film.width(), height = film.height();
    const std::uint64_t n = std::uint64_t(width) * height;

    // Choose the pixels at edges.
    const RayPairs pilot{old_scene, new_scene, SamplerKind::independent, streams::pilot(streams::seen_emission(seed))};
    std::vector<Differs> differs(n);
    constexpr std::uint64_t per_chunk = 256;
    parallel_chunks(n, per_chunk, threads, [&](std::uint64_t, std::uint64_t begin, std::uint64_t end) {
        for (std::uint64_t i = begin; i < end; ++i)
            differs[i] = pilot.differs(left + std::uint32_t(i % width), top + std::uint32_t(i / width));
    });
    // A neighbour of what differs may see it, too, by rare rays.
    const auto at_edge = [&](std::uint32_t x, std::uint32_t y) {
        std::array<bool, 3> any{};
        for (std::uint32_t v = std::max(y, 1u) - 1; v < std::min(y + 2, height); ++v)
            for (std::uint32_t u = std::max(x, 1u) - 1; u < std::min(x + 2, width); ++u)
                any[std::size_t(differs[std::uint64_t(v) * width + u])] = true;
        return any[std::size_t(Differs::mixed)] ||
               (any[std::size_t(Differs::alike)] && any[std::size_t(Differs::none)]);
    };
    std::vector<std::uint64_t> chosen;  // pixels of the film
    index_.assign(new_scene.sensor.n_pixels(), -1);
    for (std::uint64_t i = 0; i < n; ++i) {
        if (!at_edge(std::uint32_t(i % width), std::uint32_t(i / width))) continue;
        const std::uint64_t pixel = (top + i / width) * new_scene.sensor.width + left + i % width;
        index_[pixel] = std::int32_t(chosen.size());
        chosen.push_back(pixel);
    }

    // Estimate.
    const std::uint64_t n_rays = std::clamp(rays_per_path * samples, fewest_rays, most_rays) / n_sets;
    pairs_.resize(chosen.size());
    parallel_chunks(chosen.size(), 16, threads, [&](std::uint64_t, std::uint64_t begin, std::uint64_t end) {
        for (std::uint64_t i = begin; i < end; ++i)
            for (std::uint64_t set = 0; set < n_sets; ++set) {
                const RayPairs rays{old_scene, new_scene, SamplerKind::sobol,
                                    streams::numbered(streams::seen_emission(seed), set + 1)};
                std::array<Spectrum, 2> sum;
                for (std::uint64_t k = 0; k < n_rays; ++k) {
                    const std::array<Spectrum, 2> L =
                        rays.emission(std::uint32_t(chosen[i] % new_scene.sensor.width),
                                      std::uint32_t(chosen[i] / new_scene.sensor.width), k);
                    sum[0] += L[0], sum[1] += L[1];
                }
                for (int c = 0; c < 3; ++c)
                    pairs_[i][std::size_t(c)].add(double(sum[0][c]) / double(n_rays),
                                                  double(sum[1][c]) / double(n_rays));
            }
    });
    n_rays_ = (n * n_pilot + chosen.size() * n_rays * n_sets) * (old_scene ? 2 : 1);
}

void SeenEmission::add_to(Image& image) const {
    if (empty()) return;
    for (int c = 0; c < 3; ++c) {
        const auto L = image.add(rgb[c]), var_mean = image.add(std::string("VarMean.") + rgb[c]);
        for (std::size_t p = 0; p < index_.size(); ++p) {
            if (!has(p)) continue;
            const PairMoments& pair = of(p)[std::size_t(c)];
            L[p] += float(pair.mean(1));
            var_mean[p] += float(pair.var_mean(1));
        }
    }
}

}  // namespace loom::residual
