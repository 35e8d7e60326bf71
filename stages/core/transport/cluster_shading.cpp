#include "stages/core/transport/cluster_shading.h"

#include <algorithm>
#include <stdexcept>

namespace loom {

void ClusterShading::load(std::span<const std::uint32_t> vertices) {
    const PathGraph& g = reader_.graph();
    const auto& v = g.vertices;
    const int n = int(vertices.size());
    if (n > max_lanes) throw std::logic_error("ClusterShading: cluster too large");
    std::copy(vertices.begin(), vertices.end(), vertex_);
    // Few lanes and mostly one material: insertion keeps their order.
    for (int i = 1; i < n; ++i)
        for (int k = i; k > 0 && v.material[vertex_[k]] < v.material[vertex_[k - 1]]; --k) std::swap(vertex_[k], vertex_[k - 1]);

    ClusterColumns& c = columns_;
    c.n = n;
    c.runs.clear();
    perturbed_.clear();
    perturbed_lane_.clear();
    for (int l = 0; l < n; ++l) {
        const std::uint32_t j = vertex_[l];
        const ShadingPoint at = reader_.vertex(j);
        if (c.runs.empty() || c.runs.back().model != at.bsdf.model) c.runs.push_back({at.bsdf.model, l, l});
        c.runs.back().end = l + 1;
        c.px[l] = at.p.x, c.py[l] = at.p.y, c.pz[l] = at.p.z;
        c.sx[l] = at.frame.s.x, c.sy[l] = at.frame.s.y, c.sz[l] = at.frame.s.z;
        c.tx[l] = at.frame.t.x, c.ty[l] = at.frame.t.y, c.tz[l] = at.frame.t.z;
        c.nx[l] = at.frame.n.x, c.ny[l] = at.frame.n.y, c.nz[l] = at.frame.n.z;
        c.wo_x[l] = at.wo_local.x, c.wo_y[l] = at.wo_local.y, c.wo_z[l] = at.wo_local.z;
        const Bsdf<float>& b = at.bsdf;
        c.diffuse_r[l] = b.diffuse.r, c.diffuse_g[l] = b.diffuse.g, c.diffuse_b[l] = b.diffuse.b;
        c.specular_r[l] = b.specular.r, c.specular_g[l] = b.specular.g, c.specular_b[l] = b.specular.b;
        c.transmittance_r[l] = b.transmittance.r, c.transmittance_g[l] = b.transmittance.g;
        c.transmittance_b[l] = b.transmittance.b;
        c.alpha_u[l] = b.alpha_u, c.alpha_v[l] = b.alpha_v, c.opacity[l] = b.opacity;
        const std::uint16_t flags = v.flags[j];
        attempted_nee_[l] = (flags & vertex_flag::attempted_nee) != 0;
        c.survival[l] = (flags & vertex_flag::attempted_bsdf) ? (v.q.empty() ? 1.0f : v.q[j]) : 0.0f;
        if (at.perturbed) {
            perturbed_.push_back(at);
            perturbed_lane_.push_back(l);
        }
    }
    // The loops run over whole blocks.
    for (int l = n; l < padded(); ++l) {
        for (float* column : {c.px, c.py, c.pz, c.sx, c.sy, c.sz, c.tx, c.ty, c.tz, c.nx, c.ny, c.nz}) column[l] = 0;
        c.survival[l] = 0;
        attempted_nee_[l] = 0;
    }
}

/// f is not what the formula says where a bump map shades itself; the density is.
void ClusterShading::shadow_bumps() {
    for (std::size_t i = 0; i < perturbed_.size(); ++i) {
        const int l = perturbed_lane_[i];
        const ShadingPoint& at = perturbed_[i];
        const Vector3f local{columns_.wi_x[l], columns_.wi_y[l], columns_.wi_z[l]};
        const float factor = bump_shadowing(at, at.frame.to_world(local), local.z);
        columns_.f_r[l] *= factor;
        columns_.f_g[l] *= factor;
        columns_.f_b[l] *= factor;
    }
}

void ClusterShading::light_direction(const Vector3f& wi) {
    kernels_.direction(columns_, wi.x, wi.y, wi.z);
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
