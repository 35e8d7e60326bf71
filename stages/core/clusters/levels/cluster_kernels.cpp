// Column loops of a cluster, compiled once per x86-64 level (LOOM_LEVEL is v2, v3 or v4). Every entry is flattened: its
// calls are inlined, so no other code of a level links into the program.
#include <cstring>
#include <limits>
#include <type_traits>

#include "formats/io/octahedral.h"
#include "stages/core/clusters/cluster_columns.h"
#include "stages/core/math/frame.h"

namespace loom::LOOM_LEVEL {
namespace {

/// Computes local directions from the world directions world(l).
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

/// Sums in a fixed order that every level can use.
[[gnu::always_inline]] inline float sum_of(const float* column, int lanes) {
    float partial[lane_block] = {};
    for (int block = 0; block < lanes; block += lane_block)
        for (int l = 0; l < lane_block; ++l) partial[l] += column[block + l];
    for (int half = lane_block / 2; half > 0; half /= 2)
        for (int l = 0; l < half; ++l) partial[l] += partial[l + half];
    return partial[0];
}
[[gnu::always_inline]] inline float largest_of(const float* column, int lanes) {
    float partial[lane_block] = {};
    for (int block = 0; block < lanes; block += lane_block)
        for (int l = 0; l < lane_block; ++l)
            partial[l] = column[block + l] > partial[l] ? column[block + l] : partial[l];
    for (int half = lane_block / 2; half > 0; half /= 2)
        for (int l = 0; l < half; ++l) partial[l] = partial[l + half] > partial[l] ? partial[l + half] : partial[l];
    return partial[0];
}

[[gnu::always_inline]] inline Vector3f decoded(std::uint32_t uv) {
    const auto unit = unit_from_octahedral(std::int16_t(uv & 0xffffu), std::int16_t(uv >> 16));
    return {unit[0], unit[1], unit[2]};
}

[[gnu::always_inline]] inline void set_frame(ClusterColumns& c, int l, const Framef& frame) {
    c.sx[l] = frame.s.x, c.sy[l] = frame.s.y, c.sz[l] = frame.s.z;
    c.tx[l] = frame.t.x, c.ty[l] = frame.t.y, c.tz[l] = frame.t.z;
    c.nx[l] = frame.n.x, c.ny[l] = frame.n.y, c.nz[l] = frame.n.z;
    const Vector3f wo = frame.to_local({c.wo_x[l], c.wo_y[l], c.wo_z[l]});
    c.wo_x[l] = wo.x, c.wo_y[l] = wo.y, c.wo_z[l] = wo.z;
}

/// Choices of a model that must be made outside of the loop, where they would keep it scalar.
template <class Family>
constexpr bool has_facets = std::is_same_v<Family, RoughConductorFamily> ||
                            std::is_same_v<Family, RoughDielectricFamily> || std::is_same_v<Family, RoughPlasticFamily>;
template <class Family>
constexpr bool has_base = std::is_same_v<Family, PlasticFamily> || std::is_same_v<Family, RoughPlasticFamily>;

template <class Family>
constexpr bool has_own = std::is_same_v<Family, PhongFamily> || std::is_same_v<Family, RoughConductorFamily> ||
                         std::is_same_v<Family, RoughPlasticFamily>;

/// Returns the parameters in a lane; in a run without `own` parameters the exponent and index are the model's.
template <bool own>
[[gnu::always_inline]] inline Bsdf<float> bsdf_of(const ClusterColumns& c, const BsdfModel& model, int l) {
    Bsdf<float> b;
    b.model = &model;
    if (own) {
        b.exponent = c.exponent[l];
        b.eta_c = {c.eta_r[l], c.eta_g[l], c.eta_b[l]};
        b.k_c = {c.k_r[l], c.k_g[l], c.k_b[l]};
    } else {
        b.exponent = model.exponent;
        b.eta_c = model.eta_c;
        b.k_c = model.k_c;
    }
    b.diffuse = {c.diffuse_r[l], c.diffuse_g[l], c.diffuse_b[l]};
    b.specular = {c.specular_r[l], c.specular_g[l], c.specular_b[l]};
    b.transmittance = {c.transmittance_r[l], c.transmittance_g[l], c.transmittance_b[l]};
    b.alpha_u = c.alpha_u[l];
    b.alpha_v = c.alpha_v[l];
    b.eta = c.eta[l];
    return b;
}
/// seen_from_behind() is wo.z < this. One comparison of floats vectorises; combined with a bool the loop would stay
/// scalar.
[[gnu::always_inline]] inline float behind_below(const BsdfModel& model) {
    return model.two_sided ? 0.0f : -std::numeric_limits<float>::infinity();
}

enum class Answer { channels, lobes };

template <class Family, Answer answer, bool beckmann, bool sample_visible, bool nonlinear, bool own>
[[gnu::noinline, gnu::flatten]] void evaluate_run(ClusterColumns& c, const ClusterColumns::Run& run) {
    // A copy whose choices are constants here, and which no store to a column can alias.
    BsdfModel model = *run.model;
    if (has_facets<Family>) {
        model.distribution = beckmann ? Microfacet::beckmann : Microfacet::ggx;
        model.sample_visible = sample_visible;
    }
    if (has_base<Family>) model.nonlinear = nonlinear;
    if (!own) model.coats = nullptr;
    const float below = behind_below(model);
    for (int l = run.begin; l < run.past_end(); ++l) {
        const Bsdf<float> b = bsdf_of<own>(c, model, l);
        const bool behind = c.wo_z[l] < below;
        const Vector3f wo = mirrored(behind, Vector3f{c.wo_x[l], c.wo_y[l], c.wo_z[l]});
        const Vector3f wi = mirrored(behind, Vector3f{c.wi_x[l], c.wi_y[l], c.wi_z[l]});
        const float factor = c.opacity[l] * c.geometry[l];
        float pdf_w;
        if constexpr (answer == Answer::lobes && Family::coloured_base) {
            const LobeValues<float> v = Family::lobes(b, wo, wi, c.p_coat[l]);
            c.base[l] = v.base * factor;
            c.coat[l] = v.coat * (b.specular.r * factor);
            pdf_w = v.pdf_w;
        } else {
            const BsdfValue<float> v = Family::f_cos_pdf(b, wo, wi);
            if constexpr (answer == Answer::lobes) {
                c.base[l] = 0;
                c.coat[l] = v.f_cos.r * factor;
            } else {
                c.f_r[l] = v.f_cos.r * factor;
                c.f_g[l] = v.f_cos.g * factor;
                c.f_b[l] = v.f_cos.b * factor;
            }
            pdf_w = v.pdf_w;
        }
        c.pdf[l] = pdf_w * factor * c.survival[l];
    }
}

template <class Family, Answer answer>
[[gnu::always_inline]] inline void evaluate_run(ClusterColumns& c, const ClusterColumns::Run& run) {
    const BsdfModel& m = *run.model;
    const auto with_own = [&]<bool beckmann, bool visible, bool nonlinear>() __attribute__((always_inline)) {
        if (has_own<Family> && run.own)
            evaluate_run<Family, answer, beckmann, visible, nonlinear, has_own<Family>>(c, run);
        else
            evaluate_run<Family, answer, beckmann, visible, nonlinear, false>(c, run);
    };
    const auto with_base = [&]<bool beckmann, bool visible>() __attribute__((always_inline)) {
        if (has_base<Family> && m.nonlinear)
            with_own.template operator()<beckmann, visible, has_base<Family>>();
        else
            with_own.template operator()<beckmann, visible, false>();
    };
    if constexpr (!has_facets<Family>)
        with_base.template operator()<false, false>();
    else if (m.distribution == Microfacet::beckmann)
        m.sample_visible ? with_base.template operator()<true, true>() : with_base.template operator()<true, false>();
    else
        m.sample_visible ? with_base.template operator()<false, true>() : with_base.template operator()<false, false>();
}

template <Answer answer, class... Columns>
[[gnu::always_inline]] inline void evaluate_runs(ClusterColumns& c, Columns&... columns) {
    for (const ClusterColumns::Run& run : c.runs)
        with_family(
            run.model->kind, [&]<class Family>(Family) __attribute__((always_inline)) {
                // Only delta lobes: zero.
                if constexpr (Family::smooth) {
                    evaluate_run<Family, answer>(c, run);
                } else {
                    for (int l = run.begin; l < run.past_end(); ++l) ((columns[l] = 0), ...);
                }
            });
    const int lanes = padded_lanes(c.n);
    for (int l = c.n; l < lanes; ++l) ((columns[l] = 0), ...);
    c.pdf_sum = sum_of(c.pdf, lanes);
}
[[gnu::always_inline]] inline void evaluate_runs(ClusterColumns& c) {
    evaluate_runs<Answer::channels>(c, c.f_r, c.f_g, c.f_b, c.pdf);
}

}  // namespace

[[gnu::flatten]] void prepare_lanes(ClusterColumns& c) {
    const int lanes = padded_lanes(c.n);
    if (c.has_tangent)
        for (int l = 0; l < lanes; ++l) set_frame(c, l, frame_along(Normal3f(decoded(c.ns[l])), decoded(c.tangent[l])));
    else
        for (int l = 0; l < lanes; ++l) set_frame(c, l, Framef(Normal3f(decoded(c.ns[l]))));
    for (const ClusterColumns::Run& run : c.runs) {
        const BsdfModel& b = *run.model;
        for (int l = run.begin; l < run.past_end(); ++l) {
            c.diffuse_r[l] = b.diffuse.r, c.diffuse_g[l] = b.diffuse.g, c.diffuse_b[l] = b.diffuse.b;
            c.specular_r[l] = b.specular.r, c.specular_g[l] = b.specular.g, c.specular_b[l] = b.specular.b;
            c.transmittance_r[l] = b.transmittance.r, c.transmittance_g[l] = b.transmittance.g;
            c.transmittance_b[l] = b.transmittance.b;
            c.alpha_u[l] = b.alpha_u, c.alpha_v[l] = b.alpha_v, c.eta[l] = b.eta(), c.opacity[l] = b.opacity;
        }
        for (int l = run.begin; run.own && l < run.past_end(); ++l) {
            c.exponent[l] = b.exponent;
            c.eta_r[l] = b.eta_c.r, c.eta_g[l] = b.eta_c.g, c.eta_b[l] = b.eta_c.b;
            c.k_r[l] = b.k_c.r, c.k_g[l] = b.k_c.g, c.k_b[l] = b.k_c.b;
        }
    }
}

[[gnu::flatten]] void evaluate_direction(ClusterColumns& c, float x, float y, float z) {
    to_local(
        c, [=](int) __attribute__((always_inline)) {
            return Vector3f{x, y, z};
        });
    const int lanes = padded_lanes(c.n);
    for (int l = 0; l < lanes; ++l) c.geometry[l] = 1;
    evaluate_runs(c);
}

[[gnu::flatten]] void prepare_tints(ClusterColumns& c) {
    for (const ClusterColumns::Run& run : c.runs) {
        const BsdfModel model = *run.model;
        const float below = behind_below(model);
        with_family(
            model.kind, [&]<class Family>(Family) __attribute__((always_inline)) {
                for (int l = run.begin; l < run.past_end(); ++l) {
                    Spectrum tint(0);
                    if constexpr (Family::coloured_base) {
                        const Bsdf<float> b = run.own ? bsdf_of<true>(c, model, l) : bsdf_of<false>(c, model, l);
                        const Vector3f wo = mirrored(c.wo_z[l] < below, Vector3f{c.wo_x[l], c.wo_y[l], c.wo_z[l]});
                        tint = Family::tint(b, wo);
                        c.p_coat[l] = Family::p_coat(b, wo);
                    }
                    c.tint_r[l] = tint.r, c.tint_g[l] = tint.g, c.tint_b[l] = tint.b;
                }
            });
    }
    for (int l = c.n; l < padded_lanes(c.n); ++l) c.tint_r[l] = c.tint_g[l] = c.tint_b[l] = 0;
}

[[gnu::flatten]] void evaluate_lobes(ClusterColumns& c, float x, float y, float z) {
    to_local(
        c, [=](int) __attribute__((always_inline)) {
            return Vector3f{x, y, z};
        });
    const int lanes = padded_lanes(c.n);
    for (int l = 0; l < lanes; ++l) c.geometry[l] = 1;
    evaluate_runs<Answer::lobes>(c, c.base, c.coat, c.pdf);
}

[[gnu::flatten]] void evaluate_point(ClusterColumns& c, float x, float y, float z, float nx, float ny, float nz) {
    to_local(
        c, [&](int l) __attribute__((always_inline)) {
            const Vector3f d{x - c.px[l], y - c.py[l], z - c.pz[l]};
            const float inv_d2 = 1 / std::max(length2(d), 1e-30f), inv_d = std::sqrt(inv_d2);
            c.geometry[l] = std::max(-(d.x * nx + d.y * ny + d.z * nz), 0.0f) * inv_d * inv_d2;
            return d * inv_d;
        });
    evaluate_runs(c);
}

[[gnu::flatten]] void evaluate_delta_point(ClusterColumns& c, float x, float y, float z) {
    to_local(
        c, [&](int l) __attribute__((always_inline)) {
            const Vector3f d{x - c.px[l], y - c.py[l], z - c.pz[l]};
            const float inv_d2 = 1 / std::max(length2(d), 1e-30f);
            c.geometry[l] = inv_d2;
            return d * std::sqrt(inv_d2);
        });
    evaluate_runs(c);
}

namespace {
/// Converts to 16-bit fractions of `largest`.
[[gnu::always_inline]] inline void fix(const float* __restrict f, int lanes, float largest,
                                       std::uint16_t* __restrict row) {
    const float to_fixed = largest > 0 ? 65535.0f / largest : 0.0f;
    for (int l = 0; l < lanes; ++l) row[l] = std::uint16_t(std::int32_t(f[l] * to_fixed + 0.5f));
}
}  // namespace

[[gnu::flatten]] void fix_row(const ClusterColumns& c, const float* __restrict weight, std::uint16_t* __restrict row,
                              float* __restrict largest, float* __restrict sum) {
    const int lanes = padded_lanes(c.n);
    const float* const columns[3] = {c.f_r, c.f_g, c.f_b};
    alignas(64) float weighted[max_lanes];
    for (int channel = 0; channel < 3; ++channel) {
        const float* f = columns[channel];
        for (int l = 0; l < lanes; ++l) weighted[l] = f[l] * weight[l];
        sum[channel] = sum_of(weighted, lanes);
        largest[channel] = largest_of(f, lanes);
        fix(f, lanes, largest[channel], row + channel * lanes);
    }
}

[[gnu::flatten]] void fix_lobes(const ClusterColumns& c, bool base, bool coat, const float* __restrict weight,
                                std::uint16_t* __restrict row, float* __restrict largest, float* __restrict sum) {
    const int lanes = padded_lanes(c.n);
    const float* const tints[3] = {c.tint_r, c.tint_g, c.tint_b};
    alignas(64) float weighted[max_lanes];
    for (int channel = 0; channel < 3; ++channel) {
        for (int l = 0; l < lanes; ++l) weighted[l] = (tints[channel][l] * c.base[l] + c.coat[l]) * weight[l];
        sum[channel] = sum_of(weighted, lanes);
    }
    largest[0] = largest[1] = 0;
    if (base) {
        largest[0] = largest_of(c.base, lanes);
        fix(c.base, lanes, largest[0], row);
        row += lanes;
    }
    if (coat) {
        largest[1] = largest_of(c.coat, lanes);
        fix(c.coat, lanes, largest[1], row);
    }
}

// Compiler vectors instead of a plain loop, in which g++ 12 converts unsigned 16-bit numbers one by one.
using FloatLanes = float __attribute__((vector_size(lane_block * sizeof(float))));
using IntLanes = std::int32_t __attribute__((vector_size(lane_block * sizeof(std::int32_t))));
using FixedLanes = std::uint16_t __attribute__((vector_size(lane_block * sizeof(std::uint16_t))));

[[gnu::flatten]] void apply_block(const std::uint16_t* __restrict coefficient, const float* __restrict radiance,
                                  int n_edges, int lanes, float* __restrict out) {
    for (int block = 0; block < lanes; block += lane_block) {
        FloatLanes sum[3] = {};
        const std::uint16_t* row = coefficient + block;
        for (int e = 0; e < n_edges; ++e)
            for (int channel = 0; channel < 3; ++channel, row += lanes) {
                FixedLanes fixed;
                std::memcpy(&fixed, row, sizeof fixed);
                sum[channel] += __builtin_convertvector(__builtin_convertvector(fixed, IntLanes), FloatLanes) *
                                radiance[3 * e + channel];
            }
        for (int channel = 0; channel < 3; ++channel)
            std::memcpy(out + channel * lanes + block, &sum[channel], sizeof sum[channel]);
    }
}

[[gnu::flatten]] void apply_plane(const std::uint16_t* __restrict coefficient, int stride,
                                  const float* __restrict radiance, int n_edges, int lanes, float* __restrict out) {
    for (int block = 0; block < lanes; block += lane_block) {
        FloatLanes sum[3] = {};
        const std::uint16_t* row = coefficient + block;
        for (int e = 0; e < n_edges; ++e, row += stride) {
            FixedLanes fixed;
            std::memcpy(&fixed, row, sizeof fixed);
            const FloatLanes value = __builtin_convertvector(__builtin_convertvector(fixed, IntLanes), FloatLanes);
            for (int channel = 0; channel < 3; ++channel) sum[channel] += value * radiance[3 * e + channel];
        }
        for (int channel = 0; channel < 3; ++channel)
            std::memcpy(out + channel * lanes + block, &sum[channel], sizeof sum[channel]);
    }
}

}  // namespace loom::LOOM_LEVEL
