// The column loops of a cluster, compiled once per x86-64 level (LOOM_LEVEL is v2, v3 or v4). Every entry is
// flattened: what it calls is inlined, so nothing else of a level leaks into the program.
#include "stages/core/transport/cluster_columns.h"

namespace loom::LOOM_LEVEL {
namespace {

/// Local directions from world directions that `world(l)` gives.
template <class World>
[[gnu::always_inline]] inline void to_local(ClusterColumns& c, World world) {
    const int lanes = padded_lanes(c.n);
    for (int l = 0; l < lanes; ++l) {
        const Vector3f w = world(l);
        c.wi_x[l] = w.x * c.sx[l] + w.y * c.sy[l] + w.z * c.sz[l];
        c.wi_y[l] = w.x * c.tx[l] + w.y * c.ty[l] + w.z * c.tz[l];
        c.wi_z[l] = w.x * c.nx[l] + w.y * c.ny[l] + w.z * c.nz[l];
    }
}

template <class Family>
[[gnu::always_inline]] inline void evaluate_run(ClusterColumns& c, const ClusterColumns::Run& run) {
    const BsdfModel& model = *run.model;
    for (int l = run.begin; l < run.end; ++l) {
        Bsdf<float> b(model);
        b.diffuse = {c.diffuse_r[l], c.diffuse_g[l], c.diffuse_b[l]};
        b.specular = {c.specular_r[l], c.specular_g[l], c.specular_b[l]};
        b.transmittance = {c.transmittance_r[l], c.transmittance_g[l], c.transmittance_b[l]};
        b.alpha_u = c.alpha_u[l];
        b.alpha_v = c.alpha_v[l];
        const Vector3f wo{c.wo_x[l], c.wo_y[l], c.wo_z[l]};
        const bool behind = seen_from_behind(b, wo);
        const BsdfValue<float> v = Family::f_cos_pdf(b, mirrored(behind, wo), mirrored(behind, Vector3f{c.wi_x[l], c.wi_y[l], c.wi_z[l]}));
        const float factor = c.opacity[l] * c.geometry[l];
        c.f_r[l] = v.f_cos.r * factor;
        c.f_g[l] = v.f_cos.g * factor;
        c.f_b[l] = v.f_cos.b * factor;
        c.pdf[l] = v.pdf_w * factor * c.survival[l];
    }
}

[[gnu::always_inline]] inline void evaluate_runs(ClusterColumns& c) {
    for (const ClusterColumns::Run& run : c.runs)
        with_family(
            run.model->kind, [&]<class Family>(Family) __attribute__((always_inline)) { evaluate_run<Family>(c, run); });
    const int lanes = padded_lanes(c.n);
    for (int l = c.n; l < lanes; ++l) c.f_r[l] = c.f_g[l] = c.f_b[l] = c.pdf[l] = 0;
    // In a fixed order that every level can follow.
    float partial[lane_block] = {};
    for (int block = 0; block < lanes; block += lane_block)
        for (int l = 0; l < lane_block; ++l) partial[l] += c.pdf[block + l];
    for (int half = lane_block / 2; half > 0; half /= 2)
        for (int l = 0; l < half; ++l) partial[l] += partial[l + half];
    c.pdf_sum = partial[0];
}

}  // namespace

[[gnu::flatten]] void evaluate_direction(ClusterColumns& c, float x, float y, float z) {
    to_local(c, [=](int) __attribute__((always_inline)) { return Vector3f{x, y, z}; });
    const int lanes = padded_lanes(c.n);
    for (int l = 0; l < lanes; ++l) c.geometry[l] = 1;
    evaluate_runs(c);
}

[[gnu::flatten]] void evaluate_point(ClusterColumns& c, float x, float y, float z, float nx, float ny, float nz) {
    to_local(c, [&](int l) __attribute__((always_inline)) {
        const Vector3f d{x - c.px[l], y - c.py[l], z - c.pz[l]};
        const float inv_d2 = 1 / std::max(length2(d), 1e-30f), inv_d = std::sqrt(inv_d2);
        c.geometry[l] = std::max(-(d.x * nx + d.y * ny + d.z * nz), 0.0f) * inv_d * inv_d2;
        return d * inv_d;
    });
    evaluate_runs(c);
}

[[gnu::flatten]] void evaluate_delta_point(ClusterColumns& c, float x, float y, float z) {
    to_local(c, [&](int l) __attribute__((always_inline)) {
        const Vector3f d{x - c.px[l], y - c.py[l], z - c.pz[l]};
        const float inv_d2 = 1 / std::max(length2(d), 1e-30f);
        c.geometry[l] = inv_d2;
        return d * std::sqrt(inv_d2);
    });
    evaluate_runs(c);
}

[[gnu::flatten]] void apply_block(const std::uint16_t* __restrict coefficient, const float* __restrict radiance, int n_edges,
                                  int lanes, float* __restrict out) {
    for (int block = 0; block < lanes; block += lane_block) {
        float sum[3][lane_block] = {};
        for (int e = 0; e < n_edges; ++e)
            for (int channel = 0; channel < 3; ++channel) {
                const std::uint16_t* row = coefficient + (3 * e + channel) * lanes + block;
                const float L = radiance[3 * e + channel];
                for (int l = 0; l < lane_block; ++l) sum[channel][l] += float(row[l]) * L;
            }
        for (int channel = 0; channel < 3; ++channel)
            for (int l = 0; l < lane_block; ++l) out[channel * lanes + block + l] = sum[channel][l];
    }
}

}  // namespace loom::LOOM_LEVEL
