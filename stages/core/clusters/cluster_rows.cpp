#include "stages/core/clusters/cluster_rows.h"

#include <algorithm>
#include <cstring>
#include <numeric>

#include "stages/core/compute/parallel.h"

namespace loom {
namespace {

constexpr std::uint64_t vertices_per_chunk = 1 << 16;
constexpr std::uint64_t ahead = 24;  // prefetch distance in vertices, because rows are scattered

std::uint32_t packed(const Column<std::int16_t>& column, std::size_t j) {
    std::uint32_t uv;
    std::memcpy(&uv, column.data() + 2 * j, sizeof uv);
    return uv;
}

template <class V>
V triple(const Column<float>& column, std::size_t j, std::size_t width = 3) {
    return {column[width * j], column[width * j + 1], column[width * j + 2]};
}

}  // namespace

RowMaker::RowMaker(const GraphReader& reader) : graph_(reader.graph()) {
    const auto& m = graph_.materials;
    for (std::size_t i = 0; i < m.kind.size(); ++i)
        diffuse_.push_back(BsdfKind(m.kind[i]) == BsdfKind::diffuse && m.opacity[i] == 1 &&
                           !(m.textured[i] & textured_parameter::opacity));
}

VertexRow RowMaker::vertex(std::size_t j) const {
    const auto& v = graph_.vertices;
    VertexRow row{};
    row.p = triple<Point3f>(v.p, j);
    row.wo = triple<Vector3f>(v.wo, j);
    row.ns = packed(v.ns, j);
    row.q = v.q.empty() ? 1.0f : v.q[j];
    row.pdf_w = v.pdf_w[j];
    row.eta = v.eta.empty() ? 1.0f : v.eta[j];
    row.bits = v.flags[j];
    row.material = v.material[j];
    if (graph_.materials.textured[row.material] & textured_parameter::diffuse)
        std::copy_n(v.diffuse.data() + 3 * j, 3, row.diffuse);
    const bool perturbed = !v.n_side.empty() && packed(v.n_side, j) != row.ns;
    if (perturbed) row.bits |= vertex_bit::perturbed;
    if (diffuse_[row.material] && !perturbed) row.bits |= vertex_bit::diffuse;
    if (is_delta(Lobe(v.lobe[j]))) row.bits |= vertex_bit::delta;
    if (row.bits & vertex_flag::continued) {
        row.next = continuation_direction(graph_, j);
        if (!v.eta.empty() && v.eta[j + 1] != row.eta) row.bits |= vertex_bit::other_medium;
    }
    return row;
}

LightRow RowMaker::light(std::size_t i) const {
    const auto& e = graph_.light_edges;
    return {triple<Point3f>(e.y, i, 4),
            packed(e.n, i),
            rgb(e.Li, i),
            e.pdf_nee_w[i],
            e.pdf_bsdf_w[i],
            std::uint32_t(i),
            EmitterKind(graph_.emitters.kind[e.emitter[i]]),
            LightTechnique(e.technique[i])};
}

ClusterRows::ClusterRows(const GraphReader& reader, std::span<const std::uint32_t> place, std::size_t n_places,
                         std::span<const std::uint32_t> offsets, int threads)
    : vertices(place.size()), first_light_(n_places + 1) {
    const RowMaker make(reader);
    const std::size_t n = place.size();
    const PathGraph& graph = reader.graph();
    const Column<std::uint64_t>& first_vertex = graph.paths.first_vertex;
    const int last_depth = graph.tracing.max_depth - 1;  // of a vertex from which a path can continue
    parallel_chunks(n, vertices_per_chunk, threads, [&](std::uint64_t, std::uint64_t begin, std::uint64_t end) {
        std::size_t path = std::size_t(std::upper_bound(first_vertex.begin(), first_vertex.end(), begin) -
                                       first_vertex.begin());  // the next path
        for (std::uint64_t j = begin; j < end; ++j) {
            while (path < first_vertex.size() && first_vertex[path] <= j) ++path;
            if (const std::uint64_t later = j + ahead; later < end && place[later] < n_places) {
                __builtin_prefetch(&vertices[place[later]], 1);
                __builtin_prefetch(&first_light_[place[later] + 1], 1);
            }
            if (place[j] >= n_places) continue;
            VertexRow& row = vertices[place[j]] = make.vertex(j);
            if ((row.bits & vertex_flag::continued) && place[j + 1] >= n_places) row.bits |= vertex_bit::ends_alone;
            if (last_depth >= 0 && path > 0 && j - first_vertex[path - 1] + 1 == std::uint64_t(last_depth))
                row.bits |= vertex_bit::last_step;
            first_light_[place[j] + 1] = offsets[j + 1] - offsets[j];
        }
    });
    std::partial_sum(first_light_.begin(), first_light_.end(), first_light_.begin());
}

void ClusterRows::load_lights(const GraphReader& reader, std::span<const std::uint32_t> place, std::size_t begin,
                              std::size_t end, std::span<const std::uint32_t> offsets, int threads) {
    const RowMaker make(reader);
    first_loaded_ = first_light_[begin];
    lights_ = {};  // free the old rows before allocating the new ones
    lights_ = HugeArray<LightRow>(first_light_[end] - first_loaded_);
    const auto wanted = [&](std::uint64_t j) { return place[j] - begin < end - begin && offsets[j] < offsets[j + 1]; };
    parallel_chunks(place.size(), vertices_per_chunk, threads,
                    [&](std::uint64_t, std::uint64_t first, std::uint64_t last) {
                        for (std::uint64_t j = first; j < last; ++j) {
                            if (const std::uint64_t later = j + ahead; later < last && wanted(later))
                                __builtin_prefetch(&lights_[first_light_[place[later]] - first_loaded_], 1);
                            if (!wanted(j)) continue;
                            std::uint32_t to = first_light_[place[j]] - first_loaded_;
                            for (std::uint32_t i = offsets[j]; i < offsets[j + 1]; ++i) lights_[to++] = make.light(i);
                        }
                    });
}

}  // namespace loom
