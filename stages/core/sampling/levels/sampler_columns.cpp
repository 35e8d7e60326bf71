// The column loops of the sampler, compiled once per x86-64 level (LOOM_LEVEL is v2, v3 or v4). The sampler's functions
// are constexpr and inlined, so no other code of a level enters the program.
#include "stages/core/sampling/sampler_levels.h"

namespace loom::LOOM_LEVEL {

void sampler_pairs(SamplerKind kind, const std::uint32_t* __restrict key_lo, const std::uint32_t* __restrict key_hi,
                   const std::uint32_t* __restrict index, std::uint32_t dimension, std::size_t n, float* __restrict x,
                   float* __restrict y) {
    if (kind == SamplerKind::sobol)
        for (std::size_t i = 0; i < n; ++i) Sampler::sobol(key_lo[i], key_hi[i], index[i], dimension, x[i], y[i]);
    else
        for (std::size_t i = 0; i < n; ++i) Sampler::independent(key_lo[i], key_hi[i], dimension, x[i], y[i]);
}

}  // namespace loom::LOOM_LEVEL
