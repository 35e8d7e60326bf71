#pragma once
#include <memory>
#include <vector>

#include "stages/core/math/box.h"
#include "stages/core/tracing/path_observer.h"
#include "stages/core/tracing/segment_columns.h"

namespace loom {
class RayEngine;
}

namespace loom::residual {

/// Parts of a scene by which an edit may change a path.
struct EditTargets {
    // Shapes that a segment touches by passing through them; they need not be in the scene. Null: none.
    const RayEngine* passed = nullptr;
    std::vector<Box3f> boxes;            // around `passed`; a segment outside of all boxes needs no ray query
    std::vector<std::uint8_t> shapes;    // [shape of the scene] a vertex on it touches
    std::vector<std::uint8_t> emitters;  // [emitter of the scene] touched where it is hit or chosen by light sampling
    bool environment = false;            // touched by rays that leave the scene
};

/// Finds the paths of a batch that touch an edit; all others are equal with and without it. Shadow rays count, occluded
/// or not.
class TouchObserver : public PathObserver {
  public:
    TouchObserver(const Scene& scene, EditTargets targets);

    /// Whether path k of the last batch touched a target.
    bool touched(std::size_t k) const { return touched_[k] != 0; }

    void start(std::size_t n) override;
    void arrive(std::span<const std::uint32_t> paths, std::span<const Ray* const> rays, std::span<const Hit> hits,
                std::span<const LightQuery> lights) override;
    void trace_shadow_rays(std::span<const std::uint32_t> paths, std::span<const Ray* const> rays) override;

  private:
    bool is_target(const Hit& hit, const LightQuery& light) const;
    void add_segment(std::uint32_t path, const Ray& segment);
    /// Marks the paths whose segments pass through a target, and clears the segments.
    void test_segments();

    const Scene& scene_;
    EditTargets targets_;
    std::vector<std::uint8_t> touched_;   // [path]
    std::vector<std::uint32_t> waiting_;  // paths of the segments
    std::vector<Ray> segments_;
    SegmentColumns columns_;  // the segments as SoA
    std::vector<const Ray*> rays_;
    std::unique_ptr<bool[]> blocked_;
};

}  // namespace loom::residual
