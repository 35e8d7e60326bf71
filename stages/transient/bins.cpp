#include <tbb/enumerable_thread_specific.h>

#include <algorithm>

#include "stages/core/app/report.h"
#include "stages/core/clusters/shared_arrivals.h"
#include "stages/core/compute/parallel.h"
#include "stages/core/graph/time_of_flight.h"
#include "stages/transient/derivative_bins.h"
#include "stages/transient/transient.h"

namespace loom::transient {
namespace {

/// Record of a pixel: sums over its paths of each bin's values, and of their squares.
class Histogram {
  public:
    explicit Histogram(std::uint32_t n_bins) : sum_(3 * n_bins), square_(3 * n_bins) {}

    void add(std::uint32_t bin, const Rgb<double>& of_path) {
        for (int c = 0; c < 3; ++c) {
            sum_[3 * bin + c] += of_path[c];
            square_[3 * bin + c] += sqr(of_path[c]);
        }
    }
    void clear() {
        std::fill(sum_.begin(), sum_.end(), 0.0);
        std::fill(square_.begin(), square_.end(), 0.0);
        before = after = never = steady = {};
    }
    /// in: n_paths  all paths;  n  samples, of equal numbers of paths
    void write(double n_paths, double n, float* mean, float* var_mean) const {
        for (std::size_t i = 0; i < sum_.size(); ++i) {
            const double m = sum_[i] / n_paths, per_path = n / n_paths;
            mean[i] = float(m);
            var_mean[i] = n > 1 ? float(std::max(square_[i] / n * sqr(per_path) - sqr(m), 0.0) / (n - 1)) : 0.0f;
        }
    }

    Rgb<double> before, after, never, steady;

  private:
    std::vector<double> sum_, square_;
};

/// State of one thread: histograms of the pixels of a chunk, and the bins that the current path has reached.
class Worker {
  public:
    Worker(const TimeResponse& response, std::size_t n_pixels, std::size_t n_parameters, bool has_own_samples)
        : histograms(n_pixels, Histogram(response.n_bins)),
          derivative(response, n_parameters),
          derivatives(n_parameters > 0 ? n_pixels : 0,
                      DerivativeHistogram(derivative.n_columns(), derivative.width(), has_own_samples)),
          response_(response),
          of_path_(response.n_bins) {}

    void clear(std::size_t n_pixels) {
        for (std::size_t i = 0; i < n_pixels; ++i) histograms[i].clear();
        for (std::size_t i = 0; i < std::min(n_pixels, derivatives.size()); ++i) derivatives[i].clear();
    }
    void add(Histogram& pixel, const Spectrum& light, double opl) {
        const Rgb<double> L(light);
        pixel.steady += L;
        if (std::isinf(opl)) {
            pixel.never += L;
            return;
        }
        const auto outside =
            response_.spread(opl, [&](std::uint32_t bin, double weight) { add_to_bin(bin, L * weight); });
        pixel.before += L * outside.before;
        pixel.after += L * outside.after;
    }
    /// Adds a light together with its derivatives; the light itself as add() does, to the bit.
    /// in:      dL, dopl  [parameter, rgb], [parameter]
    void add(Histogram& pixel, const Spectrum& light, double opl, const float* dL, const float* dopl) {
        const Rgb<double> L(light);
        pixel.steady += L;
        const auto outside = derivative.add_light(
            L, opl, dL, dopl, [&](std::uint32_t bin, double weight) { add_to_bin(bin, L * weight); });
        if (std::isinf(opl)) pixel.never += L;
        pixel.before += L * outside.before;
        pixel.after += L * outside.after;
    }
    /// Ends a sample: the sum in each bin since the last call is one sample.
    void end_sample(Histogram& pixel) {
        for (const std::uint32_t bin : touched_) {
            pixel.add(bin, of_path_[bin]);
            of_path_[bin] = {};
        }
        touched_.clear();
    }

