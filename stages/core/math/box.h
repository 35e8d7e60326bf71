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
    /// Whether the ray segment o + t d, t in [t_min, t_max], hits the box, up to rounding. A ray in the plane of a face
    /// may count as a miss.
    /// in: inv_d  1 / d by component, infinite where d is 0
    bool met_by(const Point3f& o, const Vector3f& inv_d, float t_min, float t_max) const {
        for (int c = 0; c < 3; ++c) {
            const float a = (lo[c] - o[c]) * inv_d[c], b = (hi[c] - o[c]) * inv_d[c];
            const float near = a < b ? a : b, far = a < b ? b : a;
            t_min = near > t_min ? near : t_min;
            t_max = far < t_max ? far : t_max;
        }
        return t_min <= t_max;
    }
    void grow(float by) {
        for (int c = 0; c < 3; ++c) {
            lo[c] -= by;
            hi[c] += by;
        }
    }
};

/// Returns the distance of a point from a box, 0 inside.
inline double distance(const Box3f& box, const Point3<double>& p) {
    double sum = 0;
    for (int c = 0; c < 3; ++c) sum += sqr(std::max({double(box.lo[c]) - p[c], p[c] - double(box.hi[c]), 0.0}));
    return std::sqrt(sum);
}

}  // namespace loom
