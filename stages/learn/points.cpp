#include "stages/learn/points.h"

#include <algorithm>
#include <array>

#include "formats/io/octahedral.h"
#include "stages/core/compute/parallel.h"
#include "stages/core/graph/graph_reader.h"

namespace loom::learn {
namespace {

/// Columns of the points of one graph's clusters, in the order of clusters; those without members are left out.
struct PointRows {
    std::vector<float> p, E, var;
    std::vector<std::int16_t> n;
    std::vector<std::uint16_t> members;
};

/// Mean of the members of one cluster.
struct ClusterMean {
    std::array<double, 3> p{}, n{}, E{}, var{};
    std::uint64_t members = 0, nonfinite = 0;
};

class Averager {
  public:
    Averager(const LearnInput& input, std::size_t graph_idx, const LearnOptions& options)
        : in_(input), graph_idx_(graph_idx), options_(options), reader_(input.graph), preferred_(input) {}

    ClusterMean mean_of(std::size_t cluster) const {
        const auto members = in_.clusters.member.values().subspan(
            in_.clusters.first[cluster], in_.clusters.first[cluster + 1] - in_.clusters.first[cluster]);
        ClusterMean mean;
        std::vector<Label> labels;
        bool any_preferred = false;
        for (const std::uint32_t j : members) {
            const ShadingPoint at = reader_.vertex(j);
            if (!is_cached(at.bsdf, options_.smallest_roughness) || is_held_back(options_.seed, graph_idx_, j))
                continue;
            const Spectrum L = rgb(in_.radiance.L, j);
            if (!all_finite(L)) {
                ++mean.nonfinite;
                continue;
            }
            const bool is_preferred = preferred_(j, at.bsdf);
            if (is_preferred && !any_preferred) labels.clear();
            any_preferred |= is_preferred;
            if (is_preferred == any_preferred) labels.push_back({cache_query(at), L, 0});
        }
        if (labels.empty()) return mean;
        mean.members = labels.size();
        const auto n = double(mean.members);
        for (std::size_t c = 0; c < 3; ++c) {
            const auto k = int(c);
            double sum_L = 0, sum_rho = 0, square = 0;
            for (const Label& label : labels) {
                mean.p[c] += double(label.query.p[k]) / n;
                mean.n[c] += double(label.query.n[k]);
                sum_L += double(label.L[k]), sum_rho += double(label.query.reflectance[k]);
            }
            if (!(sum_rho > 0)) continue;
            mean.E[c] = sum_L / sum_rho;
            for (const Label& label : labels)
                square += sqr(double(label.L[k]) - mean.E[c] * double(label.query.reflectance[k]));
            if (n > 1) mean.var[c] = square * n / ((n - 1) * sqr(sum_rho));
        }
        return mean;
    }

  private:
    const LearnInput& in_;
    std::size_t graph_idx_;
    const LearnOptions& options_;
    GraphReader reader_;
    PreferredVertices preferred_;
};

void append(const ClusterMean& mean, PointRows& rows) {
    const double length = std::sqrt(sqr(mean.n[0]) + sqr(mean.n[1]) + sqr(mean.n[2]));
    const Normal3f n = length > 0
                           ? Normal3f(float(mean.n[0] / length), float(mean.n[1] / length), float(mean.n[2] / length))
                           : Normal3f(0, 0, 1);
    const auto code = octahedral_from_unit(n.x, n.y, n.z);
    rows.n.insert(rows.n.end(), code.begin(), code.end());
    for (std::size_t c = 0; c < 3; ++c) {
        rows.p.push_back(float(mean.p[c]));
        rows.E.push_back(float(mean.E[c]));
        rows.var.push_back(float(mean.var[c]));
    }
    rows.members.push_back(std::uint16_t(std::min<std::uint64_t>(mean.members, 65535)));
}

}  // namespace

void fill_points(const std::vector<LearnInput>& inputs, const LearnOptions& options, RadianceCache& cache) {
    PointRows rows;
    double length_scale = 0;
    cache.settings.samples = cache.settings.nonfinite = 0;
    for (std::size_t g = 0; g < inputs.size(); ++g) {
        const Averager averager(inputs[g], g, options);
        std::vector<ClusterMean> means(inputs[g].clusters.n_clusters());
        parallel_chunks(means.size(), 256, options.threads, [&](std::uint64_t, std::uint64_t begin, std::uint64_t end) {
            for (std::uint64_t i = begin; i < end; ++i) means[i] = averager.mean_of(i);
        });
        for (const ClusterMean& mean : means) {
            cache.settings.nonfinite += mean.nonfinite;
            cache.settings.samples += mean.members;
            if (mean.members > 0) append(mean, rows);
        }
        length_scale += double(inputs[g].clusters.settings.length_scale) / double(inputs.size());
        cache.metric.normal_weight = std::max(cache.metric.normal_weight, inputs[g].clusters.settings.normal_weight);
    }
    cache.metric.length_scale = float(length_scale);
    // Clusters by positions alone hold both sides of a sheet; their points must not.
    if (cache.metric.normal_weight == 0) cache.metric.normal_weight = 8;
    cache.demodulated = 1;

    // Bound the points.
    std::array<float, 3> lo{}, hi{};
    for (std::size_t i = 0; i < rows.p.size(); ++i) {
        lo[i % 3] = i < 3 ? rows.p[i] : std::min(lo[i % 3], rows.p[i]);
        hi[i % 3] = i < 3 ? rows.p[i] : std::max(hi[i % 3], rows.p[i]);
    }
    cache.domain.lo = lo;
    cache.domain.size = std::max({hi[0] - lo[0], hi[1] - lo[1], hi[2] - lo[2]});
    if (!(cache.domain.size > 0)) cache.domain.size = 1;

    cache.points.p = std::move(rows.p);
    cache.points.n = std::move(rows.n);
    cache.points.E = std::move(rows.E);
    cache.points.var = std::move(rows.var);
    cache.points.members = std::move(rows.members);
}

}  // namespace loom::learn
