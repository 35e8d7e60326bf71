#include "stages/gather/subset.h"

#include <algorithm>
#include <array>

#include "stages/core/sampling/streams.h"
#include "stages/core/scene/embree.h"
#include "stages/core/scene/scene.h"

namespace loom::gather {

SubsetGather::SubsetGather(const GraphReader& reader, const Clusters& clusters, const Radiance& radiance,
                           const SubsetOptions& options)
    : reader_(reader),
      clusters_(clusters),
      radiance_(radiance),
      options_(options),
      light_edges_(light_edge_offsets(reader.graph())) {
    const PathGraph& g = reader.graph();
    const std::vector<std::uint32_t> of_vertex = cluster_of_vertices(clusters);
    cluster_.assign(g.n_paths(), no_cluster);
    for (std::size_t i = 0; i < g.n_paths(); ++i)
        if (g.paths.first_vertex[i] < g.paths.first_vertex[i + 1]) cluster_[i] = of_vertex[g.paths.first_vertex[i]];
}

void SubsetGather::choose(std::size_t path, std::uint32_t first, std::vector<std::uint32_t>& members) const {
    const std::size_t c = cluster_[path];
    const auto all = clusters_.member.values().subspan(clusters_.first[c], clusters_.first[c + 1] - clusters_.first[c]);
    members.assign(1, first);
    for (const std::uint32_t j : all)
        if (j != first) members.push_back(j);
    const std::size_t others = members.size() - 1, wanted = std::min<std::size_t>(options_.members, others);
    if (wanted == others) return;
    // Choose the first members of a random permutation, whose stream depends on path, pass and seed, not on the thread.
    std::uint64_t key = streams::gather(options_.seed, reader_.graph().tracing.first_sample, path);
    for (std::size_t i = 0; i < wanted; ++i) {
        key = streams::next(key);
        std::swap(members[1 + i], members[1 + i + ((key >> 32) * (others - i) >> 32)]);
    }
    members.resize(1 + wanted);
}

int SubsetGather::Worker::own_lane() const {
    for (int lane = 0;; ++lane)
        if (shading_.vertex(lane) == first_) return lane;
}

SubsetGather::Light SubsetGather::Worker::at(std::size_t path, std::uint32_t first, const Light& own, bool direct,
                                             bool indirect) {
    const PathGraph& g = gather_.reader_.graph();
    if (gather_.cluster_[path] == no_cluster) return own;
    gather_.choose(path, first, members_);
    if (members_.size() == 1) return own;
    first_ = first;
    shading_.load(members_);
    Light out = own;
    if (direct) {
        const int c = own_lane();
        out.direct = Spectrum(0);
        for_each_light_edge(shading_, g, gather_.light_edges_, {},
                            [&](int, std::uint32_t, const Spectrum& light, float inv_rho) {
                                out.direct += shading_.f(c, inv_rho) * light;
                            });
        // A light hit by the vertex's own delta lobe cannot be sampled by another vertex.
        if (is_delta(Lobe(g.vertices.lobe[first]))) {
            const ShadingPoint at = gather_.reader_.vertex(first);
            for (std::uint32_t e = gather_.light_edges_[first]; e < gather_.light_edges_[first + 1]; ++e)
                if (LightTechnique(g.light_edges.technique[e]) == LightTechnique::bsdf_hit)
                    out.direct += own_light(gather_.reader_, at, first, e);
        }
    }
    if (indirect) {
        out.indirect = gather_.options_.scene ? reconnected(first) : shared();
        const bool continued = g.vertices.flags[first] & vertex_flag::continued;
        if (continued && is_delta(Lobe(g.vertices.lobe[first]))) out.indirect += own.indirect;
    }
    return out;
}

Spectrum SubsetGather::Worker::shared() {
    const PathGraph& g = gather_.reader_.graph();
    const int c = own_lane();
    Spectrum sum(0);
    for_each_indirect_edge(shading_, g, {gather_.options_.reuse}, [&](int, std::uint32_t end, float inv_rho) {
        sum += shading_.f(c, inv_rho) * rgb(gather_.radiance_.L, end);
    });
    return sum;
}

Spectrum SubsetGather::Worker::reconnected(std::uint32_t first) {
    const PathGraph& g = gather_.reader_.graph();
    const Scene& scene = *gather_.options_.scene;
    const RayEngine& rays = *scene.rays;
    const int c = own_lane(), n = shading_.size();
    const float M = float(n - 1);
    const auto end_at = [&](std::size_t j) {
        return RayEnd{position(g, j), geometric_normal(g, j), scene.shapes[g.vertices.shape[j]].hit_error};
    };
    const RayEnd from = end_at(first);

    // Terms that wait for the result of a ray.
    std::array<Ray, 2 * max_lanes> segments;
    std::array<const Ray*, 2 * max_lanes> pointers;
    std::array<bool, 2 * max_lanes> blocked;
    std::array<Spectrum, max_lanes> value;   // from others' samples, if visible from c
    std::array<float, max_lanes> other_pdf;  // of others for c's own sample, if visible to them
    int n_others = 0, n_back = 0;
    Spectrum own_value(0);
    float own_pdf = 0;
    for (int k = 0; k < n; ++k) {
        const std::size_t j = shading_.vertex(k);
        if (k == c || !continues_shared(g, j)) continue;
        const Point3f y = position(g, j + 1);
        shading_.light_point(y, facing_normal(g, j + 1));
        if (!shading_.sees(c)) continue;
        const float rho = M * shading_.pdf_bsdf(k) + shading_.pdf_bsdf(c);
        if (!(rho > 0)) continue;
        value[n_others] = shading_.f(c, 1 / rho) * rgb(gather_.radiance_.L, j + 1);
        segments[n_others++] = spawn_segment(from, end_at(j + 1));
    }
    if (continues_shared(g, first)) {
        const Point3f y = position(g, first + 1);
        shading_.light_point(y, facing_normal(g, first + 1));
        own_pdf = shading_.pdf_bsdf(c);
        if (own_pdf > 0) own_value = shading_.f(c, 1 / M) * rgb(gather_.radiance_.L, first + 1);
        for (int k = 0; own_pdf > 0 && k < n; ++k) {
            if (k == c || !(shading_.pdf_bsdf(k) > 0)) continue;
            const std::size_t j = shading_.vertex(k);
            other_pdf[n_back] = shading_.pdf_bsdf(k);
            segments[n_others + n_back++] = spawn_segment(end_at(j), end_at(first + 1));
        }
    }
    const int n_rays = n_others + n_back;
    for (int i = 0; i < n_rays; ++i) pointers[i] = &segments[i];
    rays.occluded(pointers.data(), std::size_t(n_rays), blocked.data());
    rays_ += std::uint64_t(n_rays);

    Spectrum sum(0);
    for (int i = 0; i < n_others; ++i)
        if (!blocked[i]) sum += value[i];
    if (own_pdf > 0) {
        float weight = (M - float(n_back)) / own_pdf;  // members that could not have sampled it
        for (int i = 0; i < n_back; ++i) weight += 1 / ((blocked[n_others + i] ? 0.0f : M * other_pdf[i]) + own_pdf);
        sum += own_value * weight;
    }
    return sum;
}

}  // namespace loom::gather
