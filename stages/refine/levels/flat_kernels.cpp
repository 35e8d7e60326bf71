// Reflection of near lights at the vertices of a flat diffuse cluster, compiled once per x86-64 level (LOOM_LEVEL is
// v2, v3 or v4). Every entry is flattened: its calls are inlined, so no other code of a level links into the program.
#include <cstring>

#include "formats/io/octahedral.h"
#include "stages/refine/flat_columns.h"

namespace loom::refine::LOOM_LEVEL {
namespace {

using Lanes = float __attribute__((vector_size(lane_block * sizeof(float))));

using StoredLanes = float __attribute__((vector_size(lane_block * sizeof(float)), aligned(alignof(float)), may_alias));

[[gnu::always_inline]] inline const StoredLanes& lanes_at(const float* at) {
    return *reinterpret_cast<const StoredLanes*>(at);
}

/// Sums in a fixed order that every level can use.
[[gnu::always_inline]] inline float sum_of(const Lanes& v) {
    const auto a = __builtin_shufflevector(v, v, 0, 1, 2, 3, 4, 5, 6, 7) +
                   __builtin_shufflevector(v, v, 8, 9, 10, 11, 12, 13, 14, 15);
    const auto b = __builtin_shufflevector(a, a, 0, 1, 2, 3) + __builtin_shufflevector(a, a, 4, 5, 6, 7);
    return (b[0] + b[2]) + (b[1] + b[3]);
}

/// Prepares edges at the vertices that sampled them: facing normals, densities in the measure of the light, own terms.
template <bool area>
[[gnu::always_inline]] inline void see_from_finders(const FlatColumns& c, FlatLights& e) {
    const float nx = c.normal.x, ny = c.normal.y, nz = c.normal.z;
    for (int i = 0; i < padded_lanes(e.n); ++i) {
        const float dx = e.y_x[i] - e.from_x[i], dy = e.y_y[i] - e.from_y[i], dz = e.y_z[i] - e.from_z[i];
        const float d2 = dx * dx + dy * dy + dz * dz, d = std::sqrt(d2);
        e.pdf_shared[i] = e.pdf_nee[i];
        if constexpr (area) {
            const auto n = unit_from_octahedral(std::int16_t(e.normal[i] & 0xffffu), std::int16_t(e.normal[i] >> 16));
            const float along = n[0] * dx + n[1] * dy + n[2] * dz, turn = along > 0 ? -1.0f : 1.0f;
            e.n_x[i] = n[0] * turn, e.n_y[i] = n[1] * turn, e.n_z[i] = n[2] * turn;
            e.pdf_shared[i] = e.pdf_nee[i] * (-(along * turn) / (d2 * d));
        }
        const float below_or_cos = nx * dx + ny * dy + nz * dz, cos = below_or_cos > 0 ? below_or_cos / d : 0.0f;
        const float ratio = e.other_pdf[i] / e.pdf[i];
        const float mis_weight = e.pdf[i] > 0 ? 1 / (1 + ratio * ratio) : 0.0f;
        e.own[i] = cos * inv_pi<float> * (mis_weight / e.density[i]);
    }
}

template <bool area>
[[gnu::always_inline]] inline void gather_lights(FlatColumns& c, FlatLights& e) {
    see_from_finders<area>(c, e);
    const int lanes = padded_lanes(c.n);
    const float nx = c.normal.x, ny = c.normal.y, nz = c.normal.z;
    alignas(64) float attempts[max_lanes];
    for (int i = 0; i < e.n; ++i) {
        const float y_x = e.y_x[i], y_y = e.y_y[i], y_z = e.y_z[i], n_x = e.n_x[i], n_y = e.n_y[i], n_z = e.n_z[i],
                    pdf = e.pdf_shared[i];
        float* __restrict f = e.reflected + i * lanes;
        // A plain loop: g++ 12 scalarises `?:` on vectors that are wider than the processor's.
        for (int l = 0; l < lanes; ++l) {
            const float dx = y_x - c.px[l], dy = y_y - c.py[l], dz = y_z - c.pz[l];
            const float d2 = dx * dx + dy * dy + dz * dz, inv_d2 = 1 / (d2 > 1e-30f ? d2 : 1e-30f);
            const float above = nx * dx + ny * dy + nz * dz, cos = above > 0 ? above : 0.0f;
            float value;
            if constexpr (area) {
                const float before = -(n_x * dx + n_y * dy + n_z * dz), cos_y = before > 0 ? before : 0.0f;
                value = (cos * inv_d2) * (cos_y * inv_d2) * inv_pi<float>;
            } else {
                value = cos * std::sqrt(inv_d2) * inv_d2 * inv_pi<float>;
            }
            f[l] = value;
            attempts[l] = (value > 0 ? c.nee[l] * pdf : 0.0f) + (area ? c.survival[l] * value : 0.0f);
        }
        Lanes density{};
        for (int block = 0; block < lanes; block += lane_block) density += lanes_at(attempts + block);
        const float rho = sum_of(density), inv_rho = rho > 0 ? 1 / rho : 0.0f;
        e.Li_r[i] *= inv_rho, e.Li_g[i] *= inv_rho, e.Li_b[i] *= inv_rho;
    }
    for (int block = 0; block < lanes; block += lane_block) {
        Lanes r = lanes_at(c.white_r + block), g = lanes_at(c.white_g + block), b = lanes_at(c.white_b + block);
        for (int i = 0; i < e.n; ++i) {
            const Lanes f = lanes_at(e.reflected + i * lanes + block);
            r += f * e.Li_r[i], g += f * e.Li_g[i], b += f * e.Li_b[i];
        }
        std::memcpy(c.white_r + block, &r, sizeof r);
        std::memcpy(c.white_g + block, &g, sizeof g);
        std::memcpy(c.white_b + block, &b, sizeof b);
    }
}

}  // namespace

[[gnu::flatten]] void gather_area_lights(FlatColumns& c, FlatLights& e) {
    gather_lights<true>(c, e);
}
[[gnu::flatten]] void gather_point_lights(FlatColumns& c, FlatLights& e) {
    gather_lights<false>(c, e);
}

}  // namespace loom::refine::LOOM_LEVEL
