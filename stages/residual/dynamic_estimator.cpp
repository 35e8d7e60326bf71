#include "stages/residual/dynamic_estimator.h"

#include <fmt/format.h>
#include <tbb/enumerable_thread_specific.h>

#include <numeric>

#include "stages/core/app/report.h"
#include "stages/core/compute/parallel.h"
#include "stages/core/sampling/streams.h"
#include "stages/core/tracing/film.h"
#include "stages/residual/control/controlled.h"
#include "stages/residual/dynamic/camera_paths.h"
#include "stages/residual/effort/control_weights.h"

namespace loom::residual {
namespace {

constexpr std::uint64_t samples_per_chunk = 1024, chunks_per_round = 64;

struct Splat {
    std::uint32_t pixel;
    Radiance value;
};

/// Contributions of one sample to the image, one per pixel.
class Splats {
  public:
    void add(std::uint32_t pixel, const Radiance& value) {
        for (Splat& s : of_sample_)
            if (s.pixel == pixel) {
                s.value += value;
                return;
            }
        of_sample_.push_back({pixel, value});
    }
    void end_sample(std::vector<Splat>& out) {
        out.insert(out.end(), of_sample_.begin(), of_sample_.end());
        of_sample_.clear();
    }

  private:
    std::vector<Splat> of_sample_;
};

/// Image of the samples that start from sites: sums, and sums of squares per sample.
struct SitePicture {
    std::vector<Radiance> sum, square;
};

class Estimator {
  public:
    Estimator(const DynamicScenes& scenes, const std::vector<Family>& families, const Effort& effort,
              const DynamicOptions& options, const PathOptions& path, int threads)
        : scenes_(scenes), families_(families), effort_(effort), options_(options), path_(path), threads_(threads) {
        pairs_ = options.pairs;
        pairs_.mapping = options.pairs.mapping && options.only_family < 0;
    }

    PathPairs pairs() const { return {scenes_, families_, effort_.samples, effort_.first_to_camera, path_, pairs_}; }
    bool wanted(std::size_t family) const { return options_.only_family < 0 || options_.only_family == int(family); }
    Radiance weighted(const Part& part) const {
        const double n = effort_.per_pixel[part.pixel];
        if (options_.weighted || options_.only_family < 0)
            return part.value * (1 / (part.density.site_density + n * part.h * part.density.camera_density));
        return part.value * (1 / (part.by_camera ? n * part.h * part.density.camera_density : part.own));
    }

    /// in:      first  index of the first sample of a family over its number of samples
    void add_from_sites(double first, SitePicture& picture, Counts& counts, std::uint64_t& unrelocated,
                        app::Progress& progress) const {
        const std::uint64_t n_pixels = picture.sum.size();
        struct Worker {
            PathPairs pairs;
            Splats splats;
            NumbersBlock numbers;
        };
        tbb::enumerable_thread_specific<Worker> workers([&] { return Worker{pairs(), {}, {}}; });
        std::vector<Radiance> family_sum(n_pixels);
        for (std::size_t f = 0; f + 1 < families_.size(); ++f) {
            const auto n_samples = std::uint64_t(effort_.samples[f]);
            if (!wanted(f) || n_samples == 0) continue;
            std::fill(family_sum.begin(), family_sum.end(), Radiance());
            const std::uint64_t first_sample = std::uint64_t(first * double(n_samples)),
                                seed = streams::family(path_.seed, f);
            for (std::uint64_t round = 0; round < n_samples; round += samples_per_chunk * chunks_per_round) {
                const std::uint64_t n = std::min(samples_per_chunk * chunks_per_round, n_samples - round);
                std::vector<std::vector<Splat>> found(chunks_per_round);
                parallel_chunks(
                    n, samples_per_chunk, threads_, [&](std::uint64_t chunk, std::uint64_t begin, std::uint64_t end) {
                        Worker& w = workers.local();
                        for (std::uint64_t i = begin; i < end; ++i) {
                            w.pairs.from_site(f, w.numbers.of(path_.sampler, seed, first_sample + round + i),
                                              [&](const Part& part) { w.splats.add(part.pixel, weighted(part)); });
                            w.splats.end_sample(found[chunk]);
                        }
                        progress.add(end - begin);
                    });
                // In the order of the samples, so that sums do not depend on the number of threads.
                for (const std::vector<Splat>& splats : found)
                    for (const Splat& s : splats) {
                        family_sum[s.pixel] += s.value;
                        picture.square[s.pixel] += s.value * s.value;
                    }
            }
            for (std::uint64_t i = 0; i < n_pixels; ++i) {
                picture.sum[i] += family_sum[i];
                picture.square[i] = picture.square[i] - family_sum[i] * family_sum[i] * (1.0 / double(n_samples));
            }
        }
        for (const Worker& w : workers) {
            counts.add({w.pairs.rays(), w.pairs.vertices(), w.pairs.nonfinite});
            unrelocated += w.pairs.unrelocated();
        }
    }

