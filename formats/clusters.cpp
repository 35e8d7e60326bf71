#include "formats/clusters.h"

#include <fmt/format.h>

#include <algorithm>
#include <vector>

#include "formats/io/error.h"
#include "formats/io/hdf5_format.h"
#include "formats/path_graph.h"

namespace loom {
namespace {

std::string bad_offsets(const Clusters& c) {
    const auto& first = c.first;
    const std::size_t n = c.n_clusters();
    if (first[0] != 0) return fmt::format("clusters/first: starts at {}, not at 0", first[0]);
    if (first[n] != c.n_members()) {
        return fmt::format("clusters/first: ends at {}, but there are {} members", first[n], c.n_members());
    }
    for (std::size_t i = 0; i < n; ++i) {
        if (first[i] >= first[i + 1]) {
            return fmt::format("clusters/first: does not grow from {} to {} at row {}", first[i], first[i + 1], i + 1);
        }
        if (first[i + 1] - first[i] > c.settings.max_size) {
            return fmt::format("clusters/first: row {} has {} members, but settings/max_size is {}", i,
                               first[i + 1] - first[i], c.settings.max_size);
        }
    }
    return {};
}

std::string bad_members(const Clusters& c) {
    if (c.n_members() > c.graph_vertices) {
        return fmt::format("clusters/member: has {} rows, but there are {} vertices", c.n_members(), c.graph_vertices);
    }
    std::uint32_t largest = 0;
    for (std::uint32_t vertex : c.member) largest = std::max(largest, vertex);
    if (!c.member.empty() && largest >= c.graph_vertices) {
        const auto row = std::find(c.member.begin(), c.member.end(), largest) - c.member.begin();
        return fmt::format("clusters/member: row {} is {}, but there are {} vertices", row, largest, c.graph_vertices);
    }
    std::vector<std::uint64_t> seen(c.member.empty() ? 0 : std::size_t{largest} / 64 + 1);
    for (std::size_t row = 0; row < c.n_members(); ++row) {
        const std::uint32_t vertex = c.member[row];
        const std::uint64_t bit = std::uint64_t{1} << (vertex % 64);
        if ((seen[vertex / 64] & bit) != 0)
            return fmt::format("clusters/member: row {} repeats vertex {}", row, vertex);
        seen[vertex / 64] |= bit;
    }
    return {};
}

}  // namespace

std::string Clusters::problem() const {
    if (settings.method != "balanced" && settings.method != "centres") {
        return fmt::format("settings/method: is {}, expected balanced or centres", settings.method);
    }
    if (settings.k == 0) return "settings/k: is 0";
    if (!(settings.normal_weight >= 0)) return "settings/normal_weight: is negative";
    if (!(settings.length_scale > 0)) return "settings/length_scale: is not positive";
    if (auto bad = bad_offsets(*this); !bad.empty()) return bad;
    return bad_members(*this);
}

void write_clusters(const Clusters& clusters, const std::filesystem::path& path, Sync sync) {
    write_format(clusters, path, sync);
}

Clusters read_clusters(const std::filesystem::path& path) {
    return read_format<Clusters>(path);
}

std::vector<std::uint32_t> cluster_of_vertices(const Clusters& clusters) {
    std::vector<std::uint32_t> of_vertex(clusters.graph_vertices, no_cluster);
    for (std::size_t c = 0; c < clusters.n_clusters(); ++c)
        for (std::uint32_t i = clusters.first[c]; i < clusters.first[c + 1]; ++i)
            of_vertex[clusters.member[i]] = std::uint32_t(c);
    return of_vertex;
}

void require_clusters_of(const PathGraph& graph, const InputId& graph_id, const Clusters& clusters,
                         const std::filesystem::path& clusters_path) {
    if (clusters.graph == graph_id.hash && clusters.graph_vertices == graph.n_vertices()) return;
    const std::string made_from =
        clusters.provenance.inputs.empty() ? "another graph" : clusters.provenance.inputs[0].name;
    throw InputError(fmt::format("{}: made from {} (content {}), not from {} (content {}); run: loom-cluster {} -o {}",
                                 clusters_path.native(), made_from, clusters.graph, graph_id.name, graph_id.hash,
                                 graph_id.name, clusters_path.native()));
}

}  // namespace loom
