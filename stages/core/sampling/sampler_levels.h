#pragma once
#include "stages/core/sampling/sampler.h"

// Declares the sampler's column loops once per x86-64 level.
#define LOOM_DECLARE_LEVEL(level)                                                                         \
    namespace loom::level {                                                                               \
    void sampler_pairs(SamplerKind kind, const std::uint32_t* __restrict key_lo,                          \
                       const std::uint32_t* __restrict key_hi, const std::uint32_t* __restrict index,     \
                       std::uint32_t dimension, std::size_t n, float* __restrict x, float* __restrict y); \
    }
LOOM_DECLARE_LEVEL(v2)
LOOM_DECLARE_LEVEL(v3)
LOOM_DECLARE_LEVEL(v4)
#undef LOOM_DECLARE_LEVEL
