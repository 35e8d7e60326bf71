#include "stages/residual/estimators.h"

#include <tbb/enumerable_thread_specific.h>

#include <algorithm>
#include <atomic>
#include <vector>

#include "stages/core/app/report.h"
#include "stages/core/transport/film.h"
#include "stages/core/transport/parallel.h"

namespace loom::residual {
namespace {

constexpr std::uint64_t paths_per_chunk = 4096;

PathOptions with_seed(PathOptions path, std::uint64_t seed) {
    path.seed = seed;
    return path;
}

/// What one thread works with, kept from chunk to chunk.
struct Worker {
    PathBatch old_batch, new_batch;
    std::vector<PathId> ids;
    std::vector<PathResult> old_results, new_results;
    Worker(const ScenePair& scenes, const PathOptions& path, const Seeds& seeds)
        : old_batch(scenes.old_scene, with_seed(path, seeds.old_scene)), new_batch(scenes.new_scene, with_seed(path, seeds.new_scene)) {}
};

}  // namespace

Seeds seeds_of(Method method, std::uint64_t seed) {
    const std::uint64_t mine = mix64(seed ^ 0x726573696475616cull);
    return {mine, method == Method::independent ? mix64(mine) : mine};
}

Image render_residual(const ScenePair& scenes, Method method, const PathOptions& path, const Work& work, app::Report& report,
                      Counts& counts) {
    const Sensor& sensor = scenes.new_scene.sensor;
    const Seeds seeds = seeds_of(method, path.seed);
    Film film(sensor.width, sensor.height, work.spp);
    std::atomic<std::uint64_t> rays{0}, vertices{0}, nonfinite{0};
    app::Progress progress(report, "tracing", sensor.n_pixels() * work.spp);
    tbb::enumerable_thread_specific<Worker> workers([&] { return Worker(scenes, path, seeds); });
    const std::uint64_t pixels_per_chunk = std::clamp<std::uint64_t>(paths_per_chunk / work.spp, 16, paths_per_chunk);
    parallel_chunks(sensor.n_pixels(), pixels_per_chunk, work.threads, [&](std::uint64_t, std::uint64_t begin, std::uint64_t end) {
        Worker& worker = workers.local();
        PixelSums sums;
        std::uint64_t my_rays = 0, my_vertices = 0;
        // Pixel by pixel, sample by sample, in batches that may end inside a pixel.
        const std::uint64_t first = begin * work.spp, last = end * work.spp;
        for (std::uint64_t i = first; i < last; i += worker.ids.size()) {
            worker.ids.resize(std::min<std::uint64_t>(PathBatch::capacity, last - i));
            for (std::size_t k = 0; k < worker.ids.size(); ++k)
                worker.ids[k] = {(i + k) / work.spp, work.first_sample + (i + k) % work.spp};
            worker.old_results.resize(worker.ids.size());
            worker.new_results.resize(worker.ids.size());
            worker.old_batch.trace(worker.ids, worker.old_results);
            worker.new_batch.trace(worker.ids, worker.new_results);
            for (std::size_t k = 0; k < worker.ids.size(); ++k) {
                const PathId id = worker.ids[k];
                const PathResult &before = worker.old_results[k], &after = worker.new_results[k];
                for (const bool is_new : {false, true}) {
                    if (all_finite((is_new ? after : before).L)) continue;
                    if (nonfinite.fetch_add(1) < 5)
                        report.warn("not finite: pixel ({}, {}), sample {} of the {} scene; replay it with loom-trace --seed {} --replay {},{},{}",
                                    id.pixel % sensor.width, id.pixel / sensor.width, id.sample, is_new ? "new" : "old",
                                    is_new ? seeds.new_scene : seeds.old_scene, id.pixel % sensor.width, id.pixel / sensor.width, id.sample);
                }
                sums.add(after.L - before.L, after.first);
                my_rays += before.n_rays + after.n_rays;
                my_vertices += before.n_vertices + after.n_vertices;
                if ((i + k + 1) % work.spp == 0) {
                    film.set(id.pixel, sums);
                    sums = {};
                }
            }
            progress.add(worker.ids.size());
        }
        rays += my_rays;
        vertices += my_vertices;
    });
    counts = {rays, vertices, nonfinite};
    return std::move(film).finish({});
}

}  // namespace loom::residual
