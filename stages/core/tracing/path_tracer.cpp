#include "stages/core/tracing/path_tracer.h"

#include <algorithm>
#include <vector>

#include "stages/core/scene/embree.h"
#include "stages/core/tracing/diffuse_block.h"
#include "stages/core/tracing/nlos_tracer.h"
#include "stages/core/tracing/path_observer.h"
#include "stages/core/tracing/path_step.h"

namespace loom {

using namespace tracing;

namespace {

/// in:      last  no light is sampled at this hit
LightQuery light_query(const Hit& hit, const Ray& ray, Point2f u, bool last) {
    LightQuery query;
    query.kind = !hit ? LightQuery::Kind::environment : last ? LightQuery::Kind::nothing : LightQuery::Kind::point;
    query.u = u;
    query.d = ray.d;
    return query;
}

}  // namespace

PathResult trace_path(const Scene& scene, const PathOptions& options, PathId id, PathRecords& records) {
    if (scene.nlos) {
        PathResult result;
        trace_nlos(scene, options, std::span<const PathId>{&id, 1}, {&result, 1}, &records);
        return result;
    }
    const Sampler sampler(options.sampler, options.seed, id.pixel, id.sample);
    PathState path(scene, sampler, id, sampler.pair(film_pair));
    records.start(1);
    records.paths[0].origin = path.ray.o;
    const PathRecorder record(records, 0);
    for (int depth = 1;; ++depth) {
        const Hit hit = depth == 1 ? scene.intersect_from_camera(path.ray) : scene.intersect(path.ray);
        ++path.result.n_rays;
        ShadowRequest shadow;
        LightQuery lights = light_query(hit, path.ray, path.sampler.pair(dimension(depth, Dimension::light)),
                                        depth == options.max_depth);
        look_up_light(scene, lights);
        const Step step = arrive<true>(scene, options, depth, hit, lights,
                                       path.sampler.pair(dimension(depth, Dimension::direction)), path, shadow, record);
        if (has(step, Step::needs_shadow_ray)) {
            ++path.result.n_rays;
            end_next_event<true>(path, shadow, scene.occluded(shadow.ray), record);
        }
        if (!has(step, Step::goes_on)) return path.result;
    }
}

struct PathBatch::Impl {
    const Scene& scene;
    PathOptions options;
    std::vector<Sampler> samplers;
    std::vector<PathState> started;
    std::span<PathState> paths;            // `started`, or the paths to resume
    std::span<const GivenRay> given_rays;  // of `started`; empty: none
    std::vector<ShadowRequest> shadows;
    std::vector<Hit> hits;
    std::vector<LightQuery> lights;
    std::vector<const Ray*> rays;
    std::vector<std::uint32_t> active, waiting;  // active paths; those that need a shadow ray
    std::vector<std::uint32_t> joining;          // paths that start at a later depth, the deepest first
    std::unique_ptr<bool[]> blocked{new bool[capacity]};
    // Columns of random numbers and their keys, in the order of `active`.
    std::vector<std::uint32_t> key_lo, key_hi, index;
    std::vector<float> light_x, light_y, direction_x, direction_y, roulette_x, unused;
    std::vector<Step> steps;
    DiffuseBlock diffuse;
    bool prefetches;
    PathObserver* observer;
    PathGate* gate = nullptr;  // of paths to resume
    std::vector<std::uint8_t> stops;

    static constexpr std::size_t cache_bytes = std::size_t(1) << 20;  // size of the L2 cache

    Impl(const Scene& s, const PathOptions& o, PathObserver* path_observer)
        : scene(s), options(o), diffuse(s, o), prefetches(s.table_bytes() > cache_bytes), observer(path_observer) {
        samplers.reserve(capacity);
        started.reserve(capacity);
        shadows.resize(capacity);
        hits.resize(capacity);
        lights.resize(capacity);
        rays.resize(capacity);
        for (auto* column : {&key_lo, &key_hi, &index}) column->resize(capacity);
        for (auto* column : {&light_x, &light_y, &direction_x, &direction_y, &roulette_x, &unused})
            column->resize(capacity);
        steps.resize(capacity);
    }

