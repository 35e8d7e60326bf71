#include "stages/residual/cached_estimator.h"

#include <tbb/enumerable_thread_specific.h>

#include <algorithm>
#include <cmath>
#include <optional>
#include <span>
#include <vector>

#include "stages/core/sampling/streams.h"
#include "stages/core/scene/embree.h"
#include "stages/core/tracing/film.h"
#include "stages/core/tracing/vertex_rules.h"
#include "stages/residual/control/seen_emission.h"
#include "stages/residual/dynamic/camera_paths.h"

namespace loom::residual {
namespace {

/// What a path may meet of the edit before the cache, and the relative error of the cache by shape.
struct Surroundings {
    // [shape of the scene that is followed]
    std::vector<std::uint8_t> changed_shape;
    std::vector<std::uint32_t> partner;          // in the other scene
    std::vector<float> front_error, back_error;  // of the cache, relative
    std::vector<std::uint8_t> changed_emitter;   // [emitter of the new scene]
    bool sky_changed = false, old_shapes_gone = false;

    Surroundings(const ScenePair& scenes, const Edit& edit, const RadianceCache& cache, bool masked) {
        const auto& materials = scenes.old_scene.materials;
        const auto& shape_edits = masked ? edit.new_shapes : edit.old_shapes;
        const auto error_of = [&](int material) {
            const auto i = std::size_t(material);
            return i < cache.validation.relative_l2.size() ? float(std::sqrt(cache.validation.relative_l2[i])) : 0.0f;
        };
        for (std::size_t i = 0; i < shape_edits.size(); ++i) {
            const ShapeEdit& shape = shape_edits[i];
            changed_shape.push_back(shape.changes != 0);
            partner.push_back(shape.partner_idx);
            const std::size_t old_shape = masked ? shape.partner_idx : i;
            if (masked && shape.partner_idx == ShapeEdit::none) {
                front_error.push_back(0), back_error.push_back(0);
                continue;
            }
            const auto front = int(scenes.old_scene.shapes[old_shape].material_idx);
            const int back = materials[std::size_t(front)].back_idx;
            front_error.push_back(error_of(front));
            back_error.push_back(error_of(back < 0 ? front : back));
        }
        for (const ShapeEdit& shape : edit.old_shapes) old_shapes_gone |= shape.dynamic();
        for (const EmitterEdit& emitter : edit.new_emitters) changed_emitter.push_back(emitter.changed);
        const int sky = scenes.new_scene.environment_idx, old_sky = scenes.old_scene.environment_idx;
        sky_changed = (sky >= 0 && changed_emitter[std::size_t(sky)]) ||
                      (old_sky >= 0 && edit.old_emitters[std::size_t(old_sky)].changed);
    }
};

/// Camera samples up to the first surface that a cache covers.
struct CachedSample {
    Spectrum L;  // exact: emission and sky that were seen
    Spectrum beta;
    FirstHit first;
    float error = 0;          // relative, of the cache
    bool sees_edit = false;   // L counts for nothing
    std::int32_t query = -1;  // of the batch; none: L is all
    std::uint32_t n_rays = 0;
};

/// Follows camera paths to the cache. State of one thread.
class CachePaths {
  public:
    CachePaths(const ScenePair& scenes, const Surroundings& around, const CacheReader& cache, bool masked,
               const PathOptions& options)
        : scenes_(scenes),
          scene_(masked ? scenes.new_scene : scenes.old_scene),
          masked_(masked),
          around_(around),
          cache_(cache),
          options_(options) {}

    void follow(std::span<const PathId> ids) {
        const Scene& scene = scene_;
        samples_.assign(ids.size(), {});
        queries_.clear();
        paths_.clear();
        rays_.clear();
        hits_.resize(ids.size());
        paths_.reserve(ids.size());
        for (const PathId id : ids) {
            const Sampler sampler(options_.sampler, options_.seed, id.pixel, id.sample);
            paths_.emplace_back(scene, sampler, id, sampler.pair(film_pair));
        }
        starts_.clear();
        for (std::size_t k = 0; k < ids.size(); ++k) {
            rays_.push_back(&paths_[k].ray);
            starts_.push_back({paths_[k].ray, ids[k], paths_[k].media});
        }
        scene.camera_rays->intersect(rays_.data(), rays_.size(), hits_.data(), true);
        for (std::size_t k = 0; k < ids.size(); ++k) follow(paths_[k], hits_[k], samples_[k]);
        answers_.resize(queries_.size());
        cache_.answer(queries_, answers_);
    }

