#pragma once
// Unidirectional path tracing with next-event estimation.

#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "stages/core/sampling/streams.h"
#include "stages/core/scene/scene.h"
#include "stages/core/tracing/path_record.h"

namespace loom {

class PathObserver;
class PathGate;    // path_observer.h
struct PathState;  // path_state.h

/// Survival probability of Russian roulette from `rr_depth` on.
enum class Roulette : std::uint8_t {
    albedo,      // largest channel of the vertex's albedo: local, so that densities can be re-evaluated elsewhere
    throughput,  // largest channel of throughput times albedo times eta^2: ends dark paths earlier
    off
};

/// Area of the laser spot that laser sampling assumes.
enum class LaserSpot : std::uint8_t {
    unit_area,  // a point with an area of 1 m^2, as in mitransient: the result is per area of the spot
    true_area   // the section of the beam: the result is that of next-event estimation
};

struct PathOptions {
    std::uint64_t seed = 0;
    SamplerKind sampler = SamplerKind::sobol;
    Roulette roulette = Roulette::albedo;
    int rr_depth = 5;                             // first vertex (camera ray: 1) at which roulette may end a path
    int max_depth = -1;                           // longest path in edges, -1: no limit
    LaserSpot laser_spot = LaserSpot::unit_area;  // NLOS captures only
};

/// Upper bound of the survival probability, so that paths in a lossless enclosure end.
inline constexpr float max_survival = 0.95f;

/// Values of the first surface that a camera ray hits, for later stages.
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

/// One camera sample; pixel = y * width + x.
struct PathId {
    std::uint64_t pixel = 0, sample = 0;
};

/// A ray that starts a path, in place of one that the sensor samples.
struct GivenRay {
    Ray ray;            // its t_min and t_max hold
    PathId id;          // of its random numbers: rays of one id and depth have the same ones
    MediumStack media;  // that its origin is in
    // number of the edge that it makes, from which max_depth and roulette count on. 1: a camera ray, which does not hit
    // hidden emitters; above: a ray from a surface, which does
    int depth = 1;
    // what it hits, where that is known better than a ray can find it, as on the edge of a triangle; none: traced
    Hit hit{};
    std::uint64_t pixel = 0;  // of the film: in an NLOS capture, whose laser point lights the path
};

/// Traces many paths at once: rays sixteen at a time, random numbers as a structure of arrays. One batch belongs to one
/// thread. A result does not depend on the other paths of the batch, except for ties of two surfaces at one point.
///   L = Le(x1) + sum_j beta_j [ w_nee f cos Li / p_nee + w_bsdf f cos Li / (q p_bsdf) ],  power-heuristic
/// weights over the density of next-event estimation and that of BSDF sampling including roulette.
class PathBatch {
  public:
    /// in:      observer  null, or observes all paths of trace(); borrowed. Not for NLOS captures.
    PathBatch(const Scene& scene, const PathOptions& options, PathObserver* observer = nullptr);
    ~PathBatch();
    PathBatch(PathBatch&&) noexcept;

    /// in:      ids, at most `capacity`
    /// out:     results, of the same length
    void trace(std::span<const PathId> ids, std::span<PathResult> results);
    /// Traces the same paths and records all of their vertices and light edges.
    void trace(std::span<const PathId> ids, std::span<PathResult> results, PathRecords& records);

    /// Traces and records paths that start with given rays. The throughput of a ray is 1, also for Roulette::throughput.
    /// Light that the ray itself hits is Le of its path, at full weight: no technique competes.
    /// in:      rays  at most `capacity`, in any order of depths
    /// out:     results  of the same length; vertices before a ray do not count
    /// needs:   no observer
    void trace(std::span<const GivenRay> rays, std::span<PathResult> results, PathRecords& records);

    /// Traces started paths to their ends, each from its own depth; the result equals that of tracing them whole.
    /// in:      under_way  indices of the paths to trace, at most `capacity`; all others are unchanged
    ///          paths      each with its ray, the state that led to it, and its radiance and vertices so far
    ///          gate       null, or stops paths on their way; they can be resumed again, with their last ray traced anew
    /// out:     paths      the result of each; n_rays is incremented
    /// needs:   no observer, no NLOS capture
    void resume(std::span<PathState> paths, std::span<const std::uint32_t> under_way, PathGate* gate = nullptr);

    static constexpr std::size_t capacity = 1024;

  private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

/// Traces one path ray by ray; used for replay. Its results equal those of PathBatch.
PathResult trace_path(const Scene& scene, const PathOptions& options, PathId id, PathRecords& records);

}  // namespace loom
