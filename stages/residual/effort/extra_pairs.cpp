#include "stages/residual/effort/extra_pairs.h"

#include <tbb/enumerable_thread_specific.h>

#include <algorithm>
#include <cmath>
#include <string>

#include "stages/core/sampling/streams.h"
#include "stages/residual/dynamic/camera_paths.h"

namespace loom::residual {
namespace {

constexpr const char* rgb[] = {"R", "G", "B"};
/// Share of sparse pairs that is spread evenly; with half of them outliers of quiet pixels are worse (cornell-box).
constexpr double even_share = 0.75;
/// Largest share of them for pixels where the old paths say nothing.
constexpr double most_covered = 0.75;

class CameraPairs : public PairTracer {
  public:
    CameraPairs(const DynamicScenes& scenes, const PathOptions& path) : paths_(scenes, path) {}

    void trace(std::span<const PathId> ids, std::span<PairValue> values) override {
        paths_.trace(ids);
        for (std::size_t k = 0; k < ids.size(); ++k) {
            const Spectrum& after = paths_.L_new(k);
            values[k] = {after - paths_.difference(k), after};
        }
        counts = {};
        counts.add(paths_.counts_new);
        counts.add(paths_.counts_old);
    }

  private:
    CameraPaths paths_;
};

/// State of one thread.
struct Worker {
    std::unique_ptr<PairTracer> tracer;
    PairSums& sums;
    std::vector<PairValue> values;

