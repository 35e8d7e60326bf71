#include "stages/core/tracing/diffuse_levels.h"

namespace loom {

void shade_diffuse(DiffuseColumns& columns, std::size_t n, Roulette roulette) {
    static const auto chosen = __builtin_cpu_supports("x86-64-v4")   ? v4::shade_diffuse
                               : __builtin_cpu_supports("x86-64-v3") ? v3::shade_diffuse
                                                                     : v2::shade_diffuse;
    chosen(columns, n, roulette);
}

}  // namespace loom
