#include "stages/residual/adaptive_pairs.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "stages/core/tracing/film.h"

namespace loom::residual {
namespace {

constexpr const char* rgb[] = {"R", "G", "B"};
constexpr std::uint64_t camera_rays = 4;  // of a pixel, for the first hits of sparse pairs

/// Traces camera rays alone, and keeps the layers of their first hits.
Image first_hits(const Scene& scene, PathOptions path, int threads, tracing::Counts& counts) {
    const Sensor& sensor = scene.sensor;
    path.max_depth = 1;
    Film film(sensor.width, sensor.height, camera_rays);
    struct Worker {
        PathBatch batch;
        Film& film;
        std::vector<PathResult> results;
        PixelSums sums;
        tracing::Counts counts;

        void trace(std::span<const PathId> ids) {
            results.resize(ids.size());
            batch.trace(ids, results);
        }
        void add(std::size_t k, PathId) {
            sums.add(Spectrum(0), results[k].first);
            counts.add(results[k]);
        }
        void finish(std::uint64_t pixel) {
            film.set(pixel, sums);
            sums = {};
        }
    };
    app::Report none;
    none.set_quiet(true);
    app::Progress progress(none, "", sensor.n_pixels() * camera_rays);
    tbb::enumerable_thread_specific<Worker> workers([&] { return Worker{PathBatch(scene, path), film, {}, {}, {}}; });
    tracing::trace_pixels(
        workers, sensor.n_pixels(), double(camera_rays), threads,
        [](std::uint64_t) {
            return tracing::SampleRange{0, camera_rays};
        },
        progress);
    for (const Worker& worker : workers) counts.add(worker.counts);
    return std::move(film).finish({});
}

void set_estimates(const SparsePairs& pairs, const std::vector<Spectrum>& alpha, Image& image) {
    for (int c = 0; c < 3; ++c) {
        const auto mean = image.add(rgb[c]), var_mean = image.add(std::string("VarMean.") + rgb[c]);
        for (std::size_t p = 0; p < mean.size(); ++p) {
            const Estimated value = pairs.of(p, c, double(alpha[p][c]));
            mean[p] = float(value.mean);
            var_mean[p] = float(value.var_mean);
        }
    }
}

}  // namespace

ExtraPairs trace_extra_pairs(const ScenePair& scenes, const Edit& edit, const AdaptiveOptions& options,
                             const Image& residual, std::uint64_t samples, const ControlSums* control,
                             app::Report& report) {
    const Sensor& sensor = scenes.new_scene.sensor;
    const DynamicScenes dynamic(scenes.old_scene, scenes.new_scene, edit);
    const PairCounts wanted =
        pairs_by_deviation(sensor, variances_of_pairs(residual, samples, control), options.mean, options.path.seed);
    ExtraPairs extra;
    extra.sums = trace_pairs(sensor, wanted.pairs, 0, camera_pairs(dynamic, options.path), options.threads, report,
                             extra.counts);
    extra.n = wanted.all();
    const auto without = std::count(wanted.pairs.begin(), wanted.pairs.end(), 0u);
    extra.summary = fmt::format(
        "{:.3g} extra pairs per pixel by the graph's deviation, none in {:.0f} % of the pixels, "
        "at most {}",
        double(extra.n) / double(sensor.n_pixels()), 100.0 * double(without) / double(sensor.n_pixels()),
        *std::max_element(wanted.pairs.begin(), wanted.pairs.end()));
    return extra;
}

SparseResidual render_sparse_residual(const ScenePair& scenes, const Edit& edit, const AdaptiveOptions& options,
                                      const std::vector<Spectrum>& alpha, app::Report& report) {
    const Sensor& sensor = scenes.new_scene.sensor;
    const DynamicScenes dynamic(scenes.old_scene, scenes.new_scene, edit);
    const std::vector<Spectrum> ones(sensor.n_pixels(), Spectrum(1));
    SparseResidual out;
    out.image = first_hits(scenes.new_scene, options.path, options.threads, out.counts);
    const SparsePairs pairs = trace_sparse_pairs(sensor, alpha.empty() ? ones : alpha,
                                                 {options.mean, options.even, options.path.seed, options.threads},
                                                 camera_pairs(dynamic, options.path), report, out.counts);
    set_estimates(pairs, ones, out.image);
    if (!alpha.empty()) {
        out.weighted = out.image;
        set_estimates(pairs, alpha, out.weighted);
    }
    out.n = std::uint64_t(std::llround(pairs.mean * double(sensor.n_pixels())));
    out.image.samples = std::max<std::uint64_t>(1, std::uint64_t(std::llround(pairs.mean)));
    out.weighted.samples = out.image.samples;
    LedgerLink& link = out.image.ledger.emplace_back();
    link.method = "sparse";
    link.samples = out.image.samples;
    link.seed = options.path.seed;
    link.var_mean = mean_var_mean(out.image);
    out.summary = fmt::format("{:.3g} pairs per pixel, {}", pairs.mean,
                              options.even ? "evenly" : "some of them where the others find a difference");
    return out;
}

}  // namespace loom::residual
