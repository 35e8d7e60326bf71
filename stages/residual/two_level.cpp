#include "stages/residual/two_level.h"

#include <tbb/enumerable_thread_specific.h>

#include <algorithm>
#include <numeric>
#include <span>
#include <vector>

#include "stages/core/sampling/streams.h"
#include "stages/core/tracing/film.h"
#include "stages/core/tracing/path_observer.h"
#include "stages/core/tracing/path_state.h"
#include "stages/core/tracing/pixel_loop.h"

namespace loom::residual {
namespace {

/// Whether a cache covers the surfaces of a shape: by its material, or only known at the point.
enum class Covered : std::uint8_t { no, yes, depends };

/// What a path does at a shape of the new scene.
struct Surface {
    Covered covered = Covered::no;
    bool front_answers = false, back_answers = false;  // the cache may stand for the path there
};

Covered covered(const Material& material, float smallest_roughness) {
    if (material.alpha_u_idx >= 0 || material.alpha_v_idx >= 0 || material.opacity_idx >= 0 ||
        material.exponent_idx >= 0)
        return Covered::depends;
    return is_cached(Bsdf<float>(material.model), smallest_roughness) ? Covered::yes : Covered::no;
}

std::vector<Surface> surfaces_of(const ScenePair& scenes, const Edit& edit, const RadianceCache& cache) {
    const auto is_trusted = [&](int old_material) {
        const auto i = std::size_t(old_material);
        return i >= cache.validation.relative_l2.size() || cache.validation.relative_l2[i] < largest_relative_l2;
    };
    const Scene& scene = scenes.new_scene;
    std::vector<Surface> surfaces;
    for (std::size_t i = 0; i < scene.shapes.size(); ++i) {
        const Shape& shape = scene.shapes[i];
        const Material& front = scene.materials[shape.material_idx];
        const Material& back = front.back_idx < 0 ? front : scene.materials[std::size_t(front.back_idx)];
        Surface& surface = surfaces.emplace_back();
        surface.covered = covered(front, cache.settings.smallest_roughness);
        if (covered(back, cache.settings.smallest_roughness) != surface.covered) surface.covered = Covered::depends;
        const ShapeEdit& changed = edit.new_shapes[i];
        if (changed.changes != 0 || shape.emitter_idx >= 0) continue;
        const auto old_front = int(scenes.old_scene.shapes[changed.partner_idx].material_idx);
        const int old_back = scenes.old_scene.materials[std::size_t(old_front)].back_idx;
        surface.front_answers = is_trusted(old_front);
        surface.back_answers = is_trusted(old_back < 0 ? old_front : old_back);
    }
    return surfaces;
}

/// Spreads the lower ten bits of x to every third bit.
std::uint32_t spread_bits(std::uint32_t x) {
    x = (x | x << 16) & 0x030000ff;
    x = (x | x << 8) & 0x0300f00f;
    x = (x | x << 4) & 0x030c30c3;
    return (x | x << 2) & 0x09249249;
}

/// Stops paths at the second vertex that the cache covers. State of one thread.
class CacheGate : public PathGate {
  public:
    CacheGate(const Scene& scene, const std::vector<Surface>& surfaces, float smallest_roughness, int max_depth)
        : scene_(scene), surfaces_(surfaces), smallest_roughness_(smallest_roughness), max_depth_(max_depth) {}

    void start(std::size_t n) {
        has_vertex_.assign(n, 0);
        stopped_.clear();
        queries_.clear();
    }
    void arrive(int depth, std::span<const std::uint32_t> paths, std::span<const Ray* const> rays,
                std::span<const Hit> hits, std::span<std::uint8_t> stops) override {
        const bool is_last = max_depth_ >= 0 && depth >= max_depth_;
        for (std::size_t k = 0; k < paths.size(); ++k)
            stops[k] = !is_last && hits[k] && stops_at(paths[k], *rays[k], hits[k]);
    }
    /// Brings queries into an order in which neighbours lie close together, for CacheReader.
    void sort_queries() {
        order_.resize(queries_.size());
        for (std::size_t i = 0; i < queries_.size(); ++i) order_[i] = {place_on_curve(queries_[i].p), std::uint32_t(i)};
        std::sort(order_.begin(), order_.end());
        sorted_stopped_.clear();
        sorted_queries_.clear();
        for (const auto& [place, i] : order_) {
            sorted_stopped_.push_back(stopped_[i]);
            sorted_queries_.push_back(queries_[i]);
        }
    }
    /// After sort_queries(): the paths that stopped, and the query of each.
    std::span<const std::uint32_t> stopped() const { return sorted_stopped_; }
    std::span<const CacheQuery> queries() const { return sorted_queries_; }

