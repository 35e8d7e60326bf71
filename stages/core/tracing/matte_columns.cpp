#include "stages/core/tracing/matte_levels.h"

namespace loom {

void shade_matte(MatteColumns& columns, std::size_t n, Roulette roulette) {
    static const auto chosen = __builtin_cpu_supports("x86-64-v4")   ? v4::shade_matte
                               : __builtin_cpu_supports("x86-64-v3") ? v3::shade_matte
                                                                     : v2::shade_matte;
    chosen(columns, n, roulette);
}

}  // namespace loom