    std::vector<Histogram> histograms;
    DerivativeBinner derivative;
    std::vector<DerivativeHistogram> derivatives;  // none without derivatives
    BoundaryRows boundary;

  private:
    void add_to_bin(std::uint32_t bin, const Rgb<double>& light) {
        if (is_black(of_path_[bin])) touched_.push_back(bin);
        of_path_[bin] += light;
    }

    const TimeResponse& response_;
    std::vector<Rgb<double>> of_path_;
    std::vector<std::uint32_t> touched_;
};

/// Rows of the cube in memory.
struct Block {
    std::vector<float> radiance, var_mean, before, after, never, steady;
    struct Derivative {
        std::vector<float> bins, var_mean, before, after, never, steady, steady_var_mean;  // [parameter, pixel, …]
    } derivative;
    std::size_t n_parameters;

    Block(std::size_t n_pixels, std::uint32_t n_bins, std::size_t n_of_parameters)
        : radiance(n_pixels * n_bins * 3),
          var_mean(radiance.size()),
          before(3 * n_pixels),
          after(before),
          never(before),
          steady(before),
          n_parameters(n_of_parameters) {
        auto& d = derivative;
        d.bins.resize(n_parameters * radiance.size());
        d.var_mean.resize(d.bins.size());
        for (std::vector<float>* of_pixels : {&d.before, &d.after, &d.never, &d.steady, &d.steady_var_mean})
            of_pixels->resize(n_parameters * before.size());
    }

