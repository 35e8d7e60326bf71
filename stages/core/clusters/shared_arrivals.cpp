#include "stages/core/clusters/shared_arrivals.h"

#include <tbb/enumerable_thread_specific.h>

#include <memory>

#include "stages/core/compute/parallel.h"

namespace loom {

SharedArrivals::SharedArrivals(const PathGraph& graph, const Clusters& clusters, const Timing& timing, int threads)
    : reader_(graph),
      clusters_(clusters),
      lengths_(graph, timing),
      first_edge_(light_edge_offsets(graph)),
      cluster_of_(cluster_of_vertices(clusters)),
      continuation_(graph.n_vertices()),
      light_(graph.n_light_edges()),
      slot_of_(graph.n_vertices(), nobody),
      is_first_(graph.n_vertices(), false) {
    for (std::size_t path = 0; path < graph.n_paths(); ++path)
        if (graph.paths.first_vertex[path] < graph.paths.first_vertex[path + 1])
            is_first_[graph.paths.first_vertex[path]] = true;
    parallel_chunks(graph.n_vertices(), 4096, threads, [&](std::uint64_t, std::uint64_t begin, std::uint64_t end) {
        for (std::size_t j = begin; j < end; ++j) {
            const ShadingPoint at = reader_.vertex(j);
            const Point3<double> x = position<double>(graph, j);
            for (std::uint32_t e = first_edge_[j]; e < first_edge_[j + 1]; ++e)
                light_[e] = {own_light(reader_, at, j, e), lengths_.to_light(e, x)};
            if (graph.vertices.flags[j] & vertex_flag::continued)
                continuation_[j] = {own_continuation(reader_, at, j, continuation_direction(graph, j)),
                                    lengths_.to_vertex(j + 1, x)};
        }
    });
}

std::size_t SharedArrivals::bytes_per_pixel() const {
    const double per_cluster = double(clusters_.n_members()) / double(std::max<std::size_t>(clusters_.n_clusters(), 1));
    const double edges = double(graph().n_light_edges()) / double(std::max<std::size_t>(graph().n_vertices(), 1)) + 1;
    return std::size_t(double(graph().tracing.samples_per_pixel) * per_cluster * edges * sizeof(Taken)) + 1;
}

void SharedArrivals::take_all(ClusterShading& shading, std::size_t cluster,
                              std::span<const std::uint32_t> slot_of_lane) {
    const auto members = clusters_.member.values().subspan(clusters_.first[cluster],
                                                           clusters_.first[cluster + 1] - clusters_.first[cluster]);
    // With a depth limit only first vertices give their continuations: those of later vertices are shorter, and late
    // light would be missing.
    std::vector<std::uint32_t> givers, slot_of_givers;
    for (std::size_t i = 0; i < members.size(); ++i) {
        if (graph().tracing.max_depth >= 0 && !is_first_[members[i]]) continue;
        givers.push_back(members[i]);
        slot_of_givers.push_back(slot_of_lane[i]);
    }
    const auto take = [&](std::uint32_t from, bool is_light, float inv_rho, const Spectrum& light) {
        for (int lane = 0; lane < shading.size(); ++lane) {
            const std::uint32_t slot =
                (is_light ? slot_of_lane : std::span<const std::uint32_t>(slot_of_givers))[shading.place(lane)];
            if (slot == nobody || !shading.sees(lane)) continue;
            taken_[slot].push_back({shading.f(lane, inv_rho) * light, from, is_light});
        }
    };
    shading.load(members);
    for_each_light_edge(
        shading, graph(), first_edge_, {},
        [&](int, std::uint32_t edge, const Spectrum& light, float inv_rho) { take(edge, true, inv_rho, light); });
    if (givers.size() < members.size()) shading.load(givers);
    for_each_indirect_edge(shading, graph(), {},
                           [&](int, std::uint32_t end, float inv_rho) { take(end, false, inv_rho, Spectrum(1)); });
}

void SharedArrivals::prepare(std::size_t first_pixel, std::size_t n, int threads) {
    const PathGraph& g = graph();
    const auto first_vertex_of = [&](std::size_t slot, std::size_t within) {
        const std::size_t path = slot / within * g.n_pixels() + first_pixel_ + slot % within;
        return std::pair(g.paths.first_vertex[path], g.paths.first_vertex[path + 1]);
    };
    for (std::size_t slot = 0; slot < g.tracing.samples_per_pixel * n_prepared_; ++slot)
        if (const auto [j, end] = first_vertex_of(slot, n_prepared_); j < end) slot_of_[j] = nobody;
    first_pixel_ = first_pixel;
    n_prepared_ = n;
    const std::size_t n_slots = g.tracing.samples_per_pixel * n;
    if (taken_.size() < n_slots) taken_.resize(n_slots);
    std::vector<std::uint32_t> touched;
    std::vector<bool> seen(clusters_.n_clusters(), false);
    for (std::size_t slot = 0; slot < n_slots; ++slot) {
        taken_[slot].clear();
        const auto [j, end] = first_vertex_of(slot, n);
        if (j == end || cluster_of_[j] == no_cluster) continue;
        slot_of_[j] = std::uint32_t(slot);
        if (!seen[cluster_of_[j]]) {
            seen[cluster_of_[j]] = true;
            touched.push_back(cluster_of_[j]);
        }
    }
    tbb::enumerable_thread_specific<std::unique_ptr<ClusterShading>> shadings(
        [&] { return std::make_unique<ClusterShading>(reader_); });
    parallel_chunks(touched.size(), 64, threads, [&](std::uint64_t, std::uint64_t begin, std::uint64_t end) {
        std::vector<std::uint32_t> slots;
        for (std::size_t i = begin; i < end; ++i) {
            const std::size_t c = touched[i];
            slots.clear();
            for (std::uint32_t m = clusters_.first[c]; m < clusters_.first[c + 1]; ++m)
                slots.push_back(slot_of_[clusters_.member[m]]);
            take_all(*shadings.local(), c, slots);
        }
    });
}

}  // namespace loom