    const CachedSample& sample(std::size_t k) const { return samples_[k]; }
    /// The camera ray of a sample.
    const GivenRay& start(std::size_t k) const { return starts_[k]; }
    /// Light of the sample by the cache; 0 where the sample sees the edit.
    Spectrum L(std::size_t k) const {
        const CachedSample& s = samples_[k];
        return s.query < 0 ? s.L : s.L + s.beta * answers_[std::size_t(s.query)].L;
    }
    bool is_far(std::size_t k) const {
        return samples_[k].query >= 0 && answers_[std::size_t(samples_[k].query)].is_far;
    }
    bool is_trusted(std::size_t k) const {
        return samples_[k].query < 0 || (!is_far(k) && sqr(samples_[k].error) < largest_relative_l2);
    }
    /// What may be wrong with L(), on the scale of L.
    Spectrum error(std::size_t k) const {
        const CachedSample& s = samples_[k];
        if (s.query < 0) return Spectrum();
        const CacheAnswer& answer = answers_[std::size_t(s.query)];
        return s.beta * answer.L * s.error;
    }

  private:
    /// Whether the ray finds another surface in the old scene, of which the new one lacks a shape.
    bool differs_in_old_scene(const Ray& ray, const Hit& hit, int depth) const {
        if (!around_.old_shapes_gone) return false;
        const Scene& old_scene = scenes_.old_scene;
        const Hit other = depth == 1 ? old_scene.intersect_from_camera(ray) : old_scene.intersect(ray);
        if (!hit || !other) return bool(hit) != bool(other);
        return around_.partner[hit.shape_idx] != other.shape_idx || hit.primitive_idx != other.primitive_idx;
    }

    bool sees_edit(const Ray& ray, const Hit& hit, int depth) const {
        if (!hit) return around_.sky_changed || differs_in_old_scene(ray, hit, depth);
        const int emitter = scene_.shapes[hit.shape_idx].emitter_idx;
        return around_.changed_shape[hit.shape_idx] ||
               (emitter >= 0 && around_.changed_emitter[std::size_t(emitter)]) || differs_in_old_scene(ray, hit, depth);
    }

    void follow(PathState& path, Hit hit, CachedSample& out) {
        const Scene& scene = scene_;
        for (int depth = 1;; ++depth) {
            ++out.n_rays;
            if (depth > 1) hit = scene.intersect(path.ray);
            if (masked_ && sees_edit(path.ray, hit, depth)) {
                out.sees_edit = true;
                out.L = Spectrum();
            }
            const bool dark = options_.max_depth >= 0 && depth > options_.max_depth;
            if (!hit) {
                if (!out.sees_edit && !dark && !hides_sky(scene, path.is_straight) && scene.environment_idx >= 0)
                    out.L += path.beta * environment(scene, path.ray.d);
                return;
            }
            const Vector3f wo = -path.ray.d;
            const SurfacePoint at = scene.surface(path.ray, hit);
            if (scene.shapes[at.shape_idx].emitter_idx >= 0 && !dark && !out.sees_edit)
                out.L += path.beta * emitted(scene, at, wo);
            if (depth > 1 && scene.materials[at.material_idx].black()) return;
            const ShadingPoint here = shading_point(scene, at, wo);
            if (depth == 1) out.first = first_hit(here, hit.t);
            if (out.sees_edit || (options_.max_depth >= 0 && depth >= options_.max_depth)) return;
            if (is_cached(here.bsdf, cache_.cache().settings.smallest_roughness)) {
                out.query = std::int32_t(queries_.size());
                out.beta = path.beta;
                const bool front = at.material_idx == scene.shapes[at.shape_idx].material_idx;
                out.error = (front ? around_.front_error : around_.back_error)[at.shape_idx];
                queries_.push_back(cache_query(here));
                return;
            }
            // Pass a mirror, glass or the like as the path does.
            const float q = survival(roulette_at(options_, depth), here, path);
            if (roulette_ends(q, path.sampler, depth)) return;
            const BsdfSample<float> s =
                draw(here, path.sampler, depth, path.sampler.pair(dimension(depth, Dimension::direction)));
            if (s.lobe == Lobe::none || is_black(s.weight)) return;
            pass_vertex(path, here.p, *here.bsdf.model, {at.shape_idx, at.material_idx}, s, q, s.density() * q);
            path.ray = spawn_ray(here.end(), here.frame.to_world(s.wi));
        }
    }

