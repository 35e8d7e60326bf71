#pragma once
// IEEE 754 binary16 as stored on disk. The conversions are branch-free, so loops vectorise on every x86-64 level and
// give the same bits on each.

#include <bit>
#include <cstdint>
#include <span>

namespace loom {

/// A stored half: 1 sign, 5 exponent, 10 mantissa bits. It has no arithmetic; convert to float first.
struct Half {
    std::uint16_t bits = 0;
    bool operator==(const Half&) const = default;
};

/// Rounds to the nearest half, ties to even; rounded values beyond 65504 become infinity; NaN stays NaN.
constexpr Half half_from_float(float value) {
    const auto x = std::bit_cast<std::uint32_t>(value);
    const std::uint32_t sign = (x >> 16) & 0x8000u;
    const std::uint32_t magnitude = x & 0x7fffffffu;
    // Below 2^-14 the result is a multiple of 2^-24, the spacing of floats in [0.5, 1), so this addition rounds
    // correctly.
    const std::uint32_t tiny =
        std::bit_cast<std::uint32_t>(std::bit_cast<float>(magnitude) + 0.5f) - std::bit_cast<std::uint32_t>(0.5f);
    const std::uint32_t normal = (magnitude + 0xfffu + ((magnitude >> 13) & 1u) - (112u << 23)) >> 13;
    const std::uint32_t huge = magnitude > 0x7f800000u ? 0x7e00u : 0x7c00u;
    const std::uint32_t finite = magnitude < (113u << 23) ? tiny : normal;
    return {static_cast<std::uint16_t>(sign | (magnitude < (143u << 23) ? finite : huge))};
}

constexpr float float_from_half(Half half) {
    const std::uint32_t magnitude = half.bits & 0x7fffu;
    const std::uint32_t sign = (half.bits & 0x8000u) << 16;
    const std::uint32_t tiny =
        std::bit_cast<std::uint32_t>(static_cast<float>(static_cast<std::int32_t>(magnitude)) * 0x1p-24f);
    const std::uint32_t normal = (magnitude << 13) + (112u << 23);
    const std::uint32_t special = (magnitude << 13) + (224u << 23);
    const std::uint32_t finite = magnitude < 0x400u ? tiny : normal;
    return std::bit_cast<float>(sign | (magnitude < 0x7c00u ? finite : special));
}

/// Convert arrays of equal length.
inline void halves_from_floats(std::span<const float> in, std::span<Half> out) {
    for (std::size_t i = 0; i < in.size(); ++i) out[i] = half_from_float(in[i]);
}
inline void floats_from_halves(std::span<const Half> in, std::span<float> out) {
    for (std::size_t i = 0; i < in.size(); ++i) out[i] = float_from_half(in[i]);
}

}  // namespace loom