    template <bool recording>
    void trace(std::span<const PathId> ids, std::span<PathResult> results, PathRecords* records) {
        if constexpr (recording) records->start(ids.size());
        started.clear();
        samplers.clear();
        active.clear();
        for (std::size_t i = 0; i < ids.size(); ++i) {
            samplers.emplace_back(options.sampler, options.seed, ids[i].pixel, ids[i].sample);
            key_lo[i] = samplers[i].key_lo();
            key_hi[i] = samplers[i].key_hi();
            index[i] = samplers[i].index();
        }
        sampler_pairs(options.sampler, key_lo.data(), key_hi.data(), index.data(), film_pair, ids.size(),
                      light_x.data(), light_y.data());
        for (std::size_t i = 0; i < ids.size(); ++i) {
            PathState& path = started.emplace_back(scene, samplers[i], ids[i], Point2f{light_x[i], light_y[i]});
            active.push_back(std::uint32_t(i));
            if constexpr (recording) records->paths[i].origin = path.ray.o;
        }
        paths = started;
        if (observer) observer->start(ids.size());
        follow<recording>(records);
        for (std::size_t i = 0; i < ids.size(); ++i) results[i] = paths[i].result;
    }

    void trace(std::span<const GivenRay> given, std::span<PathResult> results, PathRecords& records) {
        records.start(given.size());
        started.clear();
        joining.clear();
        for (std::size_t i = 0; i < given.size(); ++i) {
            const PathId id = given[i].id;
            started.emplace_back(Sampler(options.sampler, options.seed, id.pixel, id.sample), given[i]);
            joining.push_back(std::uint32_t(i));
            records.paths[i].origin = given[i].ray.o;
        }
        paths = started;
        given_rays = given;
        follow_joining<true>(&records);
        given_rays = {};
        for (std::size_t i = 0; i < given.size(); ++i) {
            results[i] = paths[i].result;
            results[i].n_vertices -= std::uint32_t(given[i].depth - 1);
        }
    }

    void resume(std::span<PathState> resumed, std::span<const std::uint32_t> under_way, PathGate* of_resumed) {
        paths = resumed;
        gate = of_resumed;
        joining.assign(under_way.begin(), under_way.end());
        follow_joining<false>(nullptr);
        gate = nullptr;
    }

    /// Takes the paths out of the first n active ones that the gate stops. Returns the number of the others.
    std::size_t stop_paths(int depth, std::size_t n) {
        stops.resize(n);
        gate->arrive(depth, {active.data(), n}, {rays.data(), n}, {hits.data(), n}, stops);
        std::size_t going = 0;
        for (std::size_t k = 0; k < n; ++k) {
            if (stops[k]) {
                ++paths[active[k]].result.n_rays;
                continue;
            }
            active[going] = active[k];
            key_lo[going] = key_lo[k];
            key_hi[going] = key_hi[k];
            index[going] = index[k];
            rays[going] = rays[k];
            hits[going] = hits[k];
            ++going;
        }
        active.resize(going);
        return going;
    }

    /// Follows the paths in `joining`, each from its own depth.
    template <bool recording>
    void follow_joining(PathRecords* records) {
        active.clear();
        std::stable_sort(joining.begin(), joining.end(),
                         [this](std::uint32_t a, std::uint32_t b) { return paths[a].depth() > paths[b].depth(); });
        follow<recording>(records);
    }

    /// Activates the paths that start at this depth.
    void join(int depth) {
        for (; !joining.empty() && paths[joining.back()].depth() == depth; joining.pop_back()) {
            const Sampler& sampler = paths[joining.back()].sampler;
            const std::size_t k = active.size();
            key_lo[k] = sampler.key_lo();
            key_hi[k] = sampler.key_hi();
            index[k] = sampler.index();
            active.push_back(joining.back());
        }
    }

