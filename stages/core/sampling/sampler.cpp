#include "stages/core/sampling/sampler_levels.h"

namespace loom {

void sampler_pairs(SamplerKind kind, const std::uint32_t* key_lo, const std::uint32_t* key_hi,
                   const std::uint32_t* index, std::uint32_t dimension, std::size_t n, float* x, float* y) {
    static const auto chosen = __builtin_cpu_supports("x86-64-v4")   ? v4::sampler_pairs
                               : __builtin_cpu_supports("x86-64-v3") ? v3::sampler_pairs
                                                                     : v2::sampler_pairs;
    chosen(kind, key_lo, key_hi, index, dimension, n, x, y);
}

}  // namespace loom