    void trace(std::span<const PathId> ids) {
        values.resize(ids.size());
        tracer->trace(ids, values);
    }
    void add(std::size_t k, PathId id) {
        for (int c = 0; c < 3; ++c)
            sums[id.pixel][std::size_t(c)].add(double(values[k].before[c]), double(values[k].after[c]));
    }
    void finish(std::uint64_t) {}
};

PairMoments of_residual(double mean, double var_mean, std::uint64_t n) {
    PairMoments moments;
    moments.n = n;
    moments.after = mean;
    moments.of_after = var_mean * double(n) * double(n - 1);
    return moments;
}

/// Moments of the differences alone.
PairMoments differences(const PairMoments& pairs) {
    PairMoments moments;
    moments.n = pairs.n;
    moments.after = pairs.mean(1);
    moments.of_after = pairs.of_after - 2 * pairs.of_both + pairs.of_before;
    return moments;
}

}  // namespace

MakeTracer camera_pairs(const DynamicScenes& scenes, const PathOptions& path) {
    return [&scenes, path] { return std::make_unique<CameraPairs>(scenes, path); };
}

PairSums trace_pairs(const Sensor& sensor, const std::vector<std::uint32_t>& pairs, std::uint64_t first,
                     const MakeTracer& make, int threads, app::Report& report, tracing::Counts& counts) {
    PairSums sums(sensor.n_pixels());
    std::uint64_t all = 0;
    for (const std::uint32_t n : pairs) all += n;
    app::Progress progress(report, "tracing", all);
    tbb::enumerable_thread_specific<Worker> workers([&] { return Worker{make(), sums, {}}; });
    tracing::trace_pixels(
        workers, sensor.n_pixels(), double(all) / double(sensor.n_pixels()), threads,
        [&](std::uint64_t pixel) {
            return tracing::SampleRange{first, pairs[pixel]};
        },
        progress);
    for (const Worker& worker : workers) counts.add(worker.tracer->counts);
    return sums;
}

PairMoments pooled(const PairMoments& a, const PairMoments& b) {
    PairMoments all = a;
    all.n = a.n + b.n;
    if (all.n == 0) return all;
    const double share = double(b.n) / double(all.n), weight = double(a.n) * share, before = b.before - a.before,
                 after = b.after - a.after;
    all.before += share * before;
    all.after += share * after;
    all.of_before += b.of_before + weight * before * before;
    all.of_after += b.of_after + weight * after * after;
    all.of_both += b.of_both + weight * before * after;
    return all;
}

std::vector<double> variances_of_pairs(const Image& residual, std::uint64_t samples, const ControlSums* control) {
    std::vector<double> variances(residual.n_pixels(), 0.0);
    for (int c = 0; c < 3; ++c) {
        const auto var_mean = residual.find(std::string("VarMean.") + rgb[c]);
        for (std::size_t p = 0; p < variances.size(); ++p) {
            const auto* const own = control ? control->pairs(p) : nullptr;
            const PairMoments* const pairs = own ? &(*own)[std::size_t(c)] : nullptr;
            const double v = pairs && pairs->n > 0 ? pairs->var_mean(double(control->alpha[p][c])) * double(pairs->n)
                                                   : double(var_mean[p]) * double(samples);
            if (std::isfinite(v)) variances[p] += v;
        }
    }
    return variances;
}

void add_pairs(const PairSums& pairs, std::uint64_t samples, Image& residual, ControlSums* control) {
    for (int c = 0; c < 3; ++c) {
        const auto k = std::size_t(c);
        const auto mean = residual.add(rgb[c]), var_mean = residual.add(std::string("VarMean.") + rgb[c]);
        for (std::size_t p = 0; p < pairs.size(); ++p) {
            if (auto* const own = control ? control->pairs(p) : nullptr; own && (*own)[k].n > 0)
                (*own)[k] = pooled((*own)[k], pairs[p][k]);
            if (pairs[p][k].n == 0) continue;
            const PairMoments all =
                pooled(of_residual(double(mean[p]), double(var_mean[p]), samples), differences(pairs[p][k]));
            mean[p] = float(all.after);
            var_mean[p] = float(all.var_mean(0));
        }
    }
    if (!residual.ledger.empty()) residual.ledger.back().var_mean = mean_var_mean(residual);
}

Estimated SparsePairs::of(std::size_t pixel, int channel, double alpha) const {
    const PairMoments& pairs = sums[pixel][std::size_t(channel)];
    if (pairs.n == 0) return {};
    const double n = double(pairs.n), mean = pairs.mean(alpha);
    if (certain[pixel] && pairs.n > 1) return {mean, pairs.var_mean(alpha)};
    const double squares =
        n * mean * mean + pairs.of_after - 2 * alpha * pairs.of_both + alpha * alpha * pairs.of_before;
    const double divisor = certain[pixel] ? n : expected[pixel];
    return {n * mean / divisor, std::max(squares, 0.0) / (divisor * divisor)};
}

SparsePairs trace_sparse_pairs(const Sensor& sensor, const std::vector<Spectrum>& alpha, const SparseOptions& options,
                               const MakeTracer& make, app::Report& report, tracing::Counts& counts) {
    const std::size_t n_pixels = sensor.n_pixels();
    // Spread a part evenly. Where the old paths say nothing a pixel without a pair would be black.
    std::vector<std::uint8_t> takes(n_pixels, 1);
    double n_covered = 0;
    for (std::size_t p = 0; p < n_pixels && !options.even; ++p)
        if (alpha[p] != Spectrum(1)) takes[p] = 0, ++n_covered;
    const double all_wanted = options.mean * double(n_pixels),
                 covered =
                     n_covered > 0 ? std::min(std::max(options.mean, 1.0), most_covered * all_wanted / n_covered) : 0,
                 mean = (all_wanted - n_covered * covered) / std::max(double(n_pixels) - n_covered, 1.0),
                 even = options.even ? options.mean : even_share * mean;
    SparsePairs sparse;
    for (const std::uint8_t takes_part : takes) sparse.expected.push_back(takes_part ? even : covered);
    const std::vector<std::uint32_t> first = dithered(sensor, sparse.expected, options.seed);
    sparse.sums = trace_pairs(sensor, first, 0, make, options.threads, report, counts);
    for (const double expected : sparse.expected) sparse.certain.push_back(expected >= 1);
    std::uint64_t all = 0;
    for (const std::uint32_t n : first) all += n;

    if (!options.even) {
        // Find the map, and spread the rest by it.
        std::vector<double> sizes(n_pixels, 0.0);
        for (std::size_t p = 0; p < n_pixels; ++p)
            for (int c = 0; c < 3; ++c) {
                const PairMoments& pairs = sparse.sums[p][std::size_t(c)];
                const double mean = pairs.mean(double(alpha[p][c]));
                if (std::isfinite(mean)) sizes[p] += std::abs(mean) * double(pairs.n);
            }
        const PairCounts rest =
            pairs_by_size(sensor, sizes, first, takes, mean - even, streams::numbered(options.seed, 1));
        // Sample indices behind those of the even part, which differ by at most one between pixels.
        const PairSums more = trace_pairs(sensor, rest.pairs, std::uint64_t(std::max(even, covered)) + 1, make,
                                          options.threads, report, counts);
        for (std::size_t p = 0; p < n_pixels; ++p) {
            for (std::size_t c = 0; c < 3; ++c) sparse.sums[p][c] = pooled(sparse.sums[p][c], more[p][c]);
            sparse.expected[p] += rest.expected[p];
            sparse.certain[p] = sparse.certain[p] || rest.expected[p] >= 1;
        }
        all += rest.all();
    }
    sparse.mean = double(all) / double(n_pixels);
    return sparse;
}

}  // namespace loom::residual
