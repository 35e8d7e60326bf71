#include "stages/core/tracing/segment_levels.h"

namespace loom {

void find_met(SegmentColumns& segments, std::size_t n, const Box3f* boxes, std::size_t n_boxes) {
    static const auto chosen = __builtin_cpu_supports("x86-64-v4")   ? v4::find_met
                               : __builtin_cpu_supports("x86-64-v3") ? v3::find_met
                                                                     : v2::find_met;
    chosen(segments, n, boxes, n_boxes);
}

}  // namespace loom
