#pragma once
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

#include "stages/core/math/frame.h"
#include "stages/core/math/vector.h"
#include "stages/core/sampling/distribution.h"

namespace loom {

/// Latitude-longitude map, bilinear: row 0 is +y, column 0 is -z. Values lie at the centres of columns; the first and
/// last row lie on the poles (Mitsuba 3).
struct EnvironmentMap {
    int width = 0, height = 0;
    std::vector<Spectrum> texels;  // radiance, row by row
    Distribution2 density;         // over the bilinear cells

    /// Indices of the four texels around a point, and the weights of the far ones.
    struct Place {
        std::size_t at[4];
        float fx = 0, fy = 0;
    };
    Place place(Point2f uv) const;  // prefetches the texels
    Spectrum at(const Place& place) const;
    Spectrum eval(Point2f uv) const { return at(place(uv)); }
    /// Returns the point of a unit direction in the map's axes, and the direction of a point.
    static Point2f point(const Vector3f& d);
    static Vector3f direction(Point2f uv);
    /// Returns the point of a texel.
    Point2f centre(int x, int y) const {
        return {(float(x) + 0.5f) / float(width), height > 1 ? float(y) / float(height - 1) : 0.0f};
    }
    /// Computes `density`. Returns false for a map of zero radiance, which has no density.
    bool prepare();
};

inline EnvironmentMap::Place EnvironmentMap::place(Point2f uv) const {
    float x = uv.x - 0.5f / float(width);
    x = (x - std::floor(x)) * float(width);
    const float y = clamp(uv.y, 0.0f, 1.0f) * float(height - 1);
    const int x0 = std::min(int(x), width - 1), y0 = std::min(int(y), std::max(height - 2, 0));
    const int x1 = x0 + 1 == width ? 0 : x0 + 1, y1 = std::min(y0 + 1, height - 1);
    const auto at = [&](int i, int j) {
        const std::size_t texel = std::size_t(j) * width + i;
        __builtin_prefetch(&texels[texel]);
        return texel;
    };
    return {{at(x0, y0), at(x1, y0), at(x0, y1), at(x1, y1)}, x - float(x0), y - float(y0)};
}

inline Spectrum EnvironmentMap::at(const Place& p) const {
    return lerp(p.fy, lerp(p.fx, texels[p.at[0]], texels[p.at[1]]), lerp(p.fx, texels[p.at[2]], texels[p.at[3]]));
}

/// Density of a sky's light samples, in axes of its own.
struct SkyProposals {
    EnvironmentMap map;
    Frame<float> frame;  // world from local
};

}  // namespace loom
