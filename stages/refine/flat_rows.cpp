#include "stages/refine/flat_rows.h"

#include <cstring>
#include <numeric>

#include "stages/core/transport/own_samples.h"
#include "stages/core/transport/parallel.h"

namespace loom::refine {
namespace {

constexpr std::uint64_t vertices_per_chunk = 1 << 16;
constexpr std::uint64_t ahead = 24;  // rows lie anywhere: asked for so many vertices before they are written

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

FlatRows::FlatRows(const GraphReader& reader, std::span<const std::uint32_t> place, std::size_t n_places,
                   std::span<const std::uint32_t> offsets, int threads)
    : vertices(place.size()), first_light(n_places + 1) {
    const PathGraph& g = reader.graph();
    const auto& v = g.vertices;
    const auto& m = g.materials;
    std::vector<std::uint8_t> matte;
    for (std::size_t i = 0; i < m.kind.size(); ++i)
        matte.push_back(BsdfKind(m.kind[i]) == BsdfKind::diffuse && m.opacity[i] == 1 && !(m.textured[i] & textured_parameter::opacity));

    parallel_chunks(g.n_vertices(), vertices_per_chunk, threads, [&](std::uint64_t, std::uint64_t begin, std::uint64_t end) {
        for (std::uint64_t j = begin; j < end; ++j) {
            if (const std::uint64_t later = j + ahead; later < end && matte[v.material[later]] && place[later] < n_places) {
                __builtin_prefetch(&vertices[place[later]], 1);
                __builtin_prefetch(&first_light[place[later] + 1], 1);
            }
            const std::uint16_t material = v.material[j];
            const std::uint32_t ns = packed(v.ns, j);
            if (!matte[material] || place[j] >= n_places || (!v.n_side.empty() && packed(v.n_side, j) != ns)) continue;
            VertexRow row{};
            row.p = triple<Point3f>(v.p, j);
            row.wo = triple<Vector3f>(v.wo, j);
            row.flags = v.flags[j];
            if (row.flags & vertex_flag::continued) row.next = continuation_direction(g, j);
            row.ns = ns;
            row.q = v.q.empty() ? 1.0f : v.q[j];
            row.pdf_w = v.pdf_w[j];
            row.material = material;
            if (m.textured[material] & textured_parameter::diffuse) std::copy_n(v.diffuse.data() + 3 * j, 3, row.diffuse);
            row.matte = 1;
            row.vertex = std::uint32_t(j);
            vertices[place[j]] = row;
            first_light[place[j] + 1] = offsets[j + 1] - offsets[j];
        }
    });
    std::partial_sum(first_light.begin(), first_light.end(), first_light.begin());

    const auto& e = g.light_edges;
    lights = HugeArray<LightRow>(first_light.back());
    parallel_chunks(g.n_vertices(), vertices_per_chunk, threads, [&](std::uint64_t, std::uint64_t begin, std::uint64_t end) {
        for (std::uint64_t j = begin; j < end; ++j) {
            if (const std::uint64_t later = j + ahead; later < end && offsets[later] < offsets[later + 1] && place[later] < n_places)
                __builtin_prefetch(&lights[first_light[place[later]]], 1);
            if (offsets[j] == offsets[j + 1] || place[j] >= n_places) continue;
            std::uint32_t to = first_light[place[j]];
            if (to == first_light[place[j] + 1]) continue;  // not matte
            for (std::uint32_t i = offsets[j]; i < offsets[j + 1]; ++i)
                lights[to++] = {triple<Point3f>(e.y, i, 4), packed(e.n, i), rgb(e.Li, i), e.pdf_nee_w[i], e.pdf_bsdf_w[i],
                                EmitterKind(g.emitters.kind[e.emitter[i]]), LightTechnique(e.technique[i])};
        }
    });
}

}  // namespace loom::refine
