#pragma once
// Touched paths of a graph: what they have brought in the old scene, and what they bring in the new one, traced from
// where the edit first changes them.

#include <cstdint>
#include <span>
#include <vector>

#include "stages/core/tracing/path_step.h"
#include "stages/core/tracing/pixel_loop.h"
#include "stages/residual/stored/touched_paths.h"

namespace loom::residual {

/// One path in both scenes, to the last bit.
struct PathPair {
    FirstHit first;  // in the new scene; depth but for rounding
    Spectrum before, after;
};

/// Up to its first changed ray a path is the old one: its state follows from the graph, without a ray. Where a light
/// sample before that may be another, or be answered otherwise, that one is drawn and asked again. A repainted surface
/// is asked what it makes of the same random numbers: if it sends the path on as before, only what the path is worth
/// changes. Light that was seen of a lamp that is only relit is seen again.
/// Sums go in the tracer's order: at each depth light that the ray has hit, then the light sample. [METHODS 2.3]
/// One belongs to one thread.
class ResumedPaths {
  public:
    ResumedPaths(const Scene& new_scene, const EditReach& reach, const PathOptions& options);

    /// in:      again  rows of the change's vertices
    /// in, out: pair   first: of the old scene, then of the new one; the rest is filled by this call or by finish(),
    /// and stays
    ///                 where it is until then
    void add(const StoredPaths& paths, const PathChange& change, std::span<const std::uint32_t> again, PathPair& pair);
    /// Has the shadow rays answered that add() has asked for, and takes up the paths that it has left.
    void finish();

    Counts counts;  // of what was traced, shadow rays that were asked again included

  private:
    class Walk;
    static constexpr std::uint32_t is_seen = ~0u;
    /// Light that is added to a path if its shadow ray gets through.
    struct Term {
        PathPair* pair;
        Spectrum light;
        std::uint32_t ray;
    };
    void add_light(PathPair& pair, const Spectrum& light, std::uint32_t ray = is_seen);
    void ask(PathPair& pair, const ShadowRequest& shadow);
    ShadingPoint repainted(const ShadingPoint& here, std::uint32_t shape) const;
    bool sample_light_again(const ShadingPoint& here, std::uint32_t shape, float q, int depth, const PathState& path,
                            ShadowRequest& shadow) const;

    const Scene& scene_;
    const EditReach& reach_;
    PathOptions options_;
    PathBatch batch_;
    std::vector<PathState> states_;  // of paths to be resumed
    std::vector<PathPair*> pairs_;   // theirs
    std::vector<Term> terms_;        // path by path; of a path all from the first that waits for its ray
    std::size_t first_term_ = 0;     // of the path that is being added
    std::vector<Ray> shadow_rays_;
    std::vector<const Ray*> pointers_;
    std::vector<std::uint32_t> under_way_;
};

}  // namespace loom::residual
