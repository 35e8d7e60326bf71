#pragma once
// What the forward and the reverse walk along stored paths share.

#include "stages/core/graph/own_samples.h"
#include "stages/core/scene/nlos.h"
#include "stages/derive/scene_tangents.h"
#include "stages/derive/surface_motion.h"

namespace loom::derive {

/// A Bsdf with the derivatives of its parameters in component i.
template <int n, class Real>
Bsdf<Dual<n, Real>> with_tangent(const Bsdf<float>& bsdf, const MaterialTangent& t, int i) {
    Bsdf<Dual<n, Real>> b(bsdf);
    const auto set = [i](Dual<n, Real>& x, double rate) { x.d[std::size_t(i)] = Real(rate); };
    for (int c = 0; c < 3; ++c) {
        set(b.diffuse[c], t.diffuse[c]);
        set(b.specular[c], t.specular[c]);
        set(b.transmittance[c], t.transmittance[c]);
        set(b.eta_c[c], t.eta_c[c]);
        set(b.k_c[c], t.k_c[c]);
    }
    set(b.alpha_u, t.alpha_u);
    set(b.alpha_v, t.alpha_v);
    set(b.eta, t.eta);
    set(b.opacity, t.opacity);
    set(b.exponent, t.exponent);
    return b;
}

inline Frame<double> in_double(const Framef& f) {
    return {Vector3<double>(f.s), Vector3<double>(f.t), Normal3<double>(f.n)};
}

/// Paths of a graph in their scene, with what depends on the parameters. Borrows all arguments of the constructor.
struct PathSource {
    const PathGraph& graph;
    const Scene& scene;
    const SceneTangents& tangents;
    GraphReader reader;
    SurfaceMotions motions;
    std::vector<char> shape_matters, material_matters, emitter_matters;
    std::vector<char> shape_varies;   // [shape] SurfaceMotions::varies()
    std::vector<char> depends_on_wo;  // [material] whether f cos or a delta lobe depends on wo
    std::vector<char> has_delta;      // [material] has_delta_lobe()
    bool any_emitter_matters = false, any_material_matters = false;
    bool media_matter = false;  // the index of a stored medium depends on a parameter

    Attached attached;

    PathSource(const PathGraph& g, const Scene& s, const SceneTangents& t, const Attached& how = {});

    /// Marks a material as one that depends on a parameter.
    void add_material(std::size_t m) { material_matters[m] = any_material_matters = true; }

    /// Whether anything that a path touches depends on a parameter.
    bool touches(std::size_t path) const;

    SurfacePlace place(std::size_t j, const ShadingPoint& at) const {
        const auto& v = graph.vertices;
        return {v.shape[j],
                v.primitive.empty() ? 0 : v.primitive[j],
                position<double>(graph, j),
                Vector3<double>(at.ng),
                Vector3<double>(at.frame.n),
                Vector3<double>(at.frame.s)};
    }
    SurfacePlace place_of_light(std::size_t emitter, const Point3<double>& y, const Vector3<double>& n) const {
        SurfacePlace place;
        place.shape_idx = scene.emitters[emitter].shape_idx;
        place.p = y;
        place.ng = place.ns = n;
        return place;
    }
    Vector3<double> normal_of_light(std::size_t k) const {
        if (graph.light_edges.n.empty()) return {};
        return Vector3<double>(unit_vector<Normal3f>(graph.light_edges.n, k));
    }

    /// Whether the vertex after j, nulls left out, is on a surface with a delta lobe, so that the ray to it stays.
    bool reaches_delta(std::size_t j) const {
        const auto& v = graph.vertices;
        std::size_t k = j + 1;
        while (Lobe(v.lobe[k]) == Lobe::null && (v.flags[k] & vertex_flag::continued)) ++k;
        return has_delta[v.material[k]];
    }

    /// Li of a radiance of 1 at a point: of a light whose radiance is 0 in a channel.
    Rgb<double> unit_emission(std::size_t emitter, const Point3<double>& at) const {
        const Emitter& e = scene.emitters[emitter];
        if (e.kind != EmitterKind::point && e.kind != EmitterKind::spot) return Rgb<double>(1);
        return Rgb<double>(1 / length2(at - Point3<double>(e.position)));
    }

    /// Whether light of an emitter may change although nothing before it does.
    bool light_changes(std::size_t emitter) const { return emitter_matters[emitter] || scene.nlos || media_matter; }

    /// Laser spot of the capture that a path belongs to, and the material of its surface.
    const NlosCapture::LaserPoint& laser_point(std::size_t path) const {
        const NlosCapture& capture = *scene.nlos;
        return capture.laser_points[capture.laser_point(path % graph.n_pixels())];
    }
    std::uint32_t lit_material(std::size_t path) const {
        return scene.shapes[laser_point(path).hit.shape_idx].material_idx;
    }
};

}  // namespace loom::derive
