#pragma once
#include <algorithm>
#include <cmath>

#include "stages/core/math/vector.h"

namespace loom {

/// Axis-aligned box; empty until something is added.
struct Box3f {
    Point3f lo{INFINITY, INFINITY, INFINITY}, hi{-INFINITY, -INFINITY, -INFINITY};

    void add(const Point3f& p) {
        for (int c = 0; c < 3; ++c) {
            lo[c] = std::min(lo[c], p[c]);
            hi[c] = std::max(hi[c], p[c]);
        }
    }
    void add(const Box3f& box) {
        add(box.lo);
        add(box.hi);
    }
    void grow(float by) {
        for (int c = 0; c < 3; ++c) {
            lo[c] -= by;
            hi[c] += by;
        }
    }
};

}  // namespace loom
