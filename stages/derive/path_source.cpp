#include "stages/derive/path_source.h"

namespace loom::derive {

PathSource::PathSource(const PathGraph& g, const Scene& s, const SceneTangents& t, const Attached& how)
    : graph(g), scene(s), tangents(t), reader(g), motions(s, t), attached(how) {
    for (std::uint32_t i = 0; i < s.shapes.size(); ++i) {
        shape_matters.push_back(t.moves(i) || !t.shading_normals[i].empty());
        shape_varies.push_back(motions.varies(i));
    }
    for (std::size_t m = 0; m < g.materials.kind.size(); ++m) {
        const BsdfKind kind = reader.model(m).kind;
        depends_on_wo.push_back(kind != BsdfKind::diffuse);
        has_delta.push_back(has_delta_lobe(kind));
    }
    for (const auto& effects : t.materials) {
        material_matters.push_back(0);
        if (!effects.empty()) add_material(material_matters.size() - 1);
    }
    for (std::size_t e = 0; e < s.emitters.size(); ++e) {
        const bool of_shape = s.emitters[e].kind == EmitterKind::area;
        emitter_matters.push_back(!t.emitters[e].empty() || !t.radiance[e].empty() ||
                                  (of_shape && shape_matters[s.emitters[e].shape_idx]));
        any_emitter_matters |= emitter_matters.back() != 0;
    }
    if (!g.vertices.medium.empty())
        for (const auto& effects : t.materials)
            for (const auto& [p, effect] : effects) media_matter |= effect.int_ior != 0;
    // Coats whose roughness or index changes, by a parameter or along a texture.
    for (std::size_t m = 0; m < s.materials.size(); ++m) {
        if (s.materials[m].model.kind != BsdfKind::rough_plastic) continue;
        bool coat = s.materials[m].alpha_u_idx >= 0 && t.geometry();
        for (const auto& [p, effect] : t.materials[m])
            coat |= effect.alpha_u != 0 || effect.alpha_v != 0 || effect.eta != 0;
        if (coat) reader.prepare_slopes(m);
    }
}

bool PathSource::touches(std::size_t path) const {
    const PathGraph& g = graph;
    if (tangents.camera_moves()) return true;
    const auto [begin, end] = vertices_of(g, path);
    if (begin == end) return scene.environment_idx >= 0 && emitter_matters[std::size_t(scene.environment_idx)];
    // Lights that change reach every path that samples them.
    if (any_emitter_matters) return true;
    // Without branches: what a vertex is on cannot be foreseen.
    char any = 0;
    for (std::size_t j = begin; j < end; ++j) any |= shape_matters[g.vertices.shape[j]];
    if (!any_material_matters) return any;
    for (std::size_t j = begin; j < end; ++j) any |= material_matters[g.vertices.material[j]];
    if (any) return true;
    // Media are materials; a capture's wall is the light of every path.
    if (!g.vertices.medium.empty())
        for (std::size_t j = begin; j < end; ++j)
            if (const auto m = g.vertices.medium[j]; m != no_medium && material_matters[m]) return true;
    return scene.nlos && laser_point(path).hit && material_matters[lit_material(path)];
}

}  // namespace loom::derive
