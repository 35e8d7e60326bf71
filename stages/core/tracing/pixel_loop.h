#pragma once
// Loop of the stages that trace every pixel from the camera and keep only sums: pixel by pixel, sample by sample, in
// batches that may end inside a pixel.

#include <tbb/enumerable_thread_specific.h>

#include <algorithm>
#include <atomic>
#include <cstdint>
#include <string>
#include <vector>

#include "stages/core/app/report.h"
#include "stages/core/compute/parallel.h"
#include "stages/core/tracing/path_tracer.h"

namespace loom::tracing {

/// Which samples of each pixel to trace, on how many threads (0: all).
struct Work {
    std::uint64_t first_sample = 0, spp = 1;
    int threads = 0;
};

/// Counters of a trace.
struct Counts {
    std::uint64_t rays = 0, vertices = 0, nonfinite = 0;
    void add(const PathResult& path) {
        rays += path.n_rays;
        vertices += path.n_vertices;
    }
    void add(const Counts& other) {
        rays += other.rays;
        vertices += other.vertices;
        nonfinite += other.nonfinite;
    }
};

/// Counts samples that are not finite (they are never dropped) and reports the first few with their replay command.
/// Thread-safe.
class NonfiniteLog {
  public:
    /// in:      of  name of the scene if there are several, as " of the old scene"; else empty
    NonfiniteLog(app::Report& report, std::uint64_t width, std::uint64_t seed, std::string of = "")
        : report_(report), width_(width), seed_(seed), of_(std::move(of)) {}
    void check(const Spectrum& L, PathId id) {
        if (all_finite(L)) return;
        const std::uint64_t x = id.pixel % width_, y = id.pixel / width_;
        if (count_.fetch_add(1) < 5)
            report_.warn(
                "not finite: pixel ({}, {}), sample {}{}; replay it with loom-trace --seed {} --replay {},{},{}", x, y,
                id.sample, of_, seed_, x, y, id.sample);
    }
    std::uint64_t count() const { return count_; }

  private:
    app::Report& report_;
    std::uint64_t width_, seed_;
    std::string of_;
    std::atomic<std::uint64_t> count_{0};
};

/// Samples of one pixel, as a range of indices.
struct SampleRange {
    std::uint64_t first = 0, n = 0;
};

/// Traces `samples_of(pixel)` of every pixel. A pixel belongs to one thread; its samples come in order.
/// in:      workers  one Worker per thread, kept from chunk to chunk, with
///                    trace(std::span<const PathId>)   trace a batch of paths, at most PathBatch::capacity
///                    add(k, PathId)                   add the k-th path of the batch to its pixel
///                    finish(pixel)                    end a pixel after its last sample; never without samples
///          mean_spp   approximate samples per pixel, to divide the work into chunks
template <class Worker, class SamplesOf>
void trace_pixels(tbb::enumerable_thread_specific<Worker>& workers, std::uint64_t n_pixels, double mean_spp,
                  int threads, SamplesOf&& samples_of, app::Progress& progress) {
    // Small enough to balance two threads, large enough to hide the overhead of a task.
    constexpr std::uint64_t paths_per_chunk = 4096;
    const std::uint64_t pixels_per_chunk = std::clamp<std::uint64_t>(
        std::uint64_t(double(paths_per_chunk) / std::max(mean_spp, 1.0)), 16, paths_per_chunk);
    parallel_chunks(n_pixels, pixels_per_chunk, threads, [&](std::uint64_t, std::uint64_t begin, std::uint64_t end) {
        Worker& worker = workers.local();
        std::vector<PathId> ids;
        ids.reserve(PathBatch::capacity);
        const auto trace = [&] {
            worker.trace(ids);
            for (std::size_t k = 0; k < ids.size(); ++k) {
                worker.add(k, ids[k]);
                const SampleRange samples = samples_of(ids[k].pixel);
                if (ids[k].sample + 1 == samples.first + samples.n) worker.finish(ids[k].pixel);
            }
            progress.add(ids.size());
            ids.clear();
        };
        for (std::uint64_t pixel = begin; pixel < end; ++pixel) {
            const SampleRange samples = samples_of(pixel);
            for (std::uint64_t i = 0; i < samples.n; ++i) {
                ids.push_back({pixel, samples.first + i});
                if (ids.size() == PathBatch::capacity) trace();
            }
        }
        if (!ids.empty()) trace();
    });
}

}  // namespace loom::tracing
