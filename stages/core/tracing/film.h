#pragma once
// Averages samples of pixels to an image with auxiliary layers. The path tracer without a graph and the stage that
// reads a graph compute the same sums.

#include <cstdint>
#include <string>

#include "formats/image.h"
#include "stages/core/stats/moments.h"
#include "stages/core/tracing/path_tracer.h"

namespace loom {

/// Sums over the samples of one pixel, in the order of the samples.
struct PixelSums {
    Moments L[3];
    double albedo[3]{}, n[3]{}, depth = 0;
    std::uint64_t hits = 0;

    void add(const Spectrum& sample, const FirstHit& first);
    /// Adds only one part each, for samples whose radiance is computed later.
    void add(const Spectrum& sample);
    void add(const FirstHit& first);
};

/// Layers of an image; each pixel is written by one thread.
class Film {
  public:
    Film(std::uint32_t width, std::uint32_t height, std::uint64_t samples);

    /// Writes the means of a pixel; divides by the number of samples in the sums, at least 1.
    void set(std::uint64_t pixel, const PixelSums& sums);
    Image finish(Provenance provenance) &&;

  private:
    Image image_;
    std::span<float> radiance_[3], var_mean_[3], albedo_[3], n_[3], depth_;
};

}  // namespace loom