    const ScenePair& scenes_;
    const Scene& scene_;  // that is followed: where nothing is masked, the one that the cache is of
    bool masked_;
    const Surroundings& around_;
    const CacheReader& cache_;
    const PathOptions& options_;
    std::vector<PathState> paths_;
    std::vector<GivenRay> starts_;  // of paths_
    std::vector<const Ray*> rays_;
    std::vector<Hit> hits_;
    std::vector<CachedSample> samples_;
    std::vector<CacheQuery> queries_;
    std::vector<CacheAnswer> answers_;
};

/// Cache minus path of the samples of one pixel that are untouched.
struct Discrepancy {
    std::uint64_t n = 0;
    std::array<double, 3> sum{}, square{}, of_paths{};
    void add(const Spectrum& cached, const Spectrum& path) {
        ++n;
        for (int c = 0; c < 3; ++c) {
            const double r = double(cached[c]) - double(path[c]);
            sum[std::size_t(c)] += r, square[std::size_t(c)] += r * r;
            of_paths[std::size_t(c)] += double(path[c]);
        }
    }
};

/// Sums of discrepancies over pixels, by pixel, so that they are equal for any number of threads.
struct PixelDiscrepancy {
    float bias = 0, product = 0, of_paths = 0;
    bool counts = false;
};

/// Several paths from the camera rays of samples without a cache. State of one thread.
class PathsForCache {
  public:
    PathsForCache(const Scene& scene, const PathOptions& options)
        : batch_(scene, with_seed(options, streams::independent_of(options.seed))) {}

    void start() {
        rays_.clear();
        n_used_ = 0;
    }
    /// in:      n  number of paths from this ray
    void add(const GivenRay& ray, std::size_t n) {
        for (std::size_t m = 0; m < n; ++m) {
            rays_.push_back(ray);
            rays_.back().id.sample = ray.id.sample * paths_for_cache + m;
        }
    }
    void trace() {
        results_.resize(rays_.size());
        for (std::size_t i = 0; i < rays_.size(); i += PathBatch::capacity) {
            const std::size_t n = std::min(PathBatch::capacity, rays_.size() - i);
            batch_.trace(std::span(rays_).subspan(i, n), std::span(results_).subspan(i, n), records_);
        }
    }
    /// Returns the sum of the radiances of the next n paths, in the order of add().
    Spectrum take(std::size_t n, Counts& counts) {
        Spectrum sum;
        for (std::size_t m = 0; m < n; ++m) {
            const PathResult& path = results_[n_used_++];
            counts.add(path);
            sum += path.L;
        }
        return sum;
    }

  private:
    PathBatch batch_;
    std::vector<GivenRay> rays_;
    std::vector<PathResult> results_;
    PathRecords records_;
    std::size_t n_used_ = 0;
};

/// State of one thread, reused between chunks.
struct Worker {
    CachePaths cached;
    PathsForCache paths;
    std::optional<CameraPaths> pairs;  // with an edit
    tracing::NonfiniteLog& nonfinite;
    Film& film;
    std::span<float> error_layer;  // [pixel, rgb]
    std::span<PixelDiscrepancy> discrepancies;
    bool masked;
    const Scene& scene;
    const SeenEmission& seen;
    PixelSums sums{};
    Spectrum error{};
    Discrepancy discrepancy{};
    std::uint64_t n_in_pixel = 0;
    CachedCounts counted{};

