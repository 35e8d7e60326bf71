#pragma once
#include "stages/core/tracing/segment_columns.h"

// Declares find_met once per x86-64 level.
#define LOOM_DECLARE_LEVEL(level)                                                                    \
    namespace loom::level {                                                                          \
    void find_met(SegmentColumns& segments, std::size_t n, const Box3f* boxes, std::size_t n_boxes); \
    }
LOOM_DECLARE_LEVEL(v2)
LOOM_DECLARE_LEVEL(v3)
LOOM_DECLARE_LEVEL(v4)
#undef LOOM_DECLARE_LEVEL
