#pragma once
// Minimal path tracer on the same rays, the baseline of the benchmarks.

#include <cstdint>
#include <memory>

#include "stages/core/scene/scene.h"

namespace loom::bench {

/// A loop around single-ray calls of Embree over the triangles of a scene. Every surface is diffuse with one albedo per
/// shape. There is one shadow ray per vertex, and roulette by albedo from depth 5. No textures, no shading normals, no
/// multiple importance sampling, no records. Spheres and disks are triangulated.
class BareTracer {
  public:
    explicit BareTracer(const Scene& scene);
    ~BareTracer();

    struct Result {
        std::uint64_t vertices = 0;
        double mean_radiance = 0;  // over all paths; prevents the compiler from removing the work
    };
    /// Traces one path through each pixel, `spp` times.
    Result render(std::uint64_t spp, int threads) const;

  private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace loom::bench
