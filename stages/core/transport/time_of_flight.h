#pragma once
// When the light of stored paths arrives.                                                      [TR section 4.1]

#include "stages/core/transport/own_samples.h"

namespace loom {

/// Index of refraction by which light of a phase index is slowed down.
struct GroupIndex {
    std::vector<std::pair<float, float>> table;  // (phase, group)

    double of(float phase) const {
        for (const auto& [from, to] : table)
            if (std::abs(phase - from) < 1e-4f * from) return to;
        return phase;
    }
};

/// in m, along the positions as they are stored, in double precision
inline double distance(const Point3<double>& a, const Point3<double>& b) { return length(b - a); }

inline Point3<double> position(const PathGraph& graph, std::size_t j) {
    const float* p = graph.vertices.p.data() + 3 * j;
    return {p[0], p[1], p[2]};
}

/// Where the camera ray of a path starts: the pinhole, or its place on an orthographic sensor; never the near plane.
inline Point3<double> camera_point(const PathGraph& graph, std::size_t path) {
    if (graph.paths.origin.empty()) return {graph.sensor.origin[0], graph.sensor.origin[1], graph.sensor.origin[2]};
    const float* o = graph.paths.origin.data() + 3 * path;
    return {o[0], o[1], o[2]};
}

/// Whether light edge k ends where the light itself starts; else the way from there to the point that it lights is
/// known by their places.
inline bool from_emitter(const PathGraph& graph, std::size_t k) {
    if (graph.emitters.position.empty()) return true;  // no projector at all
    return EmitterKind(graph.emitters.kind[graph.light_edges.emitter[k]]) != EmitterKind::laser_spot;
}

inline Point3<double> emitter_position(const PathGraph& graph, std::size_t emitter) {
    const float* p = graph.emitters.position.data() + 3 * emitter;
    return {p[0], p[1], p[2]};
}

/// Walks along a path: on_light(L, opl) for each light that reaches the camera, what is seen directly included.
///   opl = sum_i eta_i |x_i - x_(i-1)|, infinite for lights at infinity               [TR eq. 4, with absolute indices]
/// in: camera_segment  of captures around a corner: the segment from the laser to where it lights, too
/// in: edge  first light edge of the path; out: that of the next path
template <class OnLight>
void walk_in_time(const GraphReader& reader, std::size_t path, bool camera_segment, const GroupIndex& group, std::size_t& edge, OnLight&& on_light) {
    const PathGraph& g = reader.graph();
    const auto& v = g.vertices;
    const auto& e = g.light_edges;
    const std::uint64_t begin = g.paths.first_vertex[path];
    const Spectrum Le = rgb(g.paths.Le, path);
    const bool laser_segment = camera_segment || g.nlos.capture.empty();
    double opl = 0;
    Point3<double> x;
    if (begin == g.paths.first_vertex[path + 1]) {
        if (!is_black(Le)) on_light(Le, double(INFINITY));
        return;
    }
    walk_path(
        reader, path, edge,
        [&](std::size_t j, const ShadingPoint&) {
            const Point3<double> from = j == begin ? camera_point(g, path) : x;
            x = position(g, j);
            if (j > begin || camera_segment) opl += group.of(v.eta.empty() ? 1.0f : v.eta[j]) * distance(from, x);
            if (j == begin && !is_black(Le)) on_light(Le, opl);
        },
        [&](std::size_t, std::size_t k, const Spectrum& L) {
            const float* y = e.y.data() + 4 * k;
            if (y[3] == 0) return on_light(L, double(INFINITY));
            const Point3<double> light{y[0], y[1], y[2]};
            const bool ends = from_emitter(g, k);
            double length = !ends || laser_segment ? group.of(e.eta.empty() ? 1.0f : e.eta[k]) * distance(x, light) : 0;
            if (!ends && laser_segment) length += distance(light, emitter_position(g, e.emitter[k]));
            on_light(L, opl + length);
        });
}

}  // namespace loom
