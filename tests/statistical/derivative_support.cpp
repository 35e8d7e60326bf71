#include "tests/statistical/derivative_support.h"

#include "stages/core/stats/chi_square.h"
#include "stages/derive/interior.h"
#include "stages/transient/transient.h"

namespace loom {

DerivableScene::DerivableScene(const std::filesystem::path& file, const std::vector<std::string>& wrt,
                               const Defines& defines)
    : DerivableScene(load_scene(file, defines), read_scene(file, defines, {}), file, wrt, defines) {}

DerivableScene::DerivableScene(std::unique_ptr<Scene> built, const SceneDescription& description,
                               const std::filesystem::path& file, const std::vector<std::string>& wrt,
                               const Defines& defines)
    : scene(std::move(built)), tangents(derive::find_tangents(*scene, description, file, defines, {}, wrt)) {}

PathGraph trace_derivable(const Scene& scene, std::uint64_t spp, std::uint64_t seed) {
    return testing::trace_graph(scene, testing::path_options(scene, seed), spp, 0, {false, true, true});
}

Derivative differentiate(const PathGraph& graph, const DerivableScene& scene, std::uint64_t seed,
                         const std::vector<std::string>& off, derive::Attachment attachment) {
    app::Report report;
    report.set_quiet(true);
    derive::DeriveCounts counts;
    const derive::Parts parts = derive::required_parts(*scene.scene, graph, scene.tangents, off);
    // More than the best use of time: power to find what boundaries lack.
    return derive::differentiate(graph, *scene.scene, scene.tangents, parts,
                                 {.effort = 1, .seed = seed, .attachment = attachment}, report, counts);
}

const char* name_of(BoundarySet boundaries) {
    return boundaries == primary_edges    ? "primary edges"
           : boundaries == direct_edges   ? "direct edges"
           : boundaries == indirect_edges ? "indirect edges"
                                          : "boundaries";
}

std::vector<double> DerivedBins::steady_without(BoundarySet boundaries) const {
    std::vector<double> out = steady;
    for (std::size_t f = 0; f < n_boundary_families; ++f)
        if (boundaries >> f & 1)
            for (std::size_t i = 0; i < out.size(); ++i) out[i] -= steady_boundary[f][i];
    return out;
}

DerivedBins bins_of(const PathGraph& graph, const Derivative* derivative, const TimeResponse& response,
                    std::size_t parameter, const Timing& timing) {
    app::Report report;
    report.set_quiet(true);
    app::Progress progress(report, "binning", graph.n_pixels());
    DerivedBins out;
    out.n_pixels = graph.n_pixels(), out.n_bins = response.n_bins;
    const std::size_t per_pixel = 3 * response.n_bins;
    out.value.resize(out.n_pixels * per_pixel), out.steady_value.resize(3 * out.n_pixels);
    if (derivative) {
        out.derivative.resize(out.value.size()), out.var_mean.resize(out.value.size());
        out.steady.resize(out.steady_value.size());
    }
    const std::span<const Derivative> derivatives(derivative, derivative ? 1 : 0);
    transient::bin_graphs({&graph, 1}, {}, derivatives, response, timing, std::uint64_t(1) << 30, 0, progress,
                          [&](std::uint32_t first_row, const TransientRows& rows) {
                              const std::size_t first = std::size_t(first_row) * graph.sensor.width;
                              const auto copy = [&](std::span<const float> from, std::size_t i, std::size_t of,
                                                    std::size_t width, std::vector<double>& to) {
                                  const std::size_t n = from.size() / of;
                                  std::copy_n(from.begin() + std::ptrdiff_t(i * n), n,
                                              to.begin() + std::ptrdiff_t(first * width));
                              };
                              copy(rows.radiance, 0, 1, per_pixel, out.value);
                              copy(rows.steady, 0, 1, 3, out.steady_value);
                              if (!derivative) return;
                              const std::size_t n = derivative->n_parameters();
                              copy(rows.derivative.bins, parameter, n, per_pixel, out.derivative);
                              copy(rows.derivative.var_mean, parameter, n, per_pixel, out.var_mean);
                              copy(rows.derivative.steady, parameter, n, 3, out.steady);
                          });
    if (!derivative) return out;

    // Boundary rows of each family: they add up to the derivative of their pixel.
    for (auto& share : out.boundary) share.resize(out.derivative.size());
    for (auto& share : out.steady_boundary) share.resize(out.steady.size());
    const auto& b = derivative->boundary;
    const std::size_t n = derivative->n_parameters();
    for (std::size_t row = 0; row < b.pixel.size(); ++row) {
        const float* dL = &b.dL[3 * (row * n + parameter)];
        const std::size_t pixel = b.pixel[row], family = b.family[row];
        for (std::size_t c = 0; c < 3; ++c) out.steady_boundary[family][3 * pixel + c] += double(dL[c]);
        if (b.opl[row] < 0) continue;
        const double opl = timing.camera_segment ? b.opl[row] : std::max(b.opl[row] - b.camera_opl[row], 0.0);
        response.spread(opl, [&](std::uint32_t k, double w) {
            for (std::size_t c = 0; c < 3; ++c)
                out.boundary[family][pixel * per_pixel + 3 * k + c] += double(dL[c]) * w;
        });
    }
    return out;
}

namespace {

/// Mean of values at places in order, and its standard error by differences of neighbours, which leave out how the
/// values change from place to place.                                [vonNeumann1941] "The Mean Square Successive Difference"
Estimate estimate_in_order(std::span<const double> values) {
    const double n = double(values.size());
    double sum = values[0], squares = 0;
    for (std::size_t i = 1; i < values.size(); ++i) sum += values[i], squares += sqr(values[i] - values[i - 1]);
    return {sum / n, std::sqrt(squares / (2 * (n - 1) * n)), 2 * (n - 1) / 3};
}

}  // namespace

Agreement compare_numbers(const Samples& a, const Samples& b, const std::function<bool(std::size_t)>& keep) {
    Agreement out;
    std::vector<double> x(a.size()), y(b.size());
    std::vector<std::pair<Estimate, Estimate>> estimates(a[0].size());
    double largest = 0;
    for (std::size_t k = 0; k < a[0].size(); ++k) {
        for (std::size_t i = 0; i < a.size(); ++i) x[i] = a[i][k], y[i] = b[i][k];
        estimates[k] = {estimate_in_order(x), estimate_of(y)};
        if (keep(k))
            largest = std::max({largest, std::abs(estimates[k].first.mean), std::abs(estimates[k].second.mean)});
    }
    for (std::size_t k = 0; k < a[0].size(); ++k) {
        if (!keep(k)) continue;
        const auto& [ours, theirs] = estimates[k];
        if (!(ours.se > 0) && !(theirs.se > 0)) continue;
        // Ends of pulses, below the rounding of a cube.
        if (std::max(std::abs(ours.mean), std::abs(theirs.mean)) < 1e-8 * largest) continue;
        const double z = student_critical(std::max(welch_p_value(ours, theirs), 1e-300), INFINITY);
        out.chi2 += z * z, ++out.n;
        if (z > out.worst) out.worst = z, out.worst_number = k, out.worst_a = ours, out.worst_b = theirs;
    }
    out.p = out.n > 0 ? chi_square_tail(out.chi2, out.n) : 1;
    return out;
}

double place_in(int i, int n) {
    constexpr double golden = 0.6180339887498949;
    const double within = golden * (i + 1) - std::floor(golden * (i + 1));
    return 2 * (i + within) / n - 1;
}

TimeResponse film_response(const Scene& scene) {
    TimeResponse response;
    response.n_bins = scene.transient.n_bins;
    response.start = scene.transient.start_opl;
    response.width = response.gate = scene.transient.bin_width_opl;
    return response;
}

}  // namespace loom
