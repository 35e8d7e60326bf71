// Derivatives of histograms against a slow twin that evaluates every bin for every row, for hand-made derivatives.
#include "stages/transient/derivative_bins.h"

#include <fmt/format.h>
#include <gtest/gtest.h>

#include <cmath>
#include <map>
#include <random>

#include "stages/transient/transient.h"
#include "tests/traced_graph.h"

namespace loom {
namespace {

struct DerivativeCube {
    std::vector<float> radiance, value_var_mean, value_steady;
    std::vector<float> bins, var_mean, before, after, never, steady, steady_var_mean;  // [parameter, pixel, …]
};

/// Bins graphs in memory, with the rows of all parameters joined as a cube has them.
DerivativeCube cube_of(const std::vector<PathGraph>& graphs, const std::vector<Derivative>& derivatives,
                       const TimeResponse& response, std::uint64_t max_bytes = 1 << 30, int threads = 0,
                       const Timing& timing = {}) {
    app::Report report;
    report.set_quiet(true);
    app::Progress progress(report, "binning", graphs[0].n_pixels());
    DerivativeCube cube;
    const std::size_t n = derivatives.empty() ? 0 : derivatives[0].n_parameters(), pixels = graphs[0].n_pixels();
    transient::bin_graphs(graphs, {}, derivatives, response, timing, max_bytes, threads, progress,
                          [&](std::uint32_t first_row, const TransientRows& rows) {
                              const std::size_t first = first_row * graphs[0].sensor.width;
                              const auto place = [&](std::vector<float>& to, std::span<const float> from,
                                                     std::size_t per_pixel, std::size_t of) {
                                  to.resize(of * pixels * per_pixel);
                                  const std::size_t count = from.size() / std::max<std::size_t>(of, 1);
                                  for (std::size_t p = 0; p < of; ++p)
                                      std::copy_n(from.begin() + std::ptrdiff_t(p * count), count,
                                                  to.begin() + std::ptrdiff_t((p * pixels + first) * per_pixel));
                              };
                              const std::size_t per_bins = 3 * response.n_bins;
                              place(cube.radiance, rows.radiance, per_bins, 1);
                              place(cube.value_var_mean, rows.var_mean, per_bins, 1);
                              place(cube.value_steady, rows.steady, 3, 1);
                              const auto& d = rows.derivative;
                              place(cube.bins, d.bins, per_bins, n);
                              place(cube.var_mean, d.var_mean, per_bins, n);
                              place(cube.before, d.before, 3, n);
                              place(cube.after, d.after, 3, n);
                              place(cube.never, d.never, 3, n);
                              place(cube.steady, d.steady, 3, n);
                              place(cube.steady_var_mean, d.steady_var_mean, 3, n);
                          });
    return cube;
}

constexpr int width = 6, height = 5;

std::vector<PathGraph> two_graphs() {
    const auto scene = testing::own_scene("glossy-box.xml", width, height, {});
    std::vector<PathGraph> graphs;
    graphs.push_back(testing::trace_graph(*scene, testing::path_options(*scene, 3), 5));
    graphs.push_back(testing::trace_graph(*scene, testing::path_options(*scene, 3), 3, 5));
    return graphs;
}

/// Rows of about half of the edges, points of the lights of others at first vertices, rows of a third of the seen
/// emitters, and boundary rows of all families.
/// in:      moves  whether lengths change
Derivative derivative_of(const PathGraph& g, std::size_t n_parameters, bool moves, unsigned seed) {
    std::mt19937 random(seed);
    std::normal_distribution<float> normal;
    const auto one_in = [&](unsigned n) { return random() % n == 0; };
    Derivative d;
    d.n_light_edges = g.n_light_edges();
    d.n_paths = g.n_paths();
    std::vector<double> value(n_parameters);
    for (std::size_t p = 0; p < n_parameters; ++p) {
        d.parameters.name.push_back(fmt::format("p{}", p));
        d.parameters.unit.push_back("m");
    }
    d.parameters.value = std::move(value);
    std::vector<std::uint32_t> rows;
    std::vector<float> dL, dopl;
    const auto fill = [&](std::size_t n, unsigned one) {
        rows.clear(), dL.clear(), dopl.clear();
        for (std::size_t i = 0; i < n; ++i) {
            if (!one_in(one)) continue;
            rows.push_back(std::uint32_t(i));
            for (std::size_t k = 0; k < 3 * n_parameters; ++k) dL.push_back(normal(random));
            for (std::size_t k = 0; k < n_parameters; ++k) dopl.push_back(moves && !one_in(3) ? normal(random) : 0);
        }
    };
    fill(g.n_light_edges(), 2);
    d.interior.edge = rows, d.interior.dL = dL, d.interior.dopl = dopl;
    std::vector<std::uint32_t> of_points;
    std::vector<float> to_light, L, points_dL, points_dopl;
    for (std::size_t path = 0, row = 0; path < g.n_paths(); ++path) {
        const auto [begin, end] = vertices_of(g, path);
        std::size_t edge = begin < end ? first_light_edge(g, begin) : g.n_light_edges();
        for (; edge < g.n_light_edges() && g.light_edges.vertex[edge] == begin; ++edge) {
            while (row < rows.size() && rows[row] < edge) ++row;
            if ((row < rows.size() && rows[row] == edge) || g.light_edges.y[4 * edge + 3] == 0) continue;
            for (unsigned k = random() % 4; k > 0; --k) {
                of_points.push_back(std::uint32_t(edge));
                to_light.push_back(float(random() % 1000) * 3e-3f);
                for (int c = 0; c < 3; ++c) L.push_back(float(random() % 100) * 1e-2f);
                for (std::size_t p = 0; p < 3 * n_parameters; ++p) points_dL.push_back(normal(random));
                for (std::size_t p = 0; p < n_parameters; ++p) points_dopl.push_back(moves ? normal(random) : 0);
            }
        }
    }
    EXPECT_GT(of_points.size(), 40u);
    d.light_points = {of_points, to_light, L, points_dL, points_dopl};
    fill(g.n_paths(), 3);
    d.seen.path = rows, d.seen.dLe = dL, d.seen.dopl = dopl;

    const std::uint64_t n_own = 40;
    d.boundary_samples = std::vector<std::uint64_t>{n_own, g.n_paths(), n_own, g.n_paths(), g.n_paths()};
    std::vector<std::uint32_t> pixel;
    std::vector<double> opl, camera_opl;
    std::vector<std::uint8_t> family;
    std::vector<std::uint64_t> sample;
    dL.clear();
    for (std::uint32_t i = 0; i < g.n_pixels(); ++i)
        for (int row = 0; row < 12; ++row) {
            pixel.push_back(i);
            opl.push_back(one_in(6) ? -1 : 3 + double(random() % 10000) * 7e-4);
            camera_opl.push_back(std::max(opl.back(), 1.0) * double(random() % 1000) * 1e-3);
            family.push_back(std::uint8_t(random() % n_boundary_families));
            const bool of_path = family.back() != 0 && family.back() != 2;
            sample.push_back(of_path ? i + random() % g.tracing.samples_per_pixel * g.n_pixels() : random() % 5);
            for (std::size_t k = 0; k < 3 * n_parameters; ++k) dL.push_back(0.1f * normal(random));
        }
    d.boundary.pixel = pixel, d.boundary.opl = opl, d.boundary.family = family, d.boundary.sample = sample;
    d.boundary.camera_opl = camera_opl, d.boundary.dL = dL;
    EXPECT_EQ(d.problem(), "");
    return d;
}

/// Derivative of one number of a cube: samples of paths, and sums over the boundary samples of one family and graph.
struct TwinNumber {
    std::vector<double> of_paths;
    double own_mean = 0, own_var = 0;

