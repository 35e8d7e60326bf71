#pragma once
// Times of flight of stored paths, as optical path lengths.                                     [TR section 4.1]

#include "stages/core/graph/own_samples.h"

namespace loom {

/// Segments whose length counts, and the speed of light.
struct Timing {
    // whether the first segment counts; in NLOS captures also that from the laser to the laser spot
    bool camera_segment = true;
    std::vector<std::pair<float, float>> group_index{};  // (phase index, group index)

    /// Returns the group index for a phase index; light travels with the former.
    double index(float phase) const {
        for (const auto& [from, to] : group_index)
            if (std::abs(phase - from) < 1e-4f * from) return to;
        return phase;
    }
};

/// Optical path lengths (m) along the positions as they are stored, in double precision. The graph is borrowed.
///   opl = sum_i eta_i |x_i - x_(i-1)|, infinite for lights at infinity               [TR eq. 4, with absolute indices]
class OpticalLengths {
  public:
    OpticalLengths(const PathGraph& graph, Timing timing)
        : graph_(graph),
          timing_(std::move(timing)),
          laser_segment_(timing_.camera_segment || graph.nlos.capture.empty()) {}

    /// Returns the length from the camera to the first vertex of a path; 0 where that segment does not count.
    double from_camera(std::size_t path) const {
        return timing_.camera_segment ? to_vertex(graph_.paths.first_vertex[path], camera_origin<double>(graph_, path))
                                      : 0.0;
    }
    /// Returns the length from a point to vertex j, in the medium of the segment that arrives there.
    double to_vertex(std::size_t j, const Point3<double>& from) const {
        return index_of(graph_.vertices.eta, j) * length(position<double>(graph_, j) - from);
    }
    /// Returns the length along light edge k from a point, and on to the light's origin if that is elsewhere (a laser
    /// spot, which reflects: the laser is in the medium of the edge).
    double to_light(std::size_t k, const Point3<double>& from) const {
        const auto& e = graph_.light_edges;
        const float* y = e.y.data() + 4 * k;
        if (y[3] == 0) return INFINITY;
        const Point3<double> light{y[0], y[1], y[2]};
        const bool lit_spot = !graph_.emitters.position.empty() &&
                              EmitterKind(graph_.emitters.kind[e.emitter[k]]) == EmitterKind::laser_spot;
        const double sum = lit_spot || laser_segment_ ? index_of(e.eta, k) * length(light - from) : 0;
        return lit_spot && laser_segment_ ? sum + from_laser(k) : sum;
    }
    /// Returns the length from a laser to its spot, of light edge k.
    double from_laser(std::size_t k) const {
        const auto& e = graph_.light_edges;
        const float* y = e.y.data() + 4 * k;
        const float* p = graph_.emitters.position.data() + 3 * e.emitter[k];
        return index_of(e.eta, k) * length(Point3<double>{p[0], p[1], p[2]} - Point3<double>{y[0], y[1], y[2]});
    }

  private:
    double index_of(const Column<float>& eta, std::size_t i) const {
        return timing_.index(eta.empty() ? 1.0f : eta[i]);
    }

    const PathGraph& graph_;
    Timing timing_;
    bool laser_segment_;
};

/// Walks along a path and calls on_seen(Le, opl) for its directly visible emitter, black or not, then on_edge(k, L, opl)
/// for each light edge k.
/// in:      edge  first light edge of the path; out: that of the next path
template <class OnSeen, class OnEdge>
void walk_edges_in_time(const GraphReader& reader, const OpticalLengths& lengths, std::size_t path, std::size_t& edge,
                        OnSeen&& on_seen, OnEdge&& on_edge) {
    const PathGraph& g = reader.graph();
    const std::uint64_t begin = g.paths.first_vertex[path];
    const Spectrum Le = rgb(g.paths.Le, path);
    double opl = 0;
    Point3<double> x;
    if (begin == g.paths.first_vertex[path + 1]) {
        on_seen(Le, double(INFINITY));
        return;
    }
    walk_path(
        OwnSamples(reader), path, edge,
        [&](std::size_t j, const ShadingPoint&) {
            opl += j == begin ? lengths.from_camera(path) : lengths.to_vertex(j, x);
            x = position<double>(g, j);
            if (j == begin) on_seen(Le, opl);
        },
        [&](std::size_t, std::size_t k, const Spectrum& L) { on_edge(k, L, opl + lengths.to_light(k, x)); });
}

/// Walks along a path and calls on_light(L, opl) for each light that reaches the camera, including the directly visible
/// emitter.
/// in:      edge  first light edge of the path; out: that of the next path
template <class OnLight>
void walk_in_time(const GraphReader& reader, const OpticalLengths& lengths, std::size_t path, std::size_t& edge,
                  OnLight&& on_light) {
    walk_edges_in_time(
        reader, lengths, path, edge,
        [&](const Spectrum& Le, double opl) {
            if (!is_black(Le)) on_light(Le, opl);
        },
        [&](std::size_t, const Spectrum& L, double opl) { on_light(L, opl); });
}

}  // namespace loom
