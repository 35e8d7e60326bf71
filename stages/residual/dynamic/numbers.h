#pragma once
// Random numbers of samples that start from a site: both scenes of an edit ask for the same ones, and many samples at
// once are worked out by column.

#include <vector>

#include "stages/core/sampling/sampler.h"

namespace loom::residual {

/// Those of one sample. The first pairs may be known, the others are worked out when asked for.
class Numbers {
  public:
    Numbers(const Sampler& sampler) : sampler_(sampler) {}  // NOLINT: a sampler is what numbers are without a block
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

/// Those of consecutive samples of one (seed, pixel 0): the pairs up to the fifth bounce. One thread's.
class NumbersBlock {
  public:
    static constexpr std::uint32_t size = 64;

    /// Numbers of sample `index`; the samples after it are worked out with it.
    Numbers of(SamplerKind kind, std::uint64_t seed, std::uint64_t index);

  private:
    static constexpr std::uint32_t n_known = 48;

    std::vector<Sampler> samplers_;
    std::vector<Point2f> known_;  // [dimension][sample]
    SamplerKind kind_ = SamplerKind::sobol;
    std::uint64_t seed_ = 0, first_ = 0;
};

}  // namespace loom::residual
