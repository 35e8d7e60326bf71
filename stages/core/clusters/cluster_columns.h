#pragma once
// The vertices of one cluster as columns of lanes (SoA), and the loops that evaluate all their BSDFs for one direction
// or one point. The loops are compiled once per x86-64 level.

#include <cstdint>
#include <vector>

#include "stages/core/scattering/bsdf.h"

namespace loom {

/// Size of the largest cluster that fits. Columns are padded to whole blocks of lanes.
inline constexpr int max_lanes = 256, lane_block = 16;
constexpr int padded_lanes(int n) {
    return (n + lane_block - 1) / lane_block * lane_block;
}

/// A column is one block longer than needed, so that equal lanes of different columns do not share a cache set.
using LaneColumn = float[max_lanes + lane_block];

struct ClusterColumns {
    // A run of lanes has one material. The loops process whole blocks of lanes: their results beyond the end are
    // overwritten by the next run or cleared.
    struct Run {
        const BsdfModel* model;
        int begin, end;
        bool own = false;  // lanes have their own exponents, indices or rough coats; else all have the model's
        int past_end() const { return begin + padded_lanes(end - begin); }
    };

    int n = 0;
    std::vector<Run> runs;
    // At the vertices. Directions are in world space, except wo after prepare_lanes().
    alignas(64) LaneColumn px, py, pz;
    LaneColumn sx, sy, sz, tx, ty, tz, nx, ny, nz;  // shading frame
    LaneColumn wo_x, wo_y, wo_z;
    // As on disk: two octahedral int16, u low.
    std::uint32_t ns[max_lanes + lane_block], tangent[max_lanes + lane_block];
    bool has_tangent = false;
    LaneColumn diffuse_r, diffuse_g, diffuse_b, specular_r, specular_g, specular_b;
    LaneColumn transmittance_r, transmittance_g, transmittance_b, alpha_u, alpha_v, eta, opacity;
    LaneColumn exponent, eta_r, eta_g, eta_b, k_r, k_g, k_b;  // in runs that are `own`
    LaneColumn survival;  // probability that the ray of a BSDF sample is traced; 0 where none was attempted
    // Query: direction of light (local) and the factor between measures.
    LaneColumn wi_x, wi_y, wi_z, geometry;
    // Result: f cos and density of BSDF sampling (survival included), both times the factor, and the sum of the
    // densities.
    LaneColumn f_r, f_g, f_b, pdf;
    float pdf_sum = 0;
    // Result for materials whose coat is grey: f cos = tint base + coat.
    LaneColumn tint_r, tint_g, tint_b, p_coat, base, coat;
};

// Every function computes all lanes; lanes from n up to the next whole block get 0.
#define LOOM_CLUSTER_KERNELS                                                                                        \
    /* Computes shading frames from ns and tangent, converts wo from world to local, and sets each run's */         \
    /* parameters of its material. */                                                                               \
    void prepare_lanes(ClusterColumns& c);                                                                          \
    /* Evaluates light from direction (x, y, z), world space: values in sr^-1. */                                   \
    void evaluate_direction(ClusterColumns& c, float x, float y, float z);                                          \
    /* Where every coat is grey: tints and p_coat once, then base, coat and density for a direction as above. */    \
    void prepare_tints(ClusterColumns& c);                                                                          \
    void evaluate_lobes(ClusterColumns& c, float x, float y, float z);                                              \
    /* Evaluates light from the point (x, y, z) on the front of a surface with normal (nx, ny, nz). Values per */   \
    /* m^2 of that surface: f cos G and pdf G with G = cos_y / d^2. */                                              \
    void evaluate_point(ClusterColumns& c, float x, float y, float z, float nx, float ny, float nz);                \
    /* Evaluates light from the point (x, y, z) without a surface: f cos / d^2; the densities are meaningless. */   \
    void evaluate_delta_point(ClusterColumns& c, float x, float y, float z);                                        \
    /* Stores f in 16 bits of its largest value: row[rgb][lane]; largest[rgb], and sum[rgb] of f times a weight. */ \
    void fix_row(const ClusterColumns& c, const float* weight, std::uint16_t* row, float* largest, float* sum);     \
    /* Stores the requested ones of base and coat consecutively: row[lobe][lane], largest[lobe]; and */             \
    /* sum[rgb] over the lanes of f times a weight. */                                                              \
    void fix_lobes(const ClusterColumns& c, bool base, bool coat, const float* weight, std::uint16_t* row,          \
                   float* largest, float* sum);                                                                     \
    /* Computes sum_e L_e c_e of one cluster: coefficient[e][rgb][lane] 16-bit fixed point, whose scale is in */    \
    /* radiance[e][rgb]; out[rgb][lane]. */                                                                         \
    void apply_block(const std::uint16_t* coefficient, const float* radiance, int n_edges, int lanes, float* out);  \
    /* Computes apply_block() of coefficients without colour, [e][lane], rows of edges `stride` apart. */           \
    void apply_plane(const std::uint16_t* coefficient, int stride, const float* radiance, int n_edges, int lanes,   \
                     float* out);

namespace v2 {
LOOM_CLUSTER_KERNELS
}
namespace v3 {
LOOM_CLUSTER_KERNELS
}
namespace v4 {
LOOM_CLUSTER_KERNELS
}

/// Kernels of the highest x86-64 level of this processor.
struct ClusterKernels {
    decltype(&v2::prepare_lanes) prepare;
    decltype(&v2::evaluate_direction) direction;
    decltype(&v2::prepare_tints) prepare_tints;
    decltype(&v2::evaluate_lobes) lobes;
    decltype(&v2::evaluate_point) point;
    decltype(&v2::evaluate_delta_point) delta_point;
    decltype(&v2::fix_row) fix_row;
    decltype(&v2::fix_lobes) fix_lobes;
    decltype(&v2::apply_block) apply_block;
    decltype(&v2::apply_plane) apply_plane;
};
const ClusterKernels& cluster_kernels();

}  // namespace loom