    template <bool recording>
    void follow(PathRecords* records) {
        const auto recorder = [records](std::uint32_t i) {
            return recording ? PathRecorder(*records, i) : PathRecorder();
        };
        for (int depth = 1; !active.empty() || !joining.empty(); ++depth) {
            join(depth);
            std::size_t n = active.size();
            for (std::size_t k = 0; k < n; ++k) rays[k] = &paths[active[k]].ray;
            (depth == 1 ? scene.camera_rays : scene.rays)->intersect(rays.data(), n, hits.data(), depth == 1);
            if (!given_rays.empty())
                for (std::size_t k = 0; k < n; ++k)
                    if (const Hit& given = given_rays[active[k]].hit; paths[active[k]].is_first && given)
                        hits[k] = given;
            if (gate) n = stop_paths(depth, n);
            sampler_pairs(options.sampler, key_lo.data(), key_hi.data(), index.data(),
                          dimension(depth, Dimension::light), n, light_x.data(), light_y.data());
            sampler_pairs(options.sampler, key_lo.data(), key_hi.data(), index.data(),
                          dimension(depth, Dimension::direction), n, direction_x.data(), direction_y.data());
            if (roulette_at(options, depth) != Roulette::off)
                sampler_pairs(options.sampler, key_lo.data(), key_hi.data(), index.data(),
                              dimension(depth, Dimension::roulette), n, roulette_x.data(), unused.data());
            const auto ask = [&](void (Scene::*prefetch)(const Hit&) const) {
                if (prefetches)
                    for (std::size_t k = 0; k < n; ++k) (scene.*prefetch)(hits[k]);
            };
            ask(&Scene::prefetch_triangle);
            for (std::size_t k = 0; k < n; ++k)
                lights[k] = light_query(hits[k], *rays[k], {light_x[k], light_y[k]}, depth == options.max_depth);
            ask(&Scene::prefetch_corners);
            look_up_lights(scene, {lights.data(), n});
            ask(&Scene::prefetch_texels);
            if (observer) observer->arrive(active, {rays.data(), n}, {hits.data(), n}, {lights.data(), n});
            // Diffuse surfaces as a structure of arrays, block by block; all others vertex by vertex.
            const bool by_column = options.max_depth < 0 || depth < options.max_depth;
            const auto shade = [&] {
                diffuse.shade(depth);
                for (std::size_t m = 0; m < diffuse.size(); ++m) {
                    const std::uint32_t k = diffuse.ray(m), i = active[k];
                    steps[k] = diffuse.finish<recording>(m, hits[k], paths[i], shadows[i], recorder(i));
                }
                diffuse.clear();
            };
            for (std::size_t k = 0; k < n; ++k) {
                const std::uint32_t i = active[k];
                PathState& path = paths[i];
                ++path.result.n_rays;
                const Point2f u_direction{direction_x[k], direction_y[k]};
                if (by_column && diffuse.add(std::uint32_t(k), hits[k], path, lights[k], u_direction, roulette_x[k])) {
                    if (diffuse.full()) shade();
                } else {
                    steps[k] = arrive<recording>(scene, options, depth, hits[k], lights[k], u_direction, path,
                                                 shadows[i], recorder(i));
                }
            }
            shade();
            std::size_t going = 0;
            waiting.clear();
            for (std::size_t k = 0; k < n; ++k) {
                const std::uint32_t i = active[k];
                const Step step = steps[k];
                if (has(step, Step::needs_shadow_ray)) {
                    rays[waiting.size()] = &shadows[i].ray;
                    waiting.push_back(i);
                }
                if (has(step, Step::goes_on)) {
                    active[going] = i;
                    key_lo[going] = key_lo[k];
                    key_hi[going] = key_hi[k];
                    index[going] = index[k];
                    ++going;
                }
            }
            scene.rays->occluded(rays.data(), waiting.size(), blocked.get());
            for (std::size_t k = 0; k < waiting.size(); ++k) {
                const std::uint32_t i = waiting[k];
                ++paths[i].result.n_rays;
                end_next_event<recording>(paths[i], shadows[i], blocked[k], recorder(i));
            }
            if (observer) observer->trace_shadow_rays(waiting, {rays.data(), waiting.size()});
            active.resize(going);
        }
    }
};

PathBatch::PathBatch(const Scene& scene, const PathOptions& options, PathObserver* observer)
    : impl_(std::make_unique<Impl>(scene, options, observer)) {}
PathBatch::~PathBatch() = default;
PathBatch::PathBatch(PathBatch&&) noexcept = default;

void PathBatch::trace(std::span<const PathId> ids, std::span<PathResult> results) {
    if (impl_->scene.nlos) return trace_nlos(impl_->scene, impl_->options, ids, results, nullptr);
    impl_->trace<false>(ids, results, nullptr);
}

void PathBatch::trace(std::span<const PathId> ids, std::span<PathResult> results, PathRecords& records) {
    if (impl_->scene.nlos) return trace_nlos(impl_->scene, impl_->options, ids, results, &records);
    impl_->trace<true>(ids, results, &records);
}

void PathBatch::trace(std::span<const GivenRay> rays, std::span<PathResult> results, PathRecords& records) {
    if (impl_->scene.nlos) return trace_nlos(impl_->scene, impl_->options, rays, results, &records);
    impl_->trace(rays, results, records);
}

void PathBatch::resume(std::span<PathState> paths, std::span<const std::uint32_t> under_way, PathGate* gate) {
    impl_->resume(paths, under_way, gate);
}

}  // namespace loom
