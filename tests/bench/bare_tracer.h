#pragma once
// The least that a path tracer can be on the same rays: what loom's tracers are measured against.

#include <cstdint>
#include <memory>

#include "stages/core/scene/scene.h"

namespace loom::bench {

/// A loop around single-ray calls of Embree over the triangles of a scene: every surface diffuse with one albedo
/// per shape, one shadow ray per vertex, roulette by albedo from depth 5. No textures, no shading normals, no
/// multiple importance sampling, nothing recorded. Spheres and disks are made of triangles.
class BareTracer {
  public:
    explicit BareTracer(const Scene& scene);
    ~BareTracer();

    struct Result {
        std::uint64_t vertices = 0;
        double mean_radiance = 0;  // of all paths; keeps the compiler from leaving the work out
    };
    /// Traces one path through each pixel, `spp` times.
    Result render(std::uint64_t spp, int threads) const;

  private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

}  // namespace loom::bench
