#pragma once
#include <cstdint>
#include <span>

#include "stages/core/scene/scene.h"

namespace loom {

/// Observes the paths of a PathBatch. Each call covers all active paths; paths are indices into the batch.
class PathObserver {
  public:
    virtual ~PathObserver() = default;

    /// A batch of n paths starts.
    virtual void start(std::size_t n) = 0;
    /// Rays have arrived; nothing has been added to their paths yet. All spans have the length of `paths`.
    /// in:      hits    false where the ray leaves the scene
    ///          lights  looked up for the hit or the miss
    virtual void arrive(std::span<const std::uint32_t> paths, std::span<const Ray* const> rays,
                        std::span<const Hit> hits, std::span<const LightQuery> lights) = 0;
    /// Shadow rays of these paths have been traced, whether occluded or not.
    virtual void trace_shadow_rays(std::span<const std::uint32_t> paths, std::span<const Ray* const> rays) = 0;
};

/// Stops paths of a PathBatch before they arrive.
class PathGate {
  public:
    virtual ~PathGate() = default;

    /// Rays have hit; nothing has been added to their paths yet. All spans have the length of `paths`.
    /// in:      depth  of the vertices, from 1
    ///          hits   false where the ray leaves the scene
    /// out:     stops  1 where the path stops, with its ray and all state as they are; else 0
    virtual void arrive(int depth, std::span<const std::uint32_t> paths, std::span<const Ray* const> rays,
                        std::span<const Hit> hits, std::span<std::uint8_t> stops) = 0;
};

}  // namespace loom
