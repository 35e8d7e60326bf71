#include "stages/refine/flat_cluster.h"

#include <cstring>

namespace loom::refine {
namespace {

std::uint32_t packed(const Column<std::int16_t>& column, std::size_t j) {
    std::uint32_t uv;
    std::memcpy(&uv, column.data() + 2 * j, sizeof uv);
    return uv;
}

}  // namespace

const FlatKernels& flat_kernels() {
    static const FlatKernels chosen = __builtin_cpu_supports("x86-64-v4")   ? FlatKernels{v4::gather_area_lights, v4::gather_point_lights}
                                      : __builtin_cpu_supports("x86-64-v3") ? FlatKernels{v3::gather_area_lights, v3::gather_point_lights}
                                                                            : FlatKernels{v2::gather_area_lights, v2::gather_point_lights};
    return chosen;
}

FlatCluster::FlatCluster(const GraphReader& reader) : reader_(reader), kernels_(flat_kernels()) {
    const auto& m = reader.graph().materials;
    for (std::size_t i = 0; i < m.kind.size(); ++i)
        matte_.push_back(BsdfKind(m.kind[i]) == BsdfKind::diffuse && m.opacity[i] == 1 && !(m.textured[i] & textured_parameter::opacity));
}

bool FlatCluster::load(std::span<const std::uint32_t> vertices) {
    const PathGraph& g = reader_.graph();
    const auto& v = g.vertices;
    vertices_ = vertices;
    FlatColumns& c = columns_;
    c.n = int(vertices.size());
    const std::uint32_t code = packed(v.ns, vertices[0]);
    const auto n = unit_vector<Normal3f>(v.ns, vertices[0]);
    float side = 0;
    survival_sum_ = nee_sum_ = 0;
    for (int l = 0; l < c.n; ++l) {
        const std::size_t j = vertices[std::size_t(l)];
        const std::uint16_t material = v.material[j];
        if (!matte_[material] || packed(v.ns, j) != code || (!v.n_side.empty() && packed(v.n_side, j) != code)) return false;
        const BsdfModel& model = reader_.model(material);
        const float cos_o = dot(Vector3f{v.wo[3 * j], v.wo[3 * j + 1], v.wo[3 * j + 2]}, n);
        if (l == 0) side = cos_o > 0 ? 1.0f : -1.0f;
        if (!(cos_o * side > 0) || (side < 0 && !model.two_sided)) return false;
        albedo_[l] = model.diffuse;
        if (g.materials.textured[material] & textured_parameter::diffuse) {
            const Half* at = v.diffuse.data() + 3 * j;
            albedo_[l] = {float_from_half(at[0]), float_from_half(at[1]), float_from_half(at[2])};
        }
        c.px[l] = v.p[3 * j], c.py[l] = v.p[3 * j + 1], c.pz[l] = v.p[3 * j + 2];
        const std::uint16_t flags = v.flags[j];
        c.survival[l] = (flags & vertex_flag::attempted_bsdf) ? (v.q.empty() ? 1.0f : v.q[j]) : 0.0f;
        c.nee[l] = (flags & vertex_flag::attempted_nee) && albedo_[l].r + albedo_[l].g + albedo_[l].b > 0 ? 1.0f : 0.0f;
        survival_sum_ += c.survival[l];
        nee_sum_ += c.nee[l];
    }
    c.normal = side < 0 ? -n : n;
    for (int l = c.n; l < padded_lanes(c.n); ++l) {
        c.px[l] = c.px[0], c.py[l] = c.py[0], c.pz[l] = c.pz[0];
        c.survival[l] = c.nee[l] = 0;
    }
    return true;
}

/// Of an environment or a directional light: one cosine for all.
void FlatCluster::add_far_light(int lane, std::uint32_t edge, bool delta) {
    const PathGraph& g = reader_.graph();
    const auto& e = g.light_edges;
    const float cos = dot(Vector3f{e.y[4 * edge], e.y[4 * edge + 1], e.y[4 * edge + 2]}, columns_.normal);
    if (!(cos > 0)) return;
    const float f = cos * inv_pi<float>;
    const float rho = e.pdf_nee_w[edge] * nee_sum_ + (delta ? 0.0f : f * survival_sum_);
    if (rho > 0) far_ += rgb(e.Li, edge) * (f / rho);
    own_white_[lane] += own_light(g, Spectrum(f), vertices_[std::size_t(lane)], edge, Heuristic::power);
}

void FlatCluster::add_near_light(Batch& batch, int lane, std::uint32_t edge, decltype(FlatKernels::area) kernel) {
    const PathGraph& g = reader_.graph();
    const auto& in = g.light_edges;
    FlatLights& e = batch.edges;
    const int i = e.n++;
    batch.lane[i] = lane;
    batch.Li[i] = rgb(in.Li, edge);
    e.y_x[i] = in.y[4 * edge], e.y_y[i] = in.y[4 * edge + 1], e.y_z[i] = in.y[4 * edge + 2];
    e.from_x[i] = columns_.px[lane], e.from_y[i] = columns_.py[lane], e.from_z[i] = columns_.pz[lane];
    Spectrum light = batch.Li[i];
    if (&batch == &area_) e.normal[i] = packed(in.n, edge);
    else light *= sqr(e.y_x[i] - e.from_x[i]) + sqr(e.y_y[i] - e.from_y[i]) + sqr(e.y_z[i] - e.from_z[i]);  // intensity
    e.Li_r[i] = light.r, e.Li_g[i] = light.g, e.Li_b[i] = light.b;
    const bool next_event = LightTechnique(in.technique[edge]) == LightTechnique::next_event;
    const float nee = in.pdf_nee_w[edge], bsdf = in.pdf_bsdf_w[edge];
    e.pdf_nee[i] = nee;
    e.pdf[i] = next_event ? nee : bsdf;
    e.other_pdf[i] = next_event ? bsdf : nee;
    e.density[i] = next_event ? nee : g.vertices.pdf_w[vertices_[std::size_t(lane)]];
    if (e.n == FlatLights::capacity) flush(batch, kernel);
}

void FlatCluster::flush(Batch& batch, decltype(FlatKernels::area) kernel) {
    if (batch.edges.n == 0) return;
    kernel(columns_, batch.edges);
    for (int i = 0; i < batch.edges.n; ++i) own_white_[batch.lane[i]] += batch.Li[i] * batch.edges.own[i];
    batch.edges.n = 0;
}

void FlatCluster::gather_lights(std::span<const std::uint32_t> offsets) {
    const PathGraph& g = reader_.graph();
    FlatColumns& c = columns_;
    far_ = Spectrum(0);
    for (int l = 0; l < padded_lanes(c.n); ++l) c.white_r[l] = c.white_g[l] = c.white_b[l] = 0;
    for (int l = 0; l < c.n; ++l) {
        own_white_[l] = Spectrum(0);
        const std::size_t j = vertices_[std::size_t(l)];
        for (std::uint32_t i = offsets[j]; i < offsets[j + 1]; ++i) switch (EmitterKind(g.emitters.kind[g.light_edges.emitter[i]])) {
                case EmitterKind::area: add_near_light(area_, l, i, kernels_.area); break;
                case EmitterKind::point:
                case EmitterKind::spot: add_near_light(point_, l, i, kernels_.point); break;
                case EmitterKind::directional: add_far_light(l, i, true); break;
                case EmitterKind::constant:
                case EmitterKind::envmap: add_far_light(l, i, false); break;
            }
    }
    flush(area_, kernels_.area);
    flush(point_, kernels_.point);
}

Spectrum FlatCluster::direct(int l) const {
    return albedo_[l] * (far_ + Spectrum{columns_.white_r[l], columns_.white_g[l], columns_.white_b[l]});
}

}  // namespace loom::refine
