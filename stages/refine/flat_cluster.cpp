#include "stages/refine/flat_cluster.h"

namespace loom::refine {
const FlatKernels& flat_kernels() {
    static const FlatKernels chosen =
        __builtin_cpu_supports("x86-64-v4")   ? FlatKernels{v4::gather_area_lights, v4::gather_point_lights}
        : __builtin_cpu_supports("x86-64-v3") ? FlatKernels{v3::gather_area_lights, v3::gather_point_lights}
                                              : FlatKernels{v2::gather_area_lights, v2::gather_point_lights};
    return chosen;
}

bool FlatCluster::load(std::span<const VertexRow> rows) {
    rows_ = rows;
    FlatColumns& c = columns_;
    c.n = int(rows.size());
    const std::uint32_t code = rows[0].ns;
    for (const VertexRow& row : rows)
        if (!(row.bits & vertex_bit::diffuse) || row.ns != code) return false;
    const auto unit = unit_from_octahedral(std::int16_t(code & 0xffffu), std::int16_t(code >> 16));
    const Normal3f n{unit[0], unit[1], unit[2]};
    const float side = dot(rows[0].wo, n) > 0 ? 1.0f : -1.0f;
    survival_sum_ = nee_sum_ = 0;
    for (int l = 0; l < c.n; ++l) {
        const VertexRow& row = rows[std::size_t(l)];
        const BsdfModel& model = reader_.model(row.material);
        if (!(dot(row.wo, n) * side > 0) || (side < 0 && !model.two_sided)) return false;
        const bool textured = reader_.graph().materials.textured[row.material] & textured_parameter::diffuse;
        albedo_[l] = textured ? Spectrum{float_from_half(row.diffuse[0]), float_from_half(row.diffuse[1]),
                                         float_from_half(row.diffuse[2])}
                              : model.diffuse;
        c.px[l] = row.p.x, c.py[l] = row.p.y, c.pz[l] = row.p.z;
        c.survival[l] = (row.bits & vertex_flag::attempted_bsdf) ? row.q : 0.0f;
        c.nee[l] =
            (row.bits & vertex_flag::attempted_nee) && albedo_[l].r + albedo_[l].g + albedo_[l].b > 0 ? 1.0f : 0.0f;
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

/// Adds light of an environment or a directional emitter: one cosine for all vertices.
void FlatCluster::add_far_light(int lane, const LightRow& light, bool delta) {
    const float cos = dot(Vector3f(light.y), columns_.normal);
    if (!(cos > 0)) return;
    const float f = cos * inv_pi<float>;
    const float rho = light.pdf_nee * nee_sum_ + (delta ? 0.0f : f * survival_sum_);
    if (rho > 0) far_ += light.Li * (f / rho);
    own_white_[lane] += own_light(light, Spectrum(f), row(lane).pdf_w);
}

void FlatCluster::add_near_light(Batch& batch, int lane, const LightRow& light, decltype(FlatKernels::area) kernel) {
    FlatLights& e = batch.edges;
    const int i = e.n++;
    batch.lane[i] = lane;
    batch.Li[i] = light.Li;
    e.y_x[i] = light.y.x, e.y_y[i] = light.y.y, e.y_z[i] = light.y.z;
    e.from_x[i] = columns_.px[lane], e.from_y[i] = columns_.py[lane], e.from_z[i] = columns_.pz[lane];
    e.normal[i] = light.n;
    Spectrum Li = light.Li;
    if (light.kind != EmitterKind::area) Li *= length2(light.y - row(lane).p);  // intensity
    e.Li_r[i] = Li.r, e.Li_g[i] = Li.g, e.Li_b[i] = Li.b;
    const bool next_event = light.technique == LightTechnique::next_event;
    e.pdf_nee[i] = light.pdf_nee;
    e.pdf[i] = next_event ? light.pdf_nee : light.pdf_bsdf;
    e.other_pdf[i] = next_event ? light.pdf_bsdf : light.pdf_nee;
    e.density[i] = next_event ? light.pdf_nee : row(lane).pdf_w;
    if (e.n == FlatLights::capacity) flush(batch, kernel);
}

void FlatCluster::flush(Batch& batch, decltype(FlatKernels::area) kernel) {
    if (batch.edges.n == 0) return;
    kernel(columns_, batch.edges);
    for (int i = 0; i < batch.edges.n; ++i) own_white_[batch.lane[i]] += batch.Li[i] * batch.edges.own[i];
    batch.edges.n = 0;
}

void FlatCluster::gather_lights(const ClusterRows& rows, std::size_t place) {
    FlatColumns& c = columns_;
    far_ = Spectrum(0);
    for (int l = 0; l < padded_lanes(c.n); ++l) c.white_r[l] = c.white_g[l] = c.white_b[l] = 0;
    for (int l = 0; l < c.n; ++l) {
        own_white_[l] = Spectrum(0);
        for (const LightRow& light : rows.lights_of(place + std::size_t(l))) switch (light.kind) {
                case EmitterKind::area:
                    add_near_light(area_, l, light, kernels_.area);
                    break;
                case EmitterKind::point:
                case EmitterKind::spot:
                case EmitterKind::projector:
                case EmitterKind::laser_spot:
                    add_near_light(point_, l, light, kernels_.point);
                    break;
                case EmitterKind::directional:
                    add_far_light(l, light, true);
                    break;
                case EmitterKind::constant:
                case EmitterKind::envmap:
                    add_far_light(l, light, false);
                    break;
            }
    }
    flush(area_, kernels_.area);
    flush(point_, kernels_.point);
}

Spectrum FlatCluster::direct(int l) const {
    return albedo_[l] * (far_ + Spectrum{columns_.white_r[l], columns_.white_g[l], columns_.white_b[l]});
}

}  // namespace loom::refine