    /// Renders camera paths, as plain pairs if they are the only family, else weighted against the other families.
    /// in:      control  null, or with weights; only if camera paths are the only family
    Film from_camera(std::uint64_t first_sample, ControlSums* control, DynamicCounts& counts, app::Report& report,
                     app::Progress& progress) const;

  private:
    const DynamicScenes& scenes_;
    const std::vector<Family>& families_;
    const Effort& effort_;
    const DynamicOptions& options_;
    const PathOptions& path_;
    PathPairs::Options pairs_;
    int threads_;
};

/// State of one thread, for trace_pixels().
struct CameraWorker {
    const Estimator& estimator;
    const Effort& effort;
    const PathOptions& path;
    bool alone, wanted;
    CameraPaths cameras;
    PathPairs pairs;
    std::vector<Spectrum> values;
    tracing::NonfiniteLog& log;
    Film& film;
    std::span<double> new_var;  // [pixel] variance of one new path, sum over channels
    ControlSums* control;
    PixelSums sums;
    PathVariance new_L;

    void trace(std::span<const PathId> ids) {
        values.assign(ids.size(), Spectrum());
        if (alone) {
            cameras.trace(ids);
            for (std::size_t k = 0; k < ids.size(); ++k) values[k] = cameras.difference(k);
            return;
        }
        cameras.trace_new(ids);
        if (!wanted) return;
        for (std::size_t k = 0; k < ids.size(); ++k) {
            if (!cameras.touched(k)) continue;
            Radiance sum;
            pairs.from_camera(ids[k], Sampler(path.sampler, path.seed, ids[k].pixel, ids[k].sample),
                              [&](const Part& part) { sum += estimator.weighted(part); });
            values[k] = Spectrum(sum * double(effort.per_pixel[ids[k].pixel]));
        }
    }
    void add(std::size_t k, PathId id) {
        log.check(values[k], id);
        sums.add(values[k], cameras.first(k));
        const Spectrum& L = cameras.L_new(k);
        new_L.add(L);
        if (!control) return;
        for (int c = 0; c < 3; ++c)
            (*control->pairs(id.pixel))[std::size_t(c)].add(double(L[c]) - double(values[k][c]), double(L[c]));
    }
    void finish(std::uint64_t pixel) {
        film.set(pixel, sums);
        sums = {};
        new_var[pixel] = new_L.take();
    }
};

Film Estimator::from_camera(std::uint64_t first_sample, ControlSums* control, DynamicCounts& counts,
                            app::Report& report, app::Progress& progress) const {
    const Sensor& sensor = scenes_.new_scene.scene.sensor;
    std::uint64_t n = 0;
    for (const std::uint32_t of_pixel : effort_.per_pixel) n += of_pixel;
    Film film(sensor.width, sensor.height, n / sensor.n_pixels());
    tracing::NonfiniteLog log(report, sensor.width, path_.seed, " of the difference");
    std::vector<double> new_var(sensor.n_pixels());
    const bool alone = effort_.cameras_alone() && options_.only_family < 0;
    tbb::enumerable_thread_specific<CameraWorker> workers([&] {
        return CameraWorker{*this,
                            effort_,
                            path_,
                            alone,
                            wanted(families_.size() - 1),
                            CameraPaths(scenes_, path_),
                            pairs(),
                            {},
                            log,
                            film,
                            new_var,
                            control,
                            {},
                            {}};
    });
    tracing::trace_pixels(
        workers, sensor.n_pixels(), double(n) / double(sensor.n_pixels()), threads_,
        [&](std::uint64_t pixel) {
            return tracing::SampleRange{first_sample, effort_.per_pixel[pixel]};
        },
        progress);
    for (const CameraWorker& w : workers) {
        counts.counts.add(w.cameras.counts_new);
        counts.counts.add(w.cameras.counts_old);
        counts.counts.add({w.pairs.rays(), w.pairs.vertices(), w.pairs.nonfinite});
    }
    counts.counts.nonfinite += log.count();
    counts.var_sample = std::accumulate(new_var.begin(), new_var.end(), 0.0) /
                        (3.0 * double(new_var.size()));  // in the order of pixels, equal for any number of threads
    return film;
}

constexpr const char* rgb[] = {"R", "G", "B"};

}  // namespace

Image render_dynamic(const ScenePair& pair, const Edit& edit, const DynamicOptions& options,
                     const PathOptions& path_options, const Work& work, app::Report& report, DynamicCounts& counts) {
    const DynamicScenes scenes(pair.old_scene, pair.new_scene, edit);
    const std::vector<Family> families = families_of(scenes);
    const Sensor& sensor = pair.new_scene.sensor;
    const std::uint64_t n_pixels = sensor.n_pixels();
    PathOptions path = path_options;
    path.seed = seeds_of(Method::correlated, path.seed).new_scene;

    Effort effort;
    std::uint64_t first_sample = work.first_sample;
    if (!options.pilot) {
        effort = equal_effort(families, sensor, work.spp);
    } else if (work.spp < least_spp) {
        effort = camera_effort(families, sensor, work.spp);
        effort.why = fmt::format("camera paths alone, evenly: --spp {} is too small for a pilot, which needs {}",
                                 work.spp, least_spp);
    } else {
        // The number of samples is not known beforehand, so each pass has its own seed, and the pilot too.
        path.seed = streams::pass(path.seed, work.first_sample);
        first_sample = 0;
        PathOptions pilot = path;
        pilot.seed = streams::pilot(path.seed);
        effort = effort_by_pilot(scenes, families, {options.pairs, options.adaptive_map, options.must_gain}, pilot,
                                 work, counts.counts);
    }
    counts.effort = effort.why;
    if (!effort.why.empty()) report.info("{}", effort.why);

    double n_all = 0;
    for (const std::uint32_t n : effort.per_pixel) n_all += n;
    for (std::size_t f = 0; f + 1 < families.size(); ++f) n_all += effort.samples[f];
    app::Progress progress(report, "sampling", std::uint64_t(n_all));
    const Estimator estimator(scenes, families, effort, options, path, work.threads);
    SitePicture sites{std::vector<Radiance>(n_pixels), std::vector<Radiance>(n_pixels)};
    estimator.add_from_sites(double(first_sample) / double(work.spp), sites, counts.counts, counts.n_unrelocated,
                             progress);
    std::optional<ControlSums> control;
    const bool controlled = options.old_picture && effort.cameras_alone() && !effort.covariance[0].empty();
    if (controlled) control.emplace(control_weights(sensor, effort, *options.old_picture), false, true);
    Image image =
        estimator.from_camera(first_sample, control ? &*control : nullptr, counts, report, progress).finish({});
    image.samples = work.spp;
    if (control) counts.controlled = controlled_picture(*options.old_picture, image, *control);
    for (int c = 0; c < 3; ++c) {
        const auto mean = image.add(rgb[c]);
        for (std::uint64_t i = 0; i < n_pixels; ++i) mean[i] = float(mean[i] + sites.sum[i][c]);
        const auto var = image.add(std::string("VarMean.") + rgb[c]);
        for (std::uint64_t i = 0; i < n_pixels; ++i) var[i] = float(var[i] + std::max(sites.square[i][c], 0.0));
    }
    return image;
}

}  // namespace loom::residual
