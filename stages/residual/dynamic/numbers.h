#pragma once
// Random streams of samples that start from a site. Both scenes of an edit use the same stream, and the pairs of many
// samples are computed together as columns (SoA).

#include <vector>

#include "stages/core/sampling/sampler.h"

namespace loom::residual {

/// Random stream of one sample. Its first pairs may be precomputed; the others are computed on demand.
class Numbers {
  public:
    Numbers(const Sampler& sampler) : sampler_(sampler) {}  // NOLINT: a sampler is a stream without precomputed pairs
    Numbers(const Sampler& sampler, const Point2f* known, std::uint32_t n_known, std::uint32_t stride)
        : sampler_(sampler), known_(known), n_known_(n_known), stride_(stride) {}

    Point2f pair(std::uint32_t dimension) const {
        return dimension < n_known_ ? known_[dimension * stride_] : sampler_.pair(dimension);
    }

  private:
    Sampler sampler_;
    const Point2f* known_ = nullptr;
    std::uint32_t n_known_ = 0, stride_ = 0;
};

/// Random streams of consecutive samples of one (seed, pixel 0), precomputed up to the fifth bounce. State of one
/// thread.
class NumbersBlock {
  public:
    static constexpr std::uint32_t size = 64;

    /// Returns the stream of sample `index`; computes those of the following samples with it.
    Numbers of(SamplerKind kind, std::uint64_t seed, std::uint64_t index);

  private:
    static constexpr std::uint32_t n_known = 48;

    std::vector<Sampler> samplers_;
    std::vector<Point2f> known_;  // [dimension][sample]
    SamplerKind kind_ = SamplerKind::sobol;
    std::uint64_t seed_ = 0, first_ = 0;
};

}  // namespace loom::residual
