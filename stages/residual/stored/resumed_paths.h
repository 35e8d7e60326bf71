#pragma once
// Touched paths of a graph: their contribution in the old scene, and that in the new scene, traced from the first
// vertex that the edit changes.

#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "stages/core/edit/scene_pair.h"
#include "stages/core/tracing/path_step.h"
#include "stages/core/tracing/pixel_loop.h"
#include "stages/residual/stored/stored_block.h"
#include "stages/residual/stored/touched_paths.h"

namespace loom::residual {

/// Contribution of one path in both scenes, exact to the last bit.
struct PathPair {
    FirstHit first;  // in the new scene; depth up to rounding
    Spectrum before, after;
    Spectrum stored;  // of the graph; differs from `before` where two skies have light samples in common
};

/// Up to its first changed ray a path equals the old one: its state follows from the graph, without a ray. Where an
/// earlier light sample or its visibility may change, the sample is drawn again and its shadow ray traced. At a
/// repainted surface the BSDF sample is drawn again with the same random stream. If the path continues as before, only
/// its throughput changes. A visible light sample of an emitter that only changed its radiance stays visible. Sums are
/// in the tracer's order: at each depth light that the ray has hit, then the light sample. [METHODS 2.3]
///
/// With SkyPair::shared, in both scenes the light samples of the sky and the weights of rays that escape are by the new
/// scene's proposals, at each vertex that the path reaches as before; from its first changed ray on each scene has its own.
/// State of one thread.
class ResumedPaths {
  public:
    ResumedPaths(const ScenePair& scenes, const EditReach& reach, const PathOptions& options);

    /// Adds touched paths of a block.
    /// in, out: pairs  [path] first: of the old scene, then of the new one; this call or finish() fills the rest, so
    /// their addresses must stay valid until then
    void add(StoredBlock& block, const PathChanges& changes, std::span<PathPair> pairs);
    /// Computes what a path that is not touched brings in the old scene.
    void add_untouched(StoredBlock& block, std::size_t path, PathPair& pair);
    /// Looks up the skies and traces the shadow rays that add() has queued, and continues the paths that it has deferred.
    void finish();

    tracing::Counts counts;  // of the traced rays, repeated shadow rays included

  private:
    class Walk;
    // Numbers of shadow rays: of one in the old scene, with the highest bit; of none, for light that is seen.
    static constexpr std::uint32_t is_seen = ~0u, in_old_scene = 1u << 31;
    /// Light that is added to a sum of a pair if its shadow ray is unoccluded.
    struct Term {
        Spectrum* sum;
        Spectrum light;
        std::uint32_t ray;
    };
    void add_light(Spectrum& sum, const Spectrum& light, std::uint32_t ray = is_seen);
    /// Light of a sky that a ray leads to, of a term whose `light` waits for it.
    struct AskedSky {
        std::size_t term;
        Spectrum beta;
        float density;    // of the ray, as of light_hit_contribution()
        bool is_sampled;  // the new sky's light samples may have its direction
        bool of_old;      // radiance of the old sky; the density of light samples is always the new one's
    };
    /// Adds the light of a sky in direction d.
    void ask_sky(Spectrum& sum, const Vector3f& d, const AskedSky& asked);
    void look_up_skies();
    void follow(StoredBlock& block, const PathChange& change, std::span<const std::uint32_t> again,
                std::span<const LightQuery> lights, PathPair& pair);
    /// Queue a shadow ray and return its number.
    std::uint32_t ask(const Ray& ray);
    std::uint32_t ask_old(const Ray& ray);
    std::unique_ptr<bool[]> trace(const Scene& scene, std::vector<Ray>& rays);
    ShadingPoint repainted(const ShadingPoint& here, std::uint32_t shape) const;

    const Scene &old_scene_, &scene_;
    const EditReach& reach_;
    PathOptions options_;
    bool shares_sky_, same_shapes_;
    PathBatch batch_;
    std::vector<PathState> states_;  // of paths to be resumed
    std::vector<PathPair*> pairs_;   // pairs of these paths
    std::vector<Term> terms_;        // ordered by path; for a path, all terms from the first that waits for its ray
    std::size_t first_term_ = 0;     // of the path that is being added
    std::vector<AskedSky> asked_skies_;
    std::vector<LightQuery> skies_, old_skies_;  // [asked_skies_], [asked_skies_ that are of_old]
    std::vector<LightQuery> lights_;             // [again]
    std::vector<Ray> shadow_rays_, old_shadow_rays_;
    std::vector<const Ray*> pointers_;
    std::vector<std::uint32_t> under_way_;
};

}  // namespace loom::residual