    double mean() const {
        double sum = 0;
        for (const double x : of_paths) sum += x;
        return sum / double(of_paths.size()) + own_mean;
    }
    double var_mean() const {
        const double m = mean() - own_mean, n = double(of_paths.size());
        double squares = 0;
        for (const double x : of_paths) squares += (x - m) * (x - m);
        return squares / (n - 1) / n + own_var;
    }
};

/// Numbers of one pixel, parameter and channel: bins, before, after, never, steady.
std::vector<TwinNumber> twin_of(const std::vector<PathGraph>& graphs, const std::vector<Derivative>& derivatives,
                                const TimeResponse& r, std::size_t pixel, std::size_t p, int c,
                                const Timing& timing = {}) {
    const std::size_t n_bins = r.n_bins, N = derivatives[0].n_parameters();
    std::vector<TwinNumber> numbers(n_bins + transient::n_shares);
    double n_paths = 0;
    for (const PathGraph& g : graphs) n_paths += double(g.tracing.samples_per_pixel);
    // d += dL S_e + slope S_e' for all columns; bins far outside of the window stand for before and after.
    const auto add = [&](std::vector<double>& d, double opl, double dL, double L_dopl) {
        d[n_bins + 3] += dL;
        if (std::isinf(opl) || opl < 0) {
            d[n_bins + 2] += dL;
            return;
        }
        const auto outside = r.spread(opl, [](std::uint32_t, double) {});
        for (std::size_t k = 0; k < n_bins; ++k)
            d[k] += dL * r.weight(std::int64_t(k), opl) + L_dopl * r.slope(std::int64_t(k), opl);
        d[n_bins] += dL * outside.before;
        d[n_bins + 1] += dL * outside.after;
        if (r.modulation != Modulation::none) return;
        // A gate that opens at the window's end, and one that closes at its start, both longer than any pulse.
        TimeResponse late = r, early = r;
        late.start = r.end(), early.start = r.start - 1000;
        late.gate = early.gate = 1000;
        d[n_bins] += L_dopl * early.slope(0, opl);
        d[n_bins + 1] += L_dopl * late.slope(0, opl);
    };
    for (std::size_t i = 0; i < graphs.size(); ++i) {
        const PathGraph& g = graphs[i];
        const Derivative& d = derivatives[i];
        const GraphReader reader(g);
        const OpticalLengths lengths(g, timing);
        const auto opl_of = [&](std::size_t row) {
            const double from_camera = timing.camera_segment ? 0 : d.boundary.camera_opl[row];
            return d.boundary.opl[row] < 0 ? -1 : d.boundary.opl[row] - from_camera;
        };
        const double spp = double(g.tracing.samples_per_pixel);
        for (std::uint64_t s = 0; s < g.tracing.samples_per_pixel; ++s) {
            const std::size_t path = s * g.n_pixels() + pixel;
            std::size_t edge = first_light_edge(g, g.paths.first_vertex[path]);
            std::vector<double> of_path(numbers.size());
            const auto find = [](const Column<std::uint32_t>& keys, std::size_t key) {
                return std::size_t(std::find(keys.begin(), keys.end(), key) - keys.begin());
            };
            // Derivative of the length that does not count.
            double off = 0;
            const bool is_seen = find(d.seen.path, path) < d.seen.path.size();
            if (!timing.camera_segment && is_seen) off = d.seen.dopl[find(d.seen.path, path) * N + p];
            walk_edges_in_time(
                reader, lengths, path, edge,
                [&](const Spectrum& Le, double opl) {
                    if (const std::size_t row = find(d.seen.path, path); row < d.seen.path.size())
                        add(of_path, opl, d.seen.dLe[(row * N + p) * 3 + std::size_t(c)],
                            double(Le[c]) * (d.seen.dopl[row * N + p] - off));
                },
                [&](std::size_t k, const Spectrum& L, double opl) {
                    const auto& points = d.light_points;
                    const std::size_t first = find(points.edge, k);
                    for (std::size_t i = first; i < points.edge.size() && points.edge[i] == k; ++i)
                        add(of_path, lengths.from_camera(path) + points.to_light[i],
                            points.dL[(i * N + p) * 3 + std::size_t(c)],
                            double(points.L[3 * i + std::size_t(c)]) * (double(points.dopl[i * N + p]) - off));
                    if (first < points.edge.size()) return;
                    const std::size_t row = find(d.interior.edge, k);
                    const bool has_row = row < d.interior.edge.size();
                    add(of_path, opl, has_row ? double(d.interior.dL[(row * N + p) * 3 + std::size_t(c)]) : 0,
                        double(L[c]) * ((has_row ? double(d.interior.dopl[row * N + p]) : 0) - off));
                });
            const auto& b = d.boundary;
            for (std::size_t row = 0; row < b.pixel.size(); ++row)
                if (b.family[row] != 0 && b.family[row] != 2 && b.sample[row] == path)
                    add(of_path, opl_of(row), spp * b.dL[(row * N + p) * 3 + std::size_t(c)], 0);
            for (std::size_t k = 0; k < numbers.size(); ++k) numbers[k].of_paths.push_back(of_path[k]);
        }
        for (const std::uint8_t family : {0, 2}) {
            std::map<std::uint64_t, std::vector<double>> samples;
            const auto& b = d.boundary;
            for (std::size_t row = 0; row < b.pixel.size(); ++row) {
                if (b.family[row] != family || b.pixel[row] != pixel) continue;
                auto& of_sample = samples.try_emplace(b.sample[row], numbers.size()).first->second;
                add(of_sample, opl_of(row), b.dL[(row * N + p) * 3 + std::size_t(c)], 0);
            }
            const double w = spp / n_paths, n = double(d.boundary_samples[family]);
            for (std::size_t k = 0; k < numbers.size(); ++k) {
                double sum = 0, squares = 0;
                for (const auto& [sample, values] : samples) sum += values[k];
                // All n samples, of which those without a row are 0.
                for (const auto& [sample, values] : samples) squares += std::pow(values[k] - sum / n, 2);
                squares += (n - double(samples.size())) * std::pow(sum / n, 2);
                numbers[k].own_mean += w * sum;
                numbers[k].own_var += w * w * squares * n / (n - 1);
            }
        }
    }
    return numbers;
}

std::vector<std::pair<std::string, TimeResponse>> responses() {
    const TimeResponse tiled{40, 4.1, 0.1, 0.1, Pulse::delta(), {}, 1};
    std::vector<std::pair<std::string, TimeResponse>> all;
    for (const auto& [name, pulse] :
         {std::pair{"delta", Pulse::delta()}, std::pair{"box", Pulse::box(0.25)},
          std::pair{"short box", Pulse::box(0.04)}, std::pair{"gaussian", Pulse::gaussian(0.1)},
          std::pair{"expgauss", Pulse::exponential_gaussian(0.05, 0.2)},
          std::pair{"table", Pulse::table({-0.1, 0.05, 0.3}, {1, 3, 0.5})}}) {
        TimeResponse r = tiled;
        r.pulse = pulse;
        all.emplace_back(name, r);
        for (const double gate : {0.03, 0.17}) {
            r.gate = gate;
            all.emplace_back(fmt::format("{}, gate {}", name, gate), r);
        }
    }
    all.emplace_back("sine", TimeResponse{4, 0, 0.5, 0.5, Pulse::delta(), Modulation::sine, 2});
    all.emplace_back("square", TimeResponse{4, 0, 0.5, 0.5, Pulse::delta(), Modulation::square, 2});
    return all;
}

class DerivativeBins : public ::testing::Test {
  protected:
    void SetUp() override {
        graphs = two_graphs();
        for (unsigned i = 0; i < 2; ++i) derivatives.push_back(derivative_of(graphs[i], 2, true, 7 + i));
    }
    /// Compares pixels of the cube with the twin.
    void agree(const Timing& timing) const;
    std::vector<PathGraph> graphs;
    std::vector<Derivative> derivatives;
};

void DerivativeBins::agree(const Timing& timing) const {
    for (const auto& [name, response] : responses()) {
        SCOPED_TRACE(name);
        const DerivativeCube cube = cube_of(graphs, derivatives, response, 1 << 30, 0, timing);
        const std::size_t n_bins = response.n_bins, n_pixels = width * height;
        double scale = 0;
        for (const float x : cube.steady) scale = std::max(scale, double(std::abs(x)));
        ASSERT_GT(scale, 0);
        const auto near = [&](double value, double expected, double size) {
            return std::abs(value - expected) <= 2e-6 * (std::abs(expected) + size);
        };
        for (const std::size_t pixel : {std::size_t{0}, std::size_t{13}, n_pixels - 1})
            for (const std::size_t p : {0u, 1u})
                for (int c = 0; c < 3; ++c) {
                    const auto twin = twin_of(graphs, derivatives, response, pixel, p, c, timing);
                    const std::size_t row = p * n_pixels + pixel, channel = std::size_t(c);
                    for (std::size_t k = 0; k < n_bins; ++k) {
                        const std::size_t at = (row * n_bins + k) * 3 + channel;
                        ASSERT_PRED3(near, cube.bins[at], twin[k].mean(), scale) << pixel << " " << k;
                        ASSERT_PRED3(near, cube.var_mean[at], twin[k].var_mean(), scale * scale) << pixel << " " << k;
                    }
                    const std::size_t at = 3 * row + channel;
                    ASSERT_PRED3(near, cube.before[at], twin[n_bins].mean(), scale);
                    ASSERT_PRED3(near, cube.after[at], twin[n_bins + 1].mean(), scale);
                    ASSERT_PRED3(near, cube.never[at], twin[n_bins + 2].mean(), scale);
                    ASSERT_PRED3(near, cube.steady[at], twin[n_bins + 3].mean(), scale);
                    ASSERT_PRED3(near, cube.steady_var_mean[at], twin[n_bins + 3].var_mean(), scale * scale);
                }
    }
}

// Detected mutations: sign of the slope; boundary rows of paths without the number of paths; boundary samples by row
// rather than by sample; graphs weighted alike; seen rows of black emitters dropped; after and before exchanged; points of
// lights with the light of the stored edge.
TEST_F(DerivativeBins, AgreeWithEveryBinOfEveryRow) {
    agree({});
}

// Without the camera's segment its share of each length goes, and with it its derivative.
// Detected mutations: edges without a row left out.
TEST_F(DerivativeBins, AgreeWithoutTheCameraSegment) {
    Timing timing;
    timing.camera_segment = false;
    agree(timing);
}

// Bins, before, after and never add up to the derivative of all light, whatever the lengths do.
TEST_F(DerivativeBins, SumOverTimeIsTheSteadyDerivative) {
    for (const auto& [name, response] : responses()) {
        if (response.gate != response.width) continue;
        SCOPED_TRACE(name);
        const DerivativeCube cube = cube_of(graphs, derivatives, response);
        for (std::size_t i = 0; i < cube.steady.size(); ++i) {
            double sum = cube.before[i] + cube.after[i] + cube.never[i], size = 0;
            for (std::size_t k = 0; k < response.n_bins; ++k) {
                const double x = cube.bins[(i / 3 * response.n_bins + k) * 3 + i % 3];
                sum += x, size += std::abs(x);
            }
            ASSERT_NEAR(sum, cube.steady[i], 1e-6 * size) << i;
        }
    }
}

TEST_F(DerivativeBins, LeaveTheValuesAsTheyAre) {
    for (const auto& [name, response] : responses()) {
        SCOPED_TRACE(name);
        const DerivativeCube without = cube_of(graphs, {}, response), with = cube_of(graphs, derivatives, response);
        ASSERT_EQ(with.radiance, without.radiance);
        ASSERT_EQ(with.value_var_mean, without.value_var_mean);
        ASSERT_EQ(with.value_steady, without.value_steady);
    }
}

TEST_F(DerivativeBins, ThreadsAndBlocksChangeNothing) {
    TimeResponse response{40, 4.1, 0.1, 0.1, Pulse::gaussian(0.1), {}, 1};
    const DerivativeCube one = cube_of(graphs, derivatives, response, 1 << 30, 1);
    for (const auto& [bytes, threads] : {std::pair<std::uint64_t, int>{1 << 30, 2}, {1, 2}, {30'000, 3}}) {
        const DerivativeCube other = cube_of(graphs, derivatives, response, bytes, threads);
        EXPECT_EQ(one.bins, other.bins);
        EXPECT_EQ(one.var_mean, other.var_mean);
        EXPECT_EQ(one.steady, other.steady);
        EXPECT_EQ(one.steady_var_mean, other.steady_var_mean);
    }
}

// Against differences: each light moved by h opl' and scaled by its L' gives the cube at a parameter h away. The walk is
// that of one path with one edge, so that the light can be moved by hand.
TEST_F(DerivativeBins, AreDifferencesOfTheHistogram) {
    const double h = 1e-5, L = 2, dL = 0.7, dopl = -1.3;
    for (const auto& [name, r] : responses()) {
        if (r.pulse.is_delta() && r.modulation == Modulation::none) continue;
        SCOPED_TRACE(name);
        transient::DerivativeBinner binner(r, 1);
        const float dL_rgb[] = {float(dL), float(dL), float(dL)}, dopl_1[] = {float(dopl)};
        for (const double opl : {4.0931, 5.317, 6.0021, 8.0977, 8.2212}) {
            transient::DerivativeHistogram pixel(binner.n_columns(), 3, false);
            binner.add_light({L, L, L}, opl, dL_rgb, dopl_1, [](std::uint32_t, double) {});
            binner.end_path(pixel);
            const auto at = [&](double theta, std::size_t k) {
                return (L + theta * dL) * r.weight(std::int64_t(k), opl + theta * dopl);
            };
            for (std::size_t k = 0; k < r.n_bins; ++k)
                EXPECT_NEAR(pixel.sum[3 * k + 1], (at(h, k) - at(-h, k)) / (2 * h), 2e-5 * L * std::abs(dopl) / r.width)
                    << opl << " " << k;
        }
    }
}

}  // namespace
}  // namespace loom
