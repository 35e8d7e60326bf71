#include "stages/core/graph/graph_reader.h"

#include <fmt/format.h>

#include <algorithm>

#include "formats/io/content_hash.h"
#include "formats/io/error.h"
#include "stages/core/scene/scene.h"

namespace loom {
namespace {

Spectrum rgb(const Column<Half>& column, std::size_t i) {
    return {float_from_half(column[3 * i]), float_from_half(column[3 * i + 1]), float_from_half(column[3 * i + 2])};
}

}  // namespace

void require_scene_of(const PathGraph& graph, const std::string& graph_file, const Scene& scene,
                      const std::string& scene_file) {
    if (graph.provenance.inputs.empty() || graph.provenance.inputs[0].hash != content_hash_text(scene.content_hash))
        throw InputError(
            fmt::format("{}: {} was traced in another scene, or with other -D values", scene_file, graph_file));
}

GraphReader::GraphReader(const PathGraph& graph) : graph_(graph) {
    const auto& in = graph.materials;
    for (std::size_t i = 0; i < in.kind.size(); ++i) {
        BsdfModel m;
        m.kind = BsdfKind(in.kind[i]);
        m.distribution = Microfacet(in.distribution[i]);
        m.two_sided = in.two_sided[i] != 0;
        m.nonlinear = in.nonlinear[i] != 0;
        m.sample_visible = in.sample_visible[i] != 0;
        if (!in.variant.empty()) m.variant = WardVariant(in.variant[i]);
        if (!in.bump_shadowing.empty()) m.bump_shadowing = in.bump_shadowing[i] != 0;
        m.int_ior = in.int_ior[i];
        m.ext_ior = in.ext_ior[i];
        m.opacity = in.opacity[i];
        m.alpha_u = in.alpha[2 * i];
        m.alpha_v = in.alpha[2 * i + 1];
        m.exponent = in.exponent[i];
        m.diffuse = rgb(in.diffuse, i);
        m.specular = rgb(in.specular, i);
        m.transmittance = rgb(in.transmittance, i);
        m.eta_c = rgb(in.eta_c, i);
        m.k_c = rgb(in.k_c, i);
        m.coat.fdr_int = in.fdr_int[i];
        m.coat.fdr_ext = in.fdr_ext[i];
        if (!in.external_transmittance.empty())
            for (int k = 0; k < n_transmittance; ++k)
                m.coat.external_transmittance[k] = in.external_transmittance[i * n_transmittance + k];
        models_.push_back(m);
    }
    const auto& coats = graph.coats;
    for (std::size_t i = 0; i < coats.material.size(); ++i) {
        RoughCoats& mine = coats_[coats.material[i]];
        if (mine.rows.empty()) mine.alpha_min = coats.alpha[i];
        mine.alpha_max = coats.alpha[i];
        RoughCoat& row = mine.rows.emplace_back(RoughCoat{coats.fdr_int[i], coats.fdr_ext[i], {}});
        std::copy_n(coats.external_transmittance.data() + i * n_transmittance, n_transmittance,
                    row.external_transmittance.begin());
    }
    for (const auto& [material, table] : coats_) models_[material].coats = &table;
    bsdfs_.reserve(models_.size());
    for (const BsdfModel& model : models_) bsdfs_.emplace_back(model);
}

void GraphReader::prepare_slopes(std::size_t material) {
    const auto own = coats_.find(material);
    prepare_coat_slopes(models_[material], own == coats_.end() ? nullptr : &own->second);
}

void GraphReader::read_bsdf(std::size_t j, Bsdf<float>& b) const {
    const auto& v = graph_.vertices;
    b = bsdfs_[v.material[j]];
    const std::uint8_t textured = graph_.materials.textured[v.material[j]];
    if (textured == 0) return;
    if (textured & textured_parameter::diffuse) b.diffuse = rgb(v.diffuse, j);
    if (textured & textured_parameter::specular) b.specular = rgb(v.specular, j);
    if (textured & textured_parameter::transmittance) b.transmittance = rgb(v.transmittance, j);
    if (textured & textured_parameter::alpha) {
        b.alpha_u = float_from_half(v.alpha[2 * j]);
        b.alpha_v = float_from_half(v.alpha[2 * j + 1]);
    }
    if (textured & textured_parameter::opacity) b.opacity = float_from_half(v.opacity[j]);
    if (textured & textured_parameter::exponent) b.exponent = v.exponent[j];
    if (textured & textured_parameter::index) b.eta_c = rgb(v.eta_c, j), b.k_c = rgb(v.k_c, j);
}

void GraphReader::read_vertex(std::size_t j, ShadingPoint& at, std::size_t before) const {
    const auto& v = graph_.vertices;
    at.p = position(graph_, j);
    at.wo = outgoing(graph_, j);
    const bool same = before != no_vertex && same_vector(v.ns, j, before) && same_vector(v.ng, j, before) &&
                      same_vector(v.n_side, j, before) && same_vector(v.tangent, j, before);
    if (!same) {
        const Normal3f n = shading_normal(graph_, j);
        at.ng = v.ng.empty() ? n : unit_vector<Normal3f>(v.ng, j);
        at.n_side = v.n_side.empty() ? n : unit_vector<Normal3f>(v.n_side, j);
        at.perturbed = !v.n_side.empty() && !(at.n_side == n);
        at.frame = v.tangent.empty() ? Framef(n) : frame_along(n, unit_vector<Vector3f>(v.tangent, j));
    }
    at.wo_local = at.frame.to_local(at.wo);
    read_bsdf(j, at.bsdf);
}

Vector3f GraphReader::light_direction(const Point3f& p, std::size_t k) const {
    const auto& y = graph_.light_edges.y;
    const Vector3f v{y[4 * k], y[4 * k + 1], y[4 * k + 2]};
    if (y[4 * k + 3] == 0) return v;
    return normalize(Point3f(v) - p);
}

}  // namespace loom
