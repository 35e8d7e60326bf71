#pragma once
// Unidirectional path tracing with next-event estimation.

#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "stages/core/math/box.h"
#include "stages/core/sampling/sampler.h"
#include "stages/core/scene/scene.h"
#include "stages/core/tracing/path_record.h"

namespace loom {

class RayEngine;
struct PathState;  // path_state.h

/// Survival probability of Russian roulette from `rr_depth` on.
enum class Roulette : std::uint8_t {
    albedo,      // largest channel of the vertex's albedo: local, so that densities can be re-evaluated elsewhere
    throughput,  // largest channel of throughput times albedo times eta^2: ends dark paths earlier
    off
};

/// How large the spot of a laser is taken for by laser sampling.
enum class LaserSpot : std::uint8_t {
    unit_area,  // one point of 1 m^2, as mitransient has it: the answer is per area of the spot
    true_area   // the section of the beam, so that the answer is that of next-event estimation
};

struct PathOptions {
    std::uint64_t seed = 0;
    SamplerKind sampler = SamplerKind::sobol;
    Roulette roulette = Roulette::albedo;
    int rr_depth = 5;                             // first vertex (camera ray: 1) at which roulette may end a path
    int max_depth = -1;                           // longest path in edges, -1: no limit
    LaserSpot laser_spot = LaserSpot::unit_area;  // of a capture around a corner
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
    bool touched = true;  // false: it was watched, and met nothing of what it was watched for
};

/// What paths are watched for: a path that meets none of it would be the same without it. Shadow rays count, whether
/// they reach their light or not.
struct Watch {
    // shapes that need not be in the scene: a segment that goes through one touches it
    const RayEngine* passed = nullptr;
    std::vector<Box3f> boxes;          // around them: a segment that meets none of the boxes is not asked for
    std::vector<std::uint8_t> shapes;  // by shape of the scene: a vertex on it touches it
    // by emitter of the scene: choosing it for next-event estimation, or hitting it
    std::vector<std::uint8_t> emitters;
    bool environment = false;  // escaping from the scene
};

/// One camera sample; pixel = y * width + x.
struct PathId {
    std::uint64_t pixel = 0, sample = 0;
};

/// Traces many paths side by side: rays sixteen at a time, random numbers by column. One batch belongs to one
/// thread; the results do not depend on what else is in a batch, apart from ties of two surfaces at one place.
///   L = Le(x1) + sum_j beta_j [ w_nee f cos Li / p_nee + w_bsdf f cos Li / (q p_bsdf) ],  power-heuristic
/// weights over the density of next-event estimation and that of BSDF sampling with roulette folded in.
class PathBatch {
  public:
    /// in: watch  null, or what paths are watched for; not of captures around a corner, all of whose paths count as
    ///     touched
    PathBatch(const Scene& scene, const PathOptions& options, const Watch* watch = nullptr);
    ~PathBatch();
    PathBatch(PathBatch&&) noexcept;

    /// in: ids, at most `capacity`; out: results, of the same length
    void trace(std::span<const PathId> ids, std::span<PathResult> results);
    /// The same paths, with all of their vertices and light edges.
    void trace(std::span<const PathId> ids, std::span<PathResult> results, PathRecords& records);

    /// Takes paths that are under way to their ends, from whatever depth each has come to; as tracing them whole would
    /// have.
    /// in:      under_way  which of the paths, at most `capacity`; the others are left as they are
    ///          paths      each with its ray, what led to it, and the light and vertices so far
    /// out:     paths      the result of each; n_rays counts on
    /// needs:   no watch, no capture around a corner
    void resume(std::span<PathState> paths, std::span<const std::uint32_t> under_way);

    static constexpr std::size_t capacity = 1024;

  private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

/// One path alone, ray by ray: the plain twin of PathBatch, and what a replay runs.
PathResult trace_path(const Scene& scene, const PathOptions& options, PathId id, PathRecords& records);

}  // namespace loom
