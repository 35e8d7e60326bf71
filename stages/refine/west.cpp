#include "stages/refine/west.h"

#include <flann/algorithms/dist.h>
#include <flann/algorithms/kdtree_single_index.h>

#include <algorithm>

#include "stages/core/compute/parallel.h"

namespace loom::refine {

Filtered west_filter(const PathGraph& graph, std::span<const std::uint32_t> members, std::uint32_t neighbours,
                     const SharingOptions& sharing, int threads) {
    const GraphReader reader(graph);
    const HugeArray<Light> own = path_radiance(reader, threads);
    const std::vector<std::uint32_t> offsets = light_edge_offsets(graph);
    Filtered out{HugeArray<Light>(graph.n_vertices()), HugeArray<Light>(graph.n_vertices())};
    std::copy_n(own.data(), own.size(), out.L.data());
    if (members.empty()) return out;

    std::vector<float> positions(3 * members.size());
    for (std::size_t i = 0; i < members.size(); ++i)
        std::copy_n(graph.vertices.p.data() + 3 * std::size_t(members[i]), 3, positions.data() + 3 * i);
    flann::KDTreeSingleIndex<flann::L2_Simple<float>> index(flann::Matrix<float>(positions.data(), members.size(), 3),
                                                            flann::KDTreeSingleIndexParams(10));
    index.buildIndex();
    const std::size_t k = std::min<std::size_t>(neighbours, members.size());
    parallel_chunks(members.size(), 1024, threads, [&](std::uint64_t, std::uint64_t begin, std::uint64_t end) {
        flann::SearchParams exact(flann::FLANN_CHECKS_UNLIMITED);
        exact.cores = 1;
        const std::size_t n = end - begin;
        std::vector<std::size_t> rows(n * k);
        std::vector<float> distances(n * k);
        flann::Matrix<std::size_t> row_matrix(rows.data(), n, k);
        flann::Matrix<float> distance_matrix(distances.data(), n, k);
        index.knnSearch(flann::Matrix<float>(positions.data() + 3 * begin, n, 3), row_matrix, distance_matrix, k,
                        exact);
        const auto shading = std::make_unique<ClusterShading>(reader);
        std::vector<std::uint32_t> near(k);
        for (std::size_t i = 0; i < n; ++i) {
            const std::uint32_t j = members[begin + i];
            for (std::size_t m = 0; m < k; ++m) near[m] = members[rows[i * k + m]];
            // Among equal positions any may be returned; the vertex itself must be in its own neighbourhood.
            if (std::find(near.begin(), near.end(), j) == near.end()) near.back() = j;
            shading->load(near);
            int lane = 0;
            while (shading->vertex(lane) != j) ++lane;
            const auto reflected = [&](float inv_rho) {
                return Spectrum{shading->f(0)[lane], shading->f(1)[lane], shading->f(2)[lane]} * inv_rho;
            };
            Spectrum direct(0), indirect(0);
            for_each_light_edge(*shading, graph, offsets, sharing,
                                [&](int, std::uint32_t, const Spectrum& light, float inv_rho) {
                                    direct += reflected(inv_rho) * light;
                                });
            for_each_indirect_edge(*shading, graph, sharing, [&](int, std::uint32_t from, float inv_rho) {
                indirect += reflected(inv_rho) * Spectrum{own[from].r, own[from].g, own[from].b};
            });
            if (is_delta(Lobe(graph.vertices.lobe[j]))) {
                const ShadingPoint at = reader.vertex(j);
                if (graph.vertices.flags[j] & vertex_flag::continued) {
                    const Light& from = own[j + 1];
                    indirect += own_continuation(reader, at, j, continuation_direction(graph, j)) *
                                Spectrum{from.r, from.g, from.b};
                }
                for (std::uint32_t e = offsets[j]; e < offsets[j + 1]; ++e)
                    if (LightTechnique(graph.light_edges.technique[e]) == LightTechnique::bsdf_hit)
                        direct += own_light(reader, at, j, e);
            }
            const Spectrum L = direct + indirect;
            out.L[j] = {L.r, L.g, L.b};
            out.direct[j] = {direct.r, direct.g, direct.b};
        }
    });
    return out;
}

}  // namespace loom::refine