    /// Number of further paths of a sample that does without the cache; a pair brings one of them.
    std::size_t n_paths(std::size_t k) const {
        return masked && !cached.is_trusted(k) ? paths_for_cache - (pairs ? 1 : 0) : 0;
    }
    void trace(std::span<const PathId> ids) {
        cached.follow(ids);
        paths.start();
        for (std::size_t k = 0; k < ids.size(); ++k) paths.add(cached.start(k), n_paths(k));
        paths.trace();
        if (pairs) pairs->trace(ids);
    }
    void add(std::size_t k, PathId id) {
        const CachedSample& s = cached.sample(k);
        const bool trusted = cached.is_trusted(k), by_path = masked && (s.sees_edit || !trusted);
        Spectrum L = cached.L(k);
        if (by_path) {
            L = paths.take(n_paths(k), counted.counts);
            if (pairs) L += pairs->L_new(k);
            if (!trusted) L *= 1 / float(paths_for_cache);
        } else {
            error += cached.error(k);
            if (pairs && !pairs->touched(k)) discrepancy.add(L, pairs->L_new(k));
            if (pairs) L += pairs->difference(k);
        }
        if (seen.has(id.pixel)) L = L - emission_at_first_hit(scene, cached.start(k).ray);
        nonfinite.check(L, id);
        sums.add(L, s.first);
        ++n_in_pixel;
        ++counted.samples;
        counted.masked += s.sees_edit;
        counted.queries += s.query >= 0;
        counted.far += cached.is_far(k);
        counted.untrusted += !trusted;
        counted.counts.rays += s.n_rays;
    }
    void finish(std::uint64_t pixel) {
        film.set(pixel, sums);
        sums = {};
        for (int c = 0; c < 3; ++c) error_layer[3 * pixel + std::size_t(c)] = error[c] / float(n_in_pixel);
        error = {};
        n_in_pixel = 0;
        const Discrepancy& d = discrepancy;
        if (const auto n = double(d.n); d.n >= 2) {
            PixelDiscrepancy& out = discrepancies[pixel];
            out.counts = true;
            for (std::size_t c = 0; c < 3; ++c) {
                out.bias += float(d.sum[c] / n / 3);
                out.of_paths += float(d.of_paths[c] / n / 3);
                out.product += float((sqr(d.sum[c]) - d.square[c]) / (n * (n - 1)) / 3);
            }
        }
        discrepancy = {};
    }
};

}  // namespace

Image render_cached(const ScenePair& scenes, const Edit& edit, const CacheReader& cache, const CachedOptions& options,
                    const PathOptions& path, const Work& work, app::Report& report, CachedCounts& counts) {
    const Sensor& sensor = scenes.new_scene.sensor;
    const Surroundings around(scenes, edit, cache.cache(), options.masked);
    std::optional<DynamicScenes> dynamic;
    if (!edit.nothing()) dynamic.emplace(scenes.old_scene, scenes.new_scene, edit);
    Film film(sensor.width, sensor.height, work.spp);
    tracing::NonfiniteLog log(report, sensor.width, path.seed);
    const SeenEmission seen =
        path.max_depth != 0 ? SeenEmission(scenes.new_scene, path.seed, work.spp, work.threads) : SeenEmission();
    app::Progress progress(report, "tracing", sensor.n_pixels() * work.spp);
    std::vector<float> errors(3 * sensor.n_pixels());
    std::vector<PixelDiscrepancy> discrepancies(sensor.n_pixels());
    PathOptions of_pairs = path;
    of_pairs.rr_depth = std::min(path.rr_depth, first_roulette_of_pairs);
    tbb::enumerable_thread_specific<Worker> workers([&] {
        Worker worker{CachePaths(scenes, around, cache, options.masked, path),
                      PathsForCache(scenes.new_scene, path),
                      {},
                      log,
                      film,
                      errors,
                      discrepancies,
                      options.masked,
                      scenes.new_scene,
                      seen};
        if (dynamic) worker.pairs.emplace(*dynamic, of_pairs);
        return worker;
    });
    tracing::trace_pixels(
        workers, sensor.n_pixels(), double(work.spp), work.threads,
        [&](std::uint64_t) {
            return tracing::SampleRange{work.first_sample, work.spp};
        },
        progress);

    // Sum the counters.
    counts = {};
    counts.counts.nonfinite = log.count();
    counts.counts.rays += seen.n_rays();
    for (const Worker& w : workers) {
        counts.counts.add(w.counted.counts);
        counts.samples += w.counted.samples;
        counts.masked += w.counted.masked;
        counts.queries += w.counted.queries;
        counts.far += w.counted.far;
        counts.untrusted += w.counted.untrusted;
        if (!w.pairs) continue;
        counts.counts.add(w.pairs->counts_new);
        counts.counts.add(w.pairs->counts_old);
        counts.touched += w.pairs->n_touched;
    }
    double bias = 0, product = 0, of_paths = 0, n = 0;
    for (const PixelDiscrepancy& d : discrepancies)
        if (d.counts) bias += double(d.bias), product += double(d.product), of_paths += double(d.of_paths), ++n;
    if (of_paths > 0) {
        counts.bias = bias / of_paths;
        counts.error = product > 0 ? std::sqrt(product / n) / (of_paths / n) : 0;
    }
    Image image = std::move(film).finish({});
    seen.add_to(image);
    image.set_layer("CacheError", "RGB", errors);
    return image;
}

}  // namespace loom::residual
