#include "stages/residual/estimators.h"

#include <tbb/enumerable_thread_specific.h>

#include <cmath>
#include <memory>
#include <numeric>
#include <span>
#include <vector>

#include "stages/core/sampling/streams.h"
#include "stages/core/tracing/film.h"
#include "stages/residual/stored/path_parts.h"

namespace loom::residual {
namespace {

/// State of one thread, reused between chunks.
struct Worker {
    PathBatch old_batch, new_batch;
    std::vector<PathResult> old_results, new_results;
    tracing::NonfiniteLog &old_nonfinite, &new_nonfinite;
    Film& film;
    PixelSums sums;
    PathVariance new_L;
    std::span<double> new_var;  // [pixel] of one path of the new scene, sum over R, G, B
    Counts counts;
    PartSums* parts;
    std::unique_ptr<RecordedPaths> old_recorded, new_recorded;  // with parts
    Worker(const ScenePair& scenes, const PathOptions& path, const Seeds& seeds, tracing::NonfiniteLog& old_log,
           tracing::NonfiniteLog& new_log, Film& onto, std::span<double> variances, PartSums* part_sums)
        : old_batch(scenes.old_scene, with_seed(path, seeds.old_scene)),
          new_batch(scenes.new_scene, with_seed(path, seeds.new_scene)),
          old_nonfinite(old_log),
          new_nonfinite(new_log),
          film(onto),
          new_var(variances),
          parts(part_sums) {
        if (!parts) return;
        old_recorded = std::make_unique<RecordedPaths>(scenes.old_scene, with_seed(path, seeds.old_scene));
        new_recorded = std::make_unique<RecordedPaths>(scenes.new_scene, with_seed(path, seeds.new_scene));
    }

    void trace(std::span<const PathId> ids) {
        old_results.resize(ids.size());
        new_results.resize(ids.size());
        if (parts) return trace_parts(ids);
        old_batch.trace(ids, old_results);
        new_batch.trace(ids, new_results);
    }
    void trace_parts(std::span<const PathId> ids) {
        const StoredPaths &before = old_recorded->trace(ids, old_results),
                          &after = new_recorded->trace(ids, new_results);
        for (std::size_t k = 0; k < ids.size(); ++k) {
            const PathOptions& path = after.options();
            const Sampler sampler(path.sampler, path.seed, ids[k].pixel, ids[k].sample);
            parts->add(ids[k].pixel, parts->finder().of(before, k, old_recorded->first_edge(k), after, k,
                                                        new_recorded->first_edge(k), sampler));
        }
    }
    void add(std::size_t k, PathId id) {
        const PathResult &before = old_results[k], &after = new_results[k];
        old_nonfinite.check(before.L, id);
        new_nonfinite.check(after.L, id);
        sums.add(after.L - before.L, after.first);
        new_L.add(after.L);
        counts.add(before);
        counts.add(after);
    }
    void finish(std::uint64_t pixel) {
        film.set(pixel, sums);
        sums = {};
        new_var[pixel] = new_L.take();
    }
};

}  // namespace

const char* method_name(Method method) {
    switch (method) {
        case Method::automatic:
            return "auto";
        case Method::correlated:
            return "correlated";
        case Method::independent:
            return "independent";
        case Method::dynamic:
            return "dynamic";
    }
    return "";
}

Seeds seeds_of(Method method, std::uint64_t seed) {
    const std::uint64_t mine = streams::residual(seed);
    return {mine, method == Method::independent ? streams::independent_of(mine) : mine};
}

Image render_residual(const ScenePair& scenes, Method method, const PathOptions& path, const Work& work,
                      app::Report& report, Counts& counts, PartSums* parts) {
    const Sensor& sensor = scenes.new_scene.sensor;
    const Seeds seeds = seeds_of(method, path.seed);
    Film film(sensor.width, sensor.height, work.spp);
    tracing::NonfiniteLog old_log(report, sensor.width, seeds.old_scene, " of the old scene"),
        new_log(report, sensor.width, seeds.new_scene, " of the new scene");
    app::Progress progress(report, "tracing", sensor.n_pixels() * work.spp);
    std::vector<double> new_var(sensor.n_pixels());
    tbb::enumerable_thread_specific<Worker> workers(
        [&] { return Worker(scenes, path, seeds, old_log, new_log, film, new_var, parts); });
    tracing::trace_pixels(
        workers, sensor.n_pixels(), double(work.spp), work.threads,
        [&](std::uint64_t) {
            return tracing::SampleRange{work.first_sample, work.spp};
        },
        progress);
    counts = {0, 0, old_log.count() + new_log.count()};
    for (const Worker& worker : workers) counts.add(worker.counts);
    Image image = std::move(film).finish({});
    if (parts) parts->write(image, work.spp);
    LedgerLink& link = image.ledger.emplace_back();
    link.method = method_name(method);
    link.samples = work.spp;
    link.seed = path.seed;
    link.var_mean = mean_var_mean(image);
    link.var_sample = std::accumulate(new_var.begin(), new_var.end(), 0.0) /
                      (3.0 * double(new_var.size()));  // in the order of pixels, equal for any number of threads
    return image;
}

}  // namespace loom::residual
