#include "stages/residual/control/coverage.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <memory>
#include <numeric>

#include "stages/core/compute/parallel.h"
#include "stages/core/sampling/streams.h"
#include "stages/residual/control/film_box.h"

namespace loom::residual {
namespace {

constexpr std::size_t n_rays = 16;  // of a pixel

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

/// Camera rays of each pixel by which the first hits of the scenes are compared.
struct CameraRays {
    SamplerKind sampler;
    std::uint64_t seed;
    std::vector<std::uint64_t> samples;
};

/// State of one thread.
class FirstHitPairs {
  public:
    FirstHitPairs(const ScenePair& scenes, const EditReach& reach, const CameraRays& camera)
        : scenes_(scenes),
          reach_(reach),
          camera_(camera),
          rays_(camera.samples.size()),
          pointers_(rays_.size()),
          met_(std::make_unique<bool[]>(2 * rays_.size())) {}

    /// Share of the camera rays of a pixel whose first hits differ; above 1 where one of them hit a light that went.
    float coverage(std::uint32_t x, std::uint32_t y) {
        const Sensor& sensor = scenes_.new_scene.sensor;
        const std::size_t n = rays_.size();
        for (std::size_t k = 0; k < n; ++k) {
            const Sampler sampler(camera_.sampler, camera_.seed, std::uint64_t(y) * sensor.width + x,
                                  camera_.samples[k]);
            rays_[k] = sensor.sample_ray(x, y, sampler.pair(film_pair));
            pointers_[k] = &rays_[k];
        }
        std::fill_n(met_.get(), 2 * n, false);
        if (!reach_.old_places.empty()) reach_.old_places.meet(pointers_.data(), n, met_.get());
        if (!reach_.new_places.empty()) reach_.new_places.meet(pointers_.data(), n, met_.get() + n);
        std::size_t n_differ = 0;
        for (std::size_t k = 0; k < n; ++k) {
            const Seen seen = met_[k] || met_[n + k] ? compare(scenes_, rays_[k]) : Seen::same;
            if (seen == Seen::light_went) return 2;
            n_differ += seen == Seen::other;
        }
        return float(n_differ) / float(n);
    }

  private:
    const ScenePair& scenes_;
    const EditReach& reach_;
    const CameraRays& camera_;
    std::vector<Ray> rays_;
    std::vector<const Ray*> pointers_;
    std::unique_ptr<bool[]> met_;
};

/// Coverage of the pixels of a rectangle of the film; 0 elsewhere.
struct Covered {
    std::uint32_t left = 0, top = 0, width = 0, height = 0;
    std::vector<float> share;  // [y, x] of the rectangle

    /// Returns weights 1, and of(x, y) of the rectangle's pixels.
    template <class Of>
    std::vector<Spectrum> weights(const Sensor& sensor, Of&& of) const {
        std::vector<Spectrum> alpha(sensor.n_pixels(), Spectrum(1));
        for (std::uint32_t y = 0; y < height; ++y)
            for (std::uint32_t x = 0; x < width; ++x)
                alpha[std::size_t(top + y) * sensor.width + left + x] = Spectrum(of(x, y));
        return alpha;
    }
    float at(std::uint32_t x, std::uint32_t y) const { return share[std::size_t(y) * width + x]; }
};

Covered covered_by(const ScenePair& scenes, const EditReach& reach, const CameraRays& camera, int threads) {
    const Sensor& sensor = scenes.new_scene.sensor;
    const FilmBox film = film_of_changes(sensor, reach);
    if (film.empty()) return {};
    Covered covered{film.left(), film.top(), film.width(), film.height(), {}};
    covered.share.resize(std::size_t(covered.width) * covered.height);
    parallel_chunks(covered.share.size(), 256, threads, [&](std::uint64_t, std::uint64_t begin, std::uint64_t end) {
        FirstHitPairs pairs(scenes, reach, camera);
        for (std::uint64_t i = begin; i < end; ++i)
            covered.share[i] = pairs.coverage(covered.left + std::uint32_t(i % covered.width),
                                              covered.top + std::uint32_t(i / covered.width));
    });
    return covered;
}

bool all_are_one(const std::vector<Spectrum>& alpha) {
    return std::all_of(alpha.begin(), alpha.end(), [](const Spectrum& a) { return a == Spectrum(1); });
}

}  // namespace

std::optional<ControlSums> graph_control(const ScenePair& scenes, const EditReach& reach, std::uint64_t seed,
                                         int threads) {
    CameraRays camera{SamplerKind::independent, streams::coverage(seed), std::vector<std::uint64_t>(n_rays)};
    std::iota(camera.samples.begin(), camera.samples.end(), 0);
    const Covered covered = covered_by(scenes, reach, camera, threads);
    // The radiance of a light that went would be most of the noise: its neighbours may see it, too, by rare rays.
    const auto near_light = [&](std::uint32_t x, std::uint32_t y) {
        for (std::uint32_t v = std::max(y, 1u) - 1; v < std::min(y + 2, covered.height); ++v)
            for (std::uint32_t u = std::max(x, 1u) - 1; u < std::min(x + 2, covered.width); ++u)
                if (covered.at(u, v) > 1) return true;
        return false;
    };
    std::vector<Spectrum> alpha = covered.weights(scenes.new_scene.sensor, [&](std::uint32_t x, std::uint32_t y) {
        return near_light(x, y) ? 0 : 1 - covered.at(x, y);
    });
    const bool fits = reach.any_emitter || reach.any_relit || !reach.everything.empty();
    if (!fits && all_are_one(alpha)) return {};
    return ControlSums(std::move(alpha), fits);
}

std::optional<ControlSums> first_hit_control(const ScenePair& scenes, const EditReach& reach, SamplerKind sampler,
                                             std::uint64_t seed, const std::vector<std::uint64_t>& samples,
                                             int threads) {
    const CameraRays camera{sampler, seed, samples};
    const Covered covered = covered_by(scenes, reach, camera, threads);
    ControlSums control(covered.weights(
        scenes.new_scene.sensor, [&](std::uint32_t x, std::uint32_t y) { return covered.at(x, y) > 0 ? 0.0f : 1.0f; }));
    if (all_are_one(control.alpha)) return {};
    return control;
}

}  // namespace loom::residual
