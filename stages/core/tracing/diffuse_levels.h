#pragma once
#include "stages/core/tracing/diffuse_columns.h"

// Declares shade_diffuse once per x86-64 level.
#define LOOM_DECLARE_LEVEL(level)                                                  \
    namespace loom::level {                                                        \
    void shade_diffuse(DiffuseColumns& columns, std::size_t n, Roulette roulette); \
    }
LOOM_DECLARE_LEVEL(v2)
LOOM_DECLARE_LEVEL(v3)
LOOM_DECLARE_LEVEL(v4)
#undef LOOM_DECLARE_LEVEL
