#include "stages/core/clusters/cluster_shading.h"

#include <cstring>
#include <stdexcept>

namespace loom {
namespace {

bool grey(const Spectrum& s) {
    return s.r == s.g && s.g == s.b;
}

/// Whether f cos of a material is a coloured base under a grey coat, and which of the two exist.
ClusterShading::Lobes lobes_of(const BsdfModel& m, std::uint8_t textured) {
    const bool grey_specular = grey(m.specular) && !(textured & textured_parameter::specular);
    switch (m.kind) {
        case BsdfKind::diffuse:
        case BsdfKind::plastic:
            return {.split = true, .base = true};
        case BsdfKind::rough_plastic:
        case BsdfKind::phong:
        case BsdfKind::ward:
            return {.split = grey_specular, .base = true, .coat = true};
        case BsdfKind::rough_diffuse:
            return {.split = grey(m.diffuse) && !(textured & textured_parameter::diffuse), .coat = true};
        case BsdfKind::rough_conductor:
            return {.split = grey_specular && grey(m.eta_c) && grey(m.k_c) && !(textured & textured_parameter::index),
                    .coat = true};
        case BsdfKind::rough_dielectric:
            return {.split = grey_specular && grey(m.transmittance) && !(textured & textured_parameter::transmittance),
                    .coat = true};
        case BsdfKind::conductor:
        case BsdfKind::dielectric:
        case BsdfKind::thin_dielectric:
        case BsdfKind::null:
            break;
    }
    return {.split = true};
}

/// Packs both octahedral coordinates of a direction into one word.
std::uint32_t packed(const Column<std::int16_t>& column, std::size_t j) {
    std::uint32_t uv;
    std::memcpy(&uv, column.data() + 2 * j, sizeof uv);
    return uv;
}

}  // namespace

void ClusterShading::load(std::span<const std::uint32_t> vertices) {
    own_rows_.clear();
    for (const std::uint32_t j : vertices) own_rows_.push_back(make_row_.vertex(j));
    load(vertices, own_rows_);
}

void ClusterShading::load(std::span<const std::uint32_t> vertices, std::span<const VertexRow> rows) {
    const PathGraph& g = reader_.graph();
    const auto& v = g.vertices;
    const int n = int(vertices.size());
    if (n > max_lanes) throw std::logic_error("ClusterShading: cluster too large");
    vertices_ = vertices, rows_ = rows;
    std::uint16_t material[max_lanes];
    for (int l = 0; l < n; ++l) {
        // Insertion sort is stable, and fast for few lanes of mostly one material.
        const std::uint16_t m = rows[std::size_t(l)].material;
        int k = l;
        for (; k > 0 && m < material[k - 1]; --k) material[k] = material[k - 1], place_[k] = place_[k - 1];
        material[k] = m, place_[k] = std::uint16_t(l);
    }

    ClusterColumns& c = columns_;
    c.n = n;
    c.runs.clear();
    c.has_tangent = !v.tangent.empty();
    perturbed_.clear();
    perturbed_lane_.clear();
    has_last_steps_ = false;
    for (int l = 0; l < n; ++l) {
        const VertexRow& at = row(l);
        if (l == 0 || material[l] != material[l - 1])
            c.runs.push_back({&reader_.model(material[l]), l, l, has_own(material[l])});
        c.runs.back().end = l + 1;
        c.px[l] = at.p.x, c.py[l] = at.p.y, c.pz[l] = at.p.z;
        c.wo_x[l] = at.wo.x, c.wo_y[l] = at.wo.y, c.wo_z[l] = at.wo.z;
        c.ns[l] = at.ns;
        if (c.has_tangent) c.tangent[l] = packed(v.tangent, vertex(l));
        attempted_nee_[l] = (at.bits & vertex_flag::attempted_nee) != 0;
        c.survival[l] = (at.bits & vertex_flag::attempted_bsdf) ? at.q : 0.0f;
        has_last_steps_ |= (at.bits & vertex_bit::last_step) != 0;
        if (at.bits & vertex_bit::perturbed) {
            perturbed_.push_back(reader_.vertex(vertex(l)));
            perturbed_lane_.push_back(l);
        }
    }
    for (int l = n; l < padded(); ++l) c.survival[l] = 0, attempted_nee_[l] = 0;
    kernels_.prepare(c);
    for (const ClusterColumns::Run& run : c.runs) load_textures(run, g.materials.textured[material[run.begin]]);
    lobes_ = {.split = true};
    for (const ClusterColumns::Run& run : c.runs) {
        const Lobes of_run = lobes_of(*run.model, g.materials.textured[material[run.begin]]);
        lobes_.split &= of_run.split, lobes_.base |= of_run.base, lobes_.coat |= of_run.coat;
    }
    if (!lobes_.split) return;
    kernels_.prepare_tints(c);
    lobes_.one_base = lobes_.base && has_one_base(g.materials.textured[material[0]]);
}

/// Whether all lanes have one normal, one side, and one opaque material.
bool ClusterShading::has_one_base(std::uint8_t textured) const {
    const ClusterColumns& c = columns_;
    const BsdfModel& model = *c.runs[0].model;
    if (c.runs.size() > 1 || model.opacity < 1 || (textured & textured_parameter::opacity) || !perturbed_.empty())
        return false;
    if (!(c.wo_z[0] > 0) && !model.two_sided) return false;
    for (int l = 0; l < c.n; ++l)
        if (c.ns[l] != c.ns[0] || c.wo_z[l] == 0 || (c.wo_z[l] > 0) != (c.wo_z[0] > 0)) return false;
    return true;
}

bool ClusterShading::has_own(std::uint16_t material) const {
    constexpr std::uint8_t own = textured_parameter::exponent | textured_parameter::index;
    return (reader_.graph().materials.textured[material] & own) != 0 || reader_.model(material).coats != nullptr;
}

void ClusterShading::load_textures(const ClusterColumns::Run& run, std::uint8_t textured) {
    const auto& v = reader_.graph().vertices;
    ClusterColumns& c = columns_;
    const auto read = [&](std::uint8_t parameter, const Column<Half>& from, auto... columns) {
        if (!(textured & parameter)) return;
        for (int l = run.begin; l < run.end; ++l) {
            const Half* at = from.data() + sizeof...(columns) * std::size_t(vertex(l));
            ((columns[l] = float_from_half(*at++)), ...);
        }
    };
    if (textured & textured_parameter::diffuse)
        for (int l = run.begin; l < run.end; ++l) {
            const Half* at = row(l).diffuse;
            c.diffuse_r[l] = float_from_half(at[0]), c.diffuse_g[l] = float_from_half(at[1]),
            c.diffuse_b[l] = float_from_half(at[2]);
        }
    read(textured_parameter::specular, v.specular, c.specular_r, c.specular_g, c.specular_b);
    read(textured_parameter::transmittance, v.transmittance, c.transmittance_r, c.transmittance_g, c.transmittance_b);
    read(textured_parameter::alpha, v.alpha, c.alpha_u, c.alpha_v);
    read(textured_parameter::opacity, v.opacity, c.opacity);
    if (!run.own) return;
    read(textured_parameter::index, v.eta_c, c.eta_r, c.eta_g, c.eta_b);
    read(textured_parameter::index, v.k_c, c.k_r, c.k_g, c.k_b);
    if (textured & textured_parameter::exponent)
        for (int l = run.begin; l < run.end; ++l) c.exponent[l] = v.exponent[vertex(l)];
}

/// Corrects f where a bump map shadows itself; the density needs no correction.
void ClusterShading::shadow_bumps() {
    for (std::size_t i = 0; i < perturbed_.size(); ++i) {
        const int l = perturbed_lane_[i];
        const ShadingPoint& at = perturbed_[i];
        const Vector3f local{columns_.wi_x[l], columns_.wi_y[l], columns_.wi_z[l]};
        const float factor = bump_shadowing(at, at.frame.to_world(local), local.z);
        columns_.f_r[l] *= factor;
        columns_.f_g[l] *= factor;
        columns_.f_b[l] *= factor;
        columns_.base[l] *= factor;
        columns_.coat[l] *= factor;
    }
}

void ClusterShading::light_direction(const Vector3f& wi) {
    kernels_.direction(columns_, wi.x, wi.y, wi.z);
    shadow_bumps();
}
void ClusterShading::light_lobes(const Vector3f& wi) {
    kernels_.lobes(columns_, wi.x, wi.y, wi.z);
    shadow_bumps();
}
void ClusterShading::light_point(const Point3f& y, const Normal3f& n) {
    kernels_.point(columns_, y.x, y.y, y.z, n.x, n.y, n.z);
    shadow_bumps();
}
void ClusterShading::light_delta_point(const Point3f& y) {
    kernels_.delta_point(columns_, y.x, y.y, y.z);
    shadow_bumps();
}

int ClusterShading::n_next_event() const {
    int n = 0;
    for (int l = 0; l < columns_.n; ++l) n += attempted_nee_[l] && sees(l);
    return n;
}

}  // namespace loom
