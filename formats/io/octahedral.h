#pragma once
// Unit vectors in 4 bytes. The sphere is projected onto the octahedron |x| + |y| + |z| = 1, whose lower half is folded
// over the upper one. The two remaining coordinates are stored as signed 16-bit fractions of 32767. Axis directions are
// exact; decoding and encoding again gives the same vector. The largest error is 6.4e-5 rad.
//                                          [Cigolle2014] "A Survey of Efficient Representations for
//                                          Independent Unit Vectors", section 3.3

#include <array>
#include <cmath>
#include <cstdint>

namespace loom {

inline std::array<std::int16_t, 2> octahedral_from_unit(float x, float y, float z) {
    const float scale = 1.0f / (std::fabs(x) + std::fabs(y) + std::fabs(z));
    const float px = x * scale, py = y * scale;
    const float fold_x = std::copysign(1.0f - std::fabs(py), px);
    const float fold_y = std::copysign(1.0f - std::fabs(px), py);
    const float u = z < 0.0f ? fold_x : px;
    const float v = z < 0.0f ? fold_y : py;
    const auto snorm = [](float f) {
        return static_cast<std::int16_t>(static_cast<std::int32_t>(f * 32767.0f + std::copysign(0.5f, f)));
    };
    return {snorm(u), snorm(v)};
}

/// Returns the code of -n from the code of n.
inline std::array<std::int16_t, 2> octahedral_opposite(std::int16_t u, std::int16_t v) {
    const auto folded = [](std::int16_t from, std::int16_t other) {
        const int rest = 32767 - (other < 0 ? -other : other);
        return static_cast<std::int16_t>(from < 0 ? rest : -rest);
    };
    return {folded(u, v), folded(v, u)};
}

inline std::array<float, 3> unit_from_octahedral(std::int16_t u, std::int16_t v) {
    float x = static_cast<float>(u) * (1.0f / 32767.0f);
    float y = static_cast<float>(v) * (1.0f / 32767.0f);
    const float z = 1.0f - std::fabs(x) - std::fabs(y);
    const float fold = z < 0.0f ? -z : 0.0f;
    // Rounding must not cross the edges of the fold, where another code stands for the same vector.
    const auto folded = [fold](float c) {
        const float rest = std::fabs(c) - fold;
        return std::copysign(rest > 0.0f ? rest : 0.0f, c);
    };
    x = folded(x);
    y = folded(y);
    const float scale = 1.0f / std::sqrt(x * x + y * y + z * z);
    return {x * scale, y * scale, z * scale};
}

}  // namespace loom
