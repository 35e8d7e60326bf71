#include "stages/core/clusters/cluster_quality.h"

#include <fmt/format.h>

#include <algorithm>
#include <vector>

#include "stages/core/graph/graph_reader.h"

namespace loom {
namespace {

struct Member {
    Vector3f p, n;  // n: shading normal on the side of wo
};

}  // namespace

ClusterSizes cluster_sizes(const Clusters& clusters) {
    ClusterSizes s;
    s.n_clusters = clusters.n_clusters();
    s.n_members = clusters.n_members();
    if (s.n_clusters == 0) return s;
    std::vector<std::uint32_t> sizes(s.n_clusters);
    double squares = 0;
    for (std::size_t i = 0; i < s.n_clusters; ++i) {
        sizes[i] = clusters.first[i + 1] - clusters.first[i];
        squares += double(sizes[i]) * sizes[i];
    }
    const auto quantile = [&](double q) {
        const auto at = sizes.begin() + std::ptrdiff_t(q * double(s.n_clusters - 1));
        std::nth_element(sizes.begin(), at, sizes.end());
        return *at;
    };
    s.min = quantile(0);
    s.median = quantile(0.5);
    s.p99 = quantile(0.99);
    s.max = quantile(1);
    s.mean = double(s.n_members) / double(s.n_clusters);
    s.size_weighted_mean = squares / double(s.n_members);
    return s;
}

std::string text_of(const ClusterSizes& s) {
    return fmt::format(
        "{} clusters of {} vertices; size: mean {:.2f}, weighted by size {:.2f}, min {}, median {}, p99 {}, "
        "max {}",
        s.n_clusters, s.n_members, s.mean, s.size_weighted_mean, s.min, s.median, s.p99, s.max);
}

ClusterSpread cluster_spread(const PathGraph& graph, const Clusters& clusters, std::size_t max_clusters) {
    ClusterSpread s;
    const std::size_t n = clusters.n_clusters();
    const std::size_t n_seen = max_clusters == 0 ? n : std::min(n, max_clusters);
    std::vector<double> radii;
    radii.reserve(n_seen);
    double sum_distance = 0;
    std::size_t n_off = 0, n_opposed = 0;
    std::vector<Member> members;
    constexpr float cos_26_deg = 0.898794f;
    for (std::size_t seen = 0; seen < n_seen; ++seen) {
        const std::size_t i = seen * n / n_seen;
        members.clear();
        Vector3f p{}, normal{};
        for (std::uint32_t row = clusters.first[i]; row < clusters.first[i + 1]; ++row) {
            const std::size_t j = clusters.member[row];
            members.push_back(
                {Vector3f(position(graph, j)), Vector3f(facing(shading_normal(graph, j), outgoing(graph, j)))});
            p = p + members.back().p - members.front().p;
            normal = normal + members.back().n;
        }
        const Vector3f centroid = members.front().p + p * (1 / float(members.size()));
        const float length_n = length(normal);
        double squares = 0;
        for (const Member& at : members) {
            const double d = length(at.p - centroid);
            sum_distance += d;
            squares += d * d;
            const float cos = dot(at.n, normal);
            if (cos < cos_26_deg * length_n) ++n_off;
            if (cos < 0) ++n_opposed;
        }
        radii.push_back(std::sqrt(squares / double(members.size())));
        s.n_members += members.size();
    }
    if (n_seen == 0) return s;
    const auto middle = radii.begin() + std::ptrdiff_t(radii.size() / 2);
    std::nth_element(radii.begin(), middle, radii.end());
    s.median_radius = *middle;
    s.mean_distance = sum_distance / double(s.n_members);
    s.share_off_normal = double(n_off) / double(s.n_members);
    s.share_opposed = double(n_opposed) / double(s.n_members);
    return s;
}

std::string text_of(const Clusters::Separation& s) {
    const auto count = [](const Column<std::uint64_t>& n, const char* what) {
        return n.empty() ? fmt::format("{}: not tested", what) : fmt::format("{} {}", n[0], what);
    };
    return fmt::format("{}, {}, {}", count(s.other_media, "in another medium"),
                       count(s.same_path, "of a path with another vertex there"),
                       count(s.occluded, "hidden by a surface"));
}

std::string text_of(const ClusterSpread& s) {
    return fmt::format(
        "distance to the centroid: mean {:.4g} m, median radius {:.4g} m; normals more than 26 degrees off: "
        "{:.2f} %, opposed: {:.2f} % (of {} members)",
        s.mean_distance, s.median_radius, 100 * s.share_off_normal, 100 * s.share_opposed, s.n_members);
}

}  // namespace loom
