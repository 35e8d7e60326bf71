#pragma once
// Light of first hits shared by their clusters, with its time of flight.
//
// The first vertex j of a path takes the light edges and the continuations of all members k of its cluster, as in
// refinement (PG eq. 7 to 12), and the light of each continuation's own path:
//   sum_e f_j cos_j / rho_e L_e  at  |x_0 x_j| + eta_e |x_j y_e|
//   sum_k f_j cos_j / rho_k L'   at  |x_0 x_j| + eta_k |x_j x_(k+1)| + the rest of path k,    L' of each light of that
//   rest
// Lengths are those of the polyline through x_j and exact for it. The light is approximate: L' is what x_k receives.

#include <span>
#include <vector>

#include "formats/clusters.h"
#include "stages/core/clusters/cluster_edges.h"
#include "stages/core/graph/time_of_flight.h"

namespace loom {

class SharedArrivals {
  public:
    /// Graph and clusters are borrowed.
    SharedArrivals(const PathGraph& graph, const Clusters& clusters, const Timing& timing, int threads);

    const PathGraph& graph() const { return reader_.graph(); }
    /// Finds what the paths of pixels [first, first + n) take from their clusters; forgets earlier pixels.
    void prepare(std::size_t first_pixel, std::size_t n, int threads);
    /// Calls on_light(L, opl) for each light of a path.
    /// needs:   prepare() of its pixel
    template <class OnLight>
    void walk(std::size_t path, OnLight&& on_light) const;
    /// Approximate memory of prepare() per pixel, bytes.
    std::size_t bytes_per_pixel() const;

  private:
    struct Segment {
        Spectrum factor;  // own estimate of the light along it
        double opl = 0;
    };
    /// A light edge or the end of a continuation that a first vertex takes from its cluster, with its factor (of an edge
    /// including its light).
    struct Taken {
        Spectrum factor;
        std::uint32_t from;
        bool is_light;
    };
    static constexpr std::uint32_t nobody = 0xffffffffu;

    void take_all(ClusterShading& shading, std::size_t cluster, std::span<const std::uint32_t> slot_of_lane);
    /// Visits the lights of a path from vertex j on, times `beta`.
    template <class OnLight>
    void own_rest(std::size_t j, Spectrum beta, double opl, OnLight&& on_light) const;

    GraphReader reader_;
    const Clusters& clusters_;
    OpticalLengths lengths_;
    std::vector<std::uint32_t> first_edge_;      // [vertex+1]
    std::vector<std::uint32_t> cluster_of_;      // [vertex]
    std::vector<Segment> continuation_, light_;  // [vertex], [light edge]
    std::size_t first_pixel_ = 0, n_prepared_ = 0;
    std::vector<std::uint32_t> slot_of_;     // [vertex] slot of the prepared path that starts there
    std::vector<bool> is_first_;             // [vertex] first of its path
    std::vector<std::vector<Taken>> taken_;  // [slot], slot = pixel - first pixel + sample * n
};

template <class OnLight>
void SharedArrivals::own_rest(std::size_t j, Spectrum beta, double opl, OnLight&& on_light) const {
    for (;; ++j) {
        for (std::uint32_t e = first_edge_[j]; e < first_edge_[j + 1]; ++e)
            on_light(beta * light_[e].factor, opl + light_[e].opl);
        if (!(graph().vertices.flags[j] & vertex_flag::continued)) return;
        beta *= continuation_[j].factor;
        opl += continuation_[j].opl;
    }
}

template <class OnLight>
void SharedArrivals::walk(std::size_t path, OnLight&& on_light) const {
    const PathGraph& g = graph();
    const Spectrum Le = rgb(g.paths.Le, path);
    const std::uint64_t j = g.paths.first_vertex[path];
    if (j == g.paths.first_vertex[path + 1]) {
        if (!is_black(Le)) on_light(Le, double(INFINITY));
        return;
    }
    const Point3<double> x = position<double>(g, j);
    const double opl = lengths_.from_camera(path);
    if (!is_black(Le)) on_light(Le, opl);
    if (cluster_of_[j] == no_cluster) {
        own_rest(j, Spectrum(1), opl, on_light);
        return;
    }
    const std::size_t pixel = path % g.n_pixels(), sample = path / g.n_pixels();
    for (const Taken& t : taken_[sample * n_prepared_ + pixel - first_pixel_]) {
        if (t.is_light)
            on_light(t.factor, opl + lengths_.to_light(t.from, x));
        else
            own_rest(t.from, t.factor, opl + lengths_.to_vertex(t.from, x), on_light);
    }
    // Light that its own delta lobe has found belongs to no other vertex.
    if (is_delta(Lobe(g.vertices.lobe[j]))) {
        for (std::uint32_t e = first_edge_[j]; e < first_edge_[j + 1]; ++e)
            if (LightTechnique(g.light_edges.technique[e]) == LightTechnique::bsdf_hit)
                on_light(light_[e].factor, opl + light_[e].opl);
        if (g.vertices.flags[j] & vertex_flag::continued)
            own_rest(j + 1, continuation_[j].factor, opl + continuation_[j].opl, on_light);
    }
}

}  // namespace loom