    void set(std::size_t pixel, const Histogram& h, double n_paths, double n, std::uint32_t n_bins) {
        h.write(n_paths, n, &radiance[pixel * n_bins * 3], &var_mean[pixel * n_bins * 3]);
        for (int c = 0; c < 3; ++c) {
            before[3 * pixel + c] = float(h.before[c] / n_paths);
            after[3 * pixel + c] = float(h.after[c] / n_paths);
            never[3 * pixel + c] = float(h.never[c] / n_paths);
            steady[3 * pixel + c] = float(h.steady[c] / n_paths);
        }
    }
    /// in:      n_pixels  of the rows in work
    ///          n_paths   all paths of the pixel, each a sample
    void set(std::size_t pixel, const DerivativeHistogram& h, std::size_t n_pixels, double n_paths,
             std::uint32_t n_bins) {
        const std::size_t width = 3 * n_parameters;
        const auto mean = [&](std::size_t i) {
            return h.sum[i] / n_paths + (h.mean_of_samples.empty() ? 0 : h.mean_of_samples[i]);
        };
        const auto var_mean_of = [&](std::size_t i) {
            const double of_samples = h.var_of_samples.empty() ? 0 : h.var_of_samples[i];
            if (n_paths <= 1) return of_samples;
            return std::max(h.square[i] / n_paths - sqr(h.sum[i] / n_paths), 0.0) / (n_paths - 1) + of_samples;
        };
        for (std::size_t p = 0; p < n_parameters; ++p) {
            const std::size_t row = p * n_pixels + pixel;
            for (std::size_t k = 0; k < n_bins; ++k)
                for (std::size_t c = 0; c < 3; ++c) {
                    const std::size_t from = k * width + 3 * p + c, to = (row * n_bins + k) * 3 + c;
                    derivative.bins[to] = float(mean(from));
                    derivative.var_mean[to] = float(var_mean_of(from));
                }
            for (std::size_t c = 0; c < 3; ++c) {
                const auto share = [&](Share s) { return (n_bins + std::size_t(s)) * width + 3 * p + c; };
                const std::size_t to = 3 * row + c;
                derivative.before[to] = float(mean(share(Share::before)));
                derivative.after[to] = float(mean(share(Share::after)));
                derivative.never[to] = float(mean(share(Share::never)));
                derivative.steady[to] = float(mean(share(Share::steady)));
                derivative.steady_var_mean[to] = float(var_mean_of(share(Share::steady)));
            }
        }
    }
    TransientRows rows(std::size_t n_pixels, std::uint32_t n_bins) const {
        const auto first = [](const std::vector<float>& all, std::size_t n) { return std::span(all).first(n); };
        const std::size_t bins = 3 * n_pixels * n_bins, pixels = 3 * n_pixels;
        const auto of_bins = [&](const std::vector<float>& all) { return first(all, n_parameters * bins); };
        const auto of_pixels = [&](const std::vector<float>& all) { return first(all, n_parameters * pixels); };
        const auto& d = derivative;
        return {first(radiance, bins),
                first(var_mean, bins),
                first(before, pixels),
                first(after, pixels),
                first(never, pixels),
                first(steady, pixels),
                {of_bins(d.bins), of_bins(d.var_mean), of_pixels(d.before), of_pixels(d.after), of_pixels(d.never),
                 of_pixels(d.steady), of_pixels(d.steady_var_mean)}};
    }
};

/// Bins neighbouring pixels, whose light edges are consecutive.
void bin_own(Worker& worker, const GraphReader& reader, const Timing& timing, std::size_t first_pixel, std::size_t n) {
    const PathGraph& g = reader.graph();
    const OpticalLengths lengths(g, timing);
    for (std::uint64_t s = 0; s < g.tracing.samples_per_pixel; ++s) {
        const std::size_t first_path = s * g.n_pixels() + first_pixel;
        std::size_t edge = first_light_edge(g, g.paths.first_vertex[first_path]);
        for (std::size_t i = 0; i < n; ++i) {
            walk_in_time(reader, lengths, first_path + i, edge,
                         [&](const Spectrum& L, double opl) { worker.add(worker.histograms[i], L, opl); });
            worker.end_sample(worker.histograms[i]);
        }
    }
}

/// Bins neighbouring pixels with their derivatives. The light itself is summed as in bin_own(), to the bit.
/// in:      exact   borders of the derivative's temporal rows; null: they are not used
///          weight  share of the graph in all samples per pixel
void bin_own_with_derivative(Worker& worker, const GraphReader& reader, const Derivative& derivative,
                             const Timing& timing, const ExactBorders* exact, double weight, std::size_t first_pixel,
                             std::size_t n) {
    const PathGraph& g = reader.graph();
    const OpticalLengths lengths(g, timing);
    const double n_samples = double(g.tracing.samples_per_pixel);
    const std::size_t n_parameters = derivative.n_parameters(), width = 3 * n_parameters;
    const auto& interior = derivative.interior;
    const auto& points = derivative.light_points;
    const auto& seen = derivative.seen;
    const auto& boundary = derivative.boundary;
    const std::vector<float> at_rest(n_parameters);
    worker.boundary.set(derivative, first_pixel, n);
    for (std::uint64_t s = 0; s < g.tracing.samples_per_pixel; ++s) {
        const std::size_t first_path = s * g.n_pixels() + first_pixel;
        std::size_t edge = first_light_edge(g, g.paths.first_vertex[first_path]);
        RowCursor rows(derivative, first_path, edge);
        LengthsFromFirst relative(n_parameters);
        for (std::size_t i = 0; i < n; ++i) {
            Histogram& pixel = worker.histograms[i];
            walk_edges_in_time(
                reader, lengths, first_path + i, edge,
                [&](const Spectrum& Le, double opl) {
                    const std::size_t row = rows.seen(first_path + i);
                    const bool has_row = row != RowCursor::none;
                    const float* dopl = has_row ? &seen.dopl[row * n_parameters] : nullptr;
                    relative.start(timing.camera_segment ? nullptr : dopl);
                    if (has_row)
                        worker.add(pixel, Le, opl, &seen.dLe[row * width], relative(dopl));
                    else if (!is_black(Le))
                        worker.add(pixel, Le, opl);
                },
                [&](std::size_t k, const Spectrum& L, double opl) {
                    if (const auto [first, n_points] = rows.light_points(k); n_points > 0) {
                        worker.add(pixel, L, opl);
                        const double to_vertex = lengths.from_camera(first_path + i);
                        for (std::size_t row = first; row < first + n_points; ++row)
                            worker.derivative.add_light(
                                {points.L[3 * row], points.L[3 * row + 1], points.L[3 * row + 2]},
                                to_vertex + double(points.to_light[row]), &points.dL[row * width],
                                relative(&points.dopl[row * n_parameters]), [](std::uint32_t, double) {});
                    } else if (const std::size_t row = rows.interior(k); row != RowCursor::none)
                        worker.add(pixel, L, opl, &interior.dL[row * width],
                                   exact && derivative.temporal.is_exact[row]
                                       ? at_rest.data()
                                       : relative(&interior.dopl[row * n_parameters]));
                    else if (relative.camera_moves())
                        worker.add(pixel, L, opl, relative.none(), relative(nullptr));
                    else
                        worker.add(pixel, L, opl);
                });
            // The rows of a pixel are divided by its number of paths.
            worker.boundary.take_path(i, first_path + i, [&](std::size_t row) {
                worker.derivative.add_boundary(boundary_opl(derivative, row, timing.camera_segment),
                                               &boundary.dL[row * width], n_samples);
            });
            worker.end_sample(pixel);
            worker.derivative.end_path(worker.derivatives[i]);
        }
    }
    for (const BoundaryFamily family : {BoundaryFamily::primary, BoundaryFamily::edge_light})
        for (std::size_t i = 0; i < n; ++i)
            worker.derivative.add_samples(derivative, worker.boundary.of_samples(i, family),
                                          double(derivative.boundary_samples[std::size_t(family)]), weight,
                                          timing.camera_segment, worker.derivatives[i]);
    if (exact)
        for (std::size_t i = 0; i < n; ++i)
            worker.derivative.add_flux(derivative, first_pixel + i, exact->first, exact->step, weight,
                                       worker.derivatives[i]);
}

/// Whether a derivative has boundary samples that belong to no path.
bool has_own_samples(const Derivative& derivative) {
    const auto& family = derivative.boundary.family;
    return std::any_of(family.begin(), family.end(), [](std::uint8_t f) {
        return BoundaryFamily(f) == BoundaryFamily::primary || BoundaryFamily(f) == BoundaryFamily::edge_light;
    });
}

/// in: by_graph  a graph counts as one sample of each pixel, because the paths of one graph share their light
void bin_shared(Worker& worker, const SharedArrivals& shared, bool by_graph, std::size_t first_pixel, std::size_t n) {
    const PathGraph& g = shared.graph();
    for (std::size_t i = 0; i < n; ++i) {
        Histogram& pixel = worker.histograms[i];
        for (std::uint64_t s = 0; s < g.tracing.samples_per_pixel; ++s) {
            shared.walk(s * g.n_pixels() + first_pixel + i,
                        [&](const Spectrum& L, double opl) { worker.add(pixel, L, opl); });
            if (!by_graph) worker.end_sample(pixel);
        }
        if (by_graph) worker.end_sample(pixel);
    }
}

}  // namespace

void bin_graphs(std::span<const PathGraph> graphs, std::span<SharedArrivals> shared,
                std::span<const Derivative> derivatives, const TimeResponse& response, const Timing& timing,
                std::uint64_t max_bytes, int threads, app::Progress& progress,
                const std::function<void(std::uint32_t, const TransientRows&)>& take,
                std::span<const ExactBorders> exact) {
    const std::size_t width = graphs[0].sensor.width, height = graphs[0].sensor.height;
    const std::size_t n_parameters = derivatives.empty() ? 0 : derivatives[0].n_parameters();
    const std::size_t row_bytes = width * response.n_bins * (1 + n_parameters) * 3 * 2 * sizeof(float);
    const std::size_t block_rows = std::clamp<std::size_t>(max_bytes / row_bytes, 1, height);
    // Neighbouring pixels whose histograms fit into a cache together.
    const std::size_t pixel_bytes = (1 + n_parameters) * response.n_bins * 3 * 2 * sizeof(double);
    const std::size_t cached = n_parameters == 0 ? 256 << 10 : 768 << 10;
    const std::size_t chunk = std::clamp<std::size_t>(cached / pixel_bytes, 1, 256);
    std::vector<GraphReader> readers;
    double n_paths = 0;
    for (const PathGraph& g : graphs) {
        readers.emplace_back(g);
        n_paths += double(g.tracing.samples_per_pixel);
    }
    const bool by_graph = shared.size() > 1;
    std::size_t span = block_rows * width;  // pixels that are prepared at a time
    if (!shared.empty()) {
        std::size_t bytes = 0;
        for (const SharedArrivals& s : shared) bytes += s.bytes_per_pixel();
        span = std::clamp<std::size_t>(max_bytes / bytes, chunk, span);
    }
    Block block(block_rows * width, response.n_bins, n_parameters);
    const bool own_samples = !exact.empty() || std::any_of(derivatives.begin(), derivatives.end(), has_own_samples);
    tbb::enumerable_thread_specific<Worker> workers([&] { return Worker(response, chunk, n_parameters, own_samples); });
    for (std::size_t first_row = 0; first_row < height; first_row += block_rows) {
        const std::size_t first = first_row * width, n = std::min(block_rows, height - first_row) * width;
        for (std::size_t from = 0; from < n; from += span) {
            const std::size_t n_span = std::min(span, n - from);
            for (SharedArrivals& s : shared) s.prepare(first + from, n_span, threads);
            parallel_chunks(n_span, chunk, threads, [&](std::uint64_t, std::uint64_t begin, std::uint64_t end) {
                Worker& worker = workers.local();
                worker.clear(end - begin);
                const std::size_t pixel = first + from + begin;
                for (const SharedArrivals& s : shared) bin_shared(worker, s, by_graph, pixel, end - begin);
                for (std::size_t g = 0; shared.empty() && g < readers.size(); ++g)
                    if (n_parameters == 0)
                        bin_own(worker, readers[g], timing, pixel, end - begin);
                    else
                        bin_own_with_derivative(
                            worker, readers[g], derivatives[g], timing, exact.empty() ? nullptr : &exact[g],
                            double(graphs[g].tracing.samples_per_pixel) / n_paths, pixel, end - begin);
                for (std::size_t i = 0; i < end - begin; ++i) {
                    block.set(from + begin + i, worker.histograms[i], n_paths,
                              by_graph ? double(shared.size()) : n_paths, response.n_bins);
                    if (n_parameters > 0)
                        block.set(from + begin + i, worker.derivatives[i], n, n_paths, response.n_bins);
                }
                progress.add(end - begin);
            });
        }
        take(std::uint32_t(first_row), block.rows(n, response.n_bins));
    }
}

Window window_of(const PathGraph& graph, const Timing& timing) {
    constexpr std::size_t looked_at = 65536;
    const GraphReader reader(graph);
    const OpticalLengths lengths(graph, timing);
    std::vector<std::pair<double, double>> arrivals;  // (opl, luminance)
    double energy = 0;
    const std::size_t step = std::max<std::size_t>(graph.n_paths() / looked_at, 1);
    for (std::size_t path = 0; path < graph.n_paths(); path += step) {
        std::size_t edge = first_light_edge(graph, graph.paths.first_vertex[path]);
        walk_in_time(reader, lengths, path, edge, [&](const Spectrum& L, double opl) {
            const double y = luminance(L);
            if (!std::isfinite(opl) || !(y > 0)) return;
            arrivals.emplace_back(opl, y);
            energy += y;
        });
    }
    if (arrivals.empty()) return {};
    std::sort(arrivals.begin(), arrivals.end());
    double late = 0;
    std::size_t last = arrivals.size() - 1;
    while (last > 0 && late + arrivals[last].second < 1e-3 * energy) late += arrivals[last--].second;
    const double start = arrivals.front().first, end = arrivals[last].first;
    return {start, end > start ? end : start + 1};
}

}  // namespace loom::transient
