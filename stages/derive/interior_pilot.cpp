#include "stages/derive/interior_pilot.h"

#include <algorithm>

#include "stages/core/graph/own_samples.h"
#include "stages/core/graph/time_of_flight.h"
#include "stages/core/graph/time_response.h"

namespace loom::derive {
namespace {

/// Response of a film to a pulse as long as one of its bins; with one bin for all times where a film has none.
TimeResponse response_of(const PathGraph& graph) {
    TimeResponse response;
    const auto& film = graph.transient;
    if (film.n_bins.empty()) return response;
    response.n_bins = film.n_bins[0];
    response.start = film.start_opl[0];
    response.width = response.gate = film.bin_width_opl[0];
    response.pulse = Pulse::box(response.width);
    return response;
}

/// Histogram of the derivatives of one pixel.
class PixelBins {
  public:
    PixelBins(const TimeResponse& response, bool in_time, std::size_t n)
        : response_(response), in_time_(in_time), n_(n), of_path_(response.n_bins * n), bins_(response.n_bins * n) {}

    void add(double opl, const InteriorWalker::ExactRow& row) {
        const auto add_bin = [&](std::uint32_t k, double weight, double slope) {
            touched_.push_back(k);
            for (std::size_t p = 0; p < n_; ++p)
                of_path_[k * n_ + p] += row.dL[p] * Rgb<double>(weight) + row.L * Rgb<double>(slope * row.dopl[p]);
        };
        if (!in_time_)
            add_bin(0, 1, 0);
        else if (std::isfinite(opl))
            response_.spread_with_slopes(opl, add_bin);
    }
    void end_path() {
        for (const std::uint32_t k : touched_)
            for (std::size_t i = k * n_; i < (k + 1) * n_; ++i) {
                bins_[i].sum += of_path_[i];
                bins_[i].square += of_path_[i] * of_path_[i];
                of_path_[i] = {};
            }
        touched_.clear();
    }
    /// Adds the variances of the sums, by parameter.
    void end_pixel(double n_paths, std::vector<double>& variance) {
        for (std::size_t i = 0; i < bins_.size(); ++i)
            for (int c = 0; c < 3; ++c)
                variance[i % n_] += std::max(bins_[i].square[c] - sqr(bins_[i].sum[c]) / n_paths, 0.0);
        std::fill(bins_.begin(), bins_.end(), Sums{});
    }

  private:
    struct Sums {
        Rgb<double> sum, square;
    };
    const TimeResponse& response_;
    bool in_time_;
    std::size_t n_;
    std::vector<Rgb<double>> of_path_;  // [bin, parameter]
    std::vector<Sums> bins_;            // [bin, parameter]
    std::vector<std::uint32_t> touched_;
};

constexpr double golden_ratio = 0.6180339887498949;

struct Look {
    std::vector<double> variance;  // [parameter]
    double n_points = 0;           // per path
};

Look look(const PathGraph& g, const Scene& scene, const SceneTangents& tangents, const Attached& attached,
          const WholeLightOptions& whole) {
    // Pixels differ more than samples of one do: some samples of each of many.
    const std::uint64_t n_pixels = g.n_pixels(), spp = g.tracing.samples_per_pixel,
                        n_paths = std::max<std::uint64_t>(8192, g.n_paths() / 200),
                        n_samples = std::min<std::uint64_t>(spp, 16),
                        n_looked_at = std::clamp<std::uint64_t>(n_paths / n_samples, 1, n_pixels);
    const InteriorWalker walker(g, scene, tangents, attached, whole);
    const GraphReader reader(g);
    const OpticalLengths lengths(g, Timing{});
    const TimeResponse response = response_of(g);
    PixelBins bins(response, !g.transient.n_bins.empty(), tangents.n());
    std::vector<double> opl;
    Look out{std::vector<double>(tangents.n())};
    for (std::uint64_t i = 0; i < n_looked_at; ++i) {
        // Even steps could stay in one column.
        const double place = (double(i) + 0.5) * golden_ratio;
        const auto pixel = std::uint64_t((place - std::floor(place)) * double(n_pixels));
        for (std::uint64_t k = 0; k < n_samples; ++k) {
            const std::size_t path = k * spp / n_samples * n_pixels + pixel;
            if (!walker.touches(path)) continue;
            const std::size_t first = first_light_edge(g, g.paths.first_vertex[path]);
            std::size_t edge = first;
            opl.clear();
            double seen_opl = INFINITY;
            walk_edges_in_time(
                reader, lengths, path, edge, [&](const Spectrum&, double t) { seen_opl = t; },
                [&](std::size_t, const Spectrum&, double t) { opl.push_back(t); });
            edge = first;
            walker.walk_exactly(
                path, edge,
                [&](const InteriorWalker::ExactRow& row) {
                    const bool is_point = row.to_light >= 0;
                    bins.add(is_point ? lengths.from_camera(path) + row.to_light : opl[row.row - first], row);
                    out.n_points += is_point;
                },
                [&](const InteriorWalker::ExactRow& row) { bins.add(seen_opl, row); });
            bins.end_path();
        }
        bins.end_pixel(double(n_samples), out.variance);
    }
    const double share = double(n_looked_at) / double(n_pixels), n = double(n_samples);
    for (double& v : out.variance) v /= share * std::max(n - 1, 1.0) * double(spp);
    out.n_points /= double(n_looked_at) * n;
    return out;
}

}  // namespace

double cost_of_path(const PathGraph& graph) {
    // One that ends on an emitter has neither vertex nor light edge.
    const auto n_paths = std::max(double(graph.n_paths()), 1.0);
    return 1.5 * std::max(1.0, double(graph.n_vertices() + graph.n_light_edges()) / n_paths);
}

InteriorPilot look_at_interior(const PathGraph& graph, const Scene& scene, const SceneTangents& tangents,
                               const Attached& attached, WholeLightOptions whole, std::optional<int> wanted) {
    const auto look_with = [&](int points_per_side) {
        whole.points_per_side = points_per_side;
        return look(graph, scene, tangents, attached, whole);
    };
    if (!whole.edges) wanted = 1;
    if (wanted) return {*wanted, look_with(*wanted).variance};
    // Rays, by measured times. Three points per side pay as much as two, with twice the memory.
    constexpr int side = 2;
    constexpr double with_interior = 1.3, point_cost = 1, proof_cost = 3.5;
    const Look one = look_with(1), more = look_with(side);
    double ratio = 0;  // of the variances, summed over the parameters
    for (std::size_t p = 0; p < tangents.n(); ++p)
        ratio += one.variance[p] > 0 ? more.variance[p] / one.variance[p] : 1;
    const double work = with_interior * cost_of_path(graph),
                 work_of_more = work + more.n_points * (point_cost + proof_cost / sqr(side));
    const bool pays = more.n_points > 0 && ratio * work_of_more < double(tangents.n()) * work;
    return pays ? InteriorPilot{side, more.variance} : InteriorPilot{1, one.variance};
}

}  // namespace loom::derive
