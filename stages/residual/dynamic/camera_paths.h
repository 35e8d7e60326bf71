#pragma once
// Pairs of camera paths in batches; the old path of a pair is traced only where it may differ.

#include <memory>
#include <vector>

#include "stages/core/tracing/pixel_loop.h"
#include "stages/residual/dynamic/dynamic_scene.h"
#include "stages/residual/dynamic/touch_observer.h"

namespace loom::residual {

/// State of one thread.
class CameraPaths {
  public:
    CameraPaths(const DynamicScenes& scenes, const PathOptions& path);

    /// Traces paths of the new scene, at most PathBatch::capacity, and finds those that the edit may have changed.
    void trace_new(std::span<const PathId> ids);
    /// Calls trace_new(), then traces the touched paths again in the old scene.
    void trace(std::span<const PathId> ids);

    bool touched(std::size_t k) const { return old_of_[k] != none; }
    const FirstHit& first(std::size_t k) const { return new_[k].first; }
    const Spectrum& L_new(std::size_t k) const { return new_[k].L; }
    /// After trace(): new minus old, 0 for untouched paths; number of rays of both.
    Spectrum difference(std::size_t k) const { return touched(k) ? new_[k].L - old_[old_of_[k]].L : Spectrum(); }
    std::uint32_t rays(std::size_t k) const { return new_[k].n_rays + (touched(k) ? old_[old_of_[k]].n_rays : 0); }

    tracing::Counts counts_new, counts_old;
    std::uint64_t n_touched = 0;

  private:
    static constexpr std::uint32_t none = ~0u;

    std::unique_ptr<TouchObserver> observer_;
    bool all_touched_;
    PathBatch new_batch_, old_batch_;
    std::vector<PathResult> new_, old_;
    std::vector<std::uint32_t> old_of_;  // [path] index of its old path in old_, or `none`
    std::vector<PathId> touched_;
};

}  // namespace loom::residual