  private:
    /// Place on a Z-order curve through the scene.
    std::uint32_t place_on_curve(const Point3f& p) const {
        std::uint32_t place = 0;
        for (int axis = 0; axis < 3; ++axis) {
            const float u = (p[axis] - scene_.center[axis]) / (2 * scene_.radius) + 0.5f;
            place |= spread_bits(std::uint32_t(1023 * std::clamp(u, 0.0f, 1.0f))) << axis;
        }
        return place;
    }
    bool stops_at(std::uint32_t path, const Ray& ray, const Hit& hit) {
        const Surface& surface = surfaces_[hit.shape_idx];
        if (surface.covered == Covered::no) return false;
        const bool is_second = has_vertex_[path] != 0;
        if (is_second ? !(surface.front_answers || surface.back_answers) : surface.covered == Covered::yes) {
            has_vertex_[path] = 1;
            return false;
        }
        const SurfacePoint at = scene_.surface(ray, hit);
        const ShadingPoint here = shading_point(scene_, at, -ray.d);
        if (!is_cached(here.bsdf, smallest_roughness_)) return false;
        has_vertex_[path] = 1;
        const bool is_front = at.material_idx == scene_.shapes[at.shape_idx].material_idx;
        if (!is_second || !(is_front ? surface.front_answers : surface.back_answers)) return false;
        stopped_.push_back(path);
        queries_.push_back(cache_query(here));
        return true;
    }

    const Scene& scene_;
    const std::vector<Surface>& surfaces_;
    float smallest_roughness_;
    int max_depth_;
    std::vector<std::uint8_t> has_vertex_;  // [path] a vertex that the cache covers is behind the ray
    std::vector<std::uint32_t> stopped_;
    std::vector<CacheQuery> queries_;
    std::vector<std::pair<std::uint32_t, std::uint32_t>> order_;  // place on the curve, index
    std::vector<std::uint32_t> sorted_stopped_;
    std::vector<CacheQuery> sorted_queries_;
};

/// State of one thread, reused between chunks.
struct Worker {
    const Scene& scene;
    const CacheReader& cache;
    const PathOptions& options;
    float share;
    tracing::NonfiniteLog& nonfinite;
    Film& film;
    CacheGate gate;
    PathBatch batch{scene, options};
    std::vector<PathState> paths{};
    std::vector<std::uint32_t> under_way{};
    std::vector<CacheAnswer> answers{};
    std::vector<Spectrum> L_1{};   // [path]
    std::vector<float> weights{};  // [path] of L_path - L_1
    PixelSums sums{};
    CachedCounts counted{};

    void trace(std::span<const PathId> ids) {
        // Trace all paths to the cache.
        paths.clear();
        for (const PathId id : ids) {
            const Sampler sampler(options.sampler, options.seed, id.pixel, id.sample);
            paths.emplace_back(scene, sampler, id, sampler.pair(film_pair));
        }
        under_way.resize(ids.size());
        std::iota(under_way.begin(), under_way.end(), 0u);
        gate.start(ids.size());
        batch.resume(paths, under_way, &gate);
        gate.sort_queries();
        const std::span<const std::uint32_t> stopped = gate.stopped();
        answers.resize(stopped.size());
        cache.answer(gate.queries(), answers);

        // Trace a share of them on.
        L_1.resize(ids.size());
        weights.assign(ids.size(), 1);
        under_way.clear();
        for (std::size_t j = 0; j < stopped.size(); ++j) {
            const std::uint32_t i = stopped[j];
            const PathState& path = paths[i];
            if (!answers[j].is_far) {
                L_1[i] = path.result.L + path.beta * answers[j].L;
                weights[i] = path.sampler.pair(correction_pair).x < share ? 1 / share : 0;
            }
            if (weights[i] > 0) under_way.push_back(i);
            counted.far += answers[j].is_far;
        }
        counted.queries += stopped.size();
        counted.traced_on += under_way.size();
        batch.resume(paths, under_way);
    }
    void add(std::size_t k, PathId id) {
        const PathResult& path = paths[k].result;
        Spectrum L = path.L;
        if (weights[k] == 0)
            L = L_1[k];
        else if (weights[k] != 1)
            L = L_1[k] + (path.L - L_1[k]) * weights[k];
        nonfinite.check(L, id);
        sums.add(L, path.first);
        ++counted.samples;
        counted.counts.add(path);
    }
    void finish(std::uint64_t pixel) {
        film.set(pixel, sums);
        sums = {};
    }
};

}  // namespace

Image render_corrected(const ScenePair& scenes, const Edit& edit, const CacheReader& cache, double share,
                       const PathOptions& path, const Work& work, app::Report& report, CachedCounts& counts) {
    const Scene& scene = scenes.new_scene;
    const std::vector<Surface> surfaces = surfaces_of(scenes, edit, cache.cache());
    Film film(scene.sensor.width, scene.sensor.height, work.spp);
    tracing::NonfiniteLog log(report, scene.sensor.width, path.seed);
    app::Progress progress(report, "tracing", scene.sensor.n_pixels() * work.spp);
    tbb::enumerable_thread_specific<Worker> workers([&] {
        return Worker{scene,
                      cache,
                      path,
                      float(share),
                      log,
                      film,
                      CacheGate(scene, surfaces, cache.cache().settings.smallest_roughness, path.max_depth)};
    });
    tracing::trace_pixels(
        workers, scene.sensor.n_pixels(), double(work.spp), work.threads,
        [&](std::uint64_t) {
            return tracing::SampleRange{work.first_sample, work.spp};
        },
        progress);
    counts = {};
    counts.counts.nonfinite = log.count();
    for (const Worker& w : workers) {
        counts.counts.add(w.counted.counts);
        counts.samples += w.counted.samples;
        counts.queries += w.counted.queries;
        counts.far += w.counted.far;
        counts.traced_on += w.counted.traced_on;
    }
    return std::move(film).finish({});
}

}  // namespace loom::residual
