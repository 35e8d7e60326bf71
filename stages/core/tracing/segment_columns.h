#pragma once
#include <cstddef>
#include <cstdint>
#include <vector>

#include "stages/core/math/box.h"
#include "stages/core/scene/scene.h"

namespace loom {

/// Segments o + t d, t in [t_min, t_max], as a structure of arrays (SoA).
struct SegmentColumns {
    std::vector<float> o[3], inv_d[3], t_min, t_max;  // inv_d: 1 / d by component, infinite where it is 0
    std::vector<std::uint8_t> met;

    explicit SegmentColumns(std::size_t capacity) {
        for (int c = 0; c < 3; ++c) {
            o[c].resize(capacity);
            inv_d[c].resize(capacity);
        }
        t_min.resize(capacity);
        t_max.resize(capacity);
        met.resize(capacity);
    }
    void set(std::size_t i, const Ray& ray) {
        for (int c = 0; c < 3; ++c) {
            o[c][i] = ray.o[c];
            inv_d[c][i] = 1 / ray.d[c];
        }
        t_min[i] = ray.t_min;
        t_max[i] = ray.t_max;
    }
};

/// Sets met[i] to whether segment i hits one of the boxes, except for rounding; a segment in the plane of a face may
/// count as outside.
void find_met(SegmentColumns& segments, std::size_t n, const Box3f* boxes, std::size_t n_boxes);

}  // namespace loom
