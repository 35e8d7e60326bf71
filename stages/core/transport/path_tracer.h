#pragma once
// Unidirectional path tracing with next-event estimation.

#include <cstdint>

#include "stages/core/sampling/sampler.h"
#include "stages/core/scene/scene.h"
#include "stages/core/transport/path_record.h"

namespace loom {

/// Survival probability of Russian roulette from `rr_depth` on.
enum class Roulette : std::uint8_t {
    albedo,      // largest channel of the vertex's albedo: local, so that densities can be re-evaluated elsewhere
    throughput,  // largest channel of throughput times albedo times eta^2: ends dark paths earlier
    off
};

struct PathOptions {
    std::uint64_t seed = 0;
    SamplerKind sampler = SamplerKind::sobol;
    Roulette roulette = Roulette::albedo;
    int rr_depth = 5;    // first vertex (camera ray: 1) at which roulette may end a path
    int max_depth = -1;  // longest path in edges, -1: no limit
};

/// Never survive with certainty, so that paths in a lossless enclosure end.
inline constexpr float max_survival = 0.95f;

/// What later stages look at in the first surface that a camera ray meets.
struct FirstHit {
    Spectrum albedo;  // 0 where the ray escapes
    Normal3f n;       // shading normal, (0, 0, 0) where the ray escapes
    float depth = 0;  // distance from the ray's origin, m; 0 where it escapes
};

struct PathResult {
    Spectrum L;
    FirstHit first;
    std::uint32_t n_vertices = 0;
    std::uint32_t n_rays = 0;
};

/// Radiance estimate of one camera sample.
///   L = Le(x1) + sum_j beta_j [ w_nee f cos Li / p_nee + w_bsdf f cos Li / (q p_bsdf) ],  power-heuristic
/// weights over the density of next-event estimation and that of BSDF sampling with roulette folded in.
/// in:  pixel   y * width + x
PathResult trace_path(const Scene& scene, const PathOptions& options, std::uint64_t pixel, std::uint64_t sample);

/// The same path, bit for bit, with all of its vertices and light edges written to `record`.
PathResult trace_path(const Scene& scene, const PathOptions& options, std::uint64_t pixel, std::uint64_t sample,
                      PathRecord& record);

}  // namespace loom
