#pragma once
// The exponential function without a library call, so that loops over columns vectorise.

#include <bit>
#include <cmath>
#include <cstdint>
#include <type_traits>

namespace loom {

/// Returns e^x. For a float: relative error at most 2.5e-7, x clamped to [-87, 88]. For other types: their own exp.
///   e^x = 2^n e^r, n = round(x / ln 2), |r| <= ln 2 / 2; e^r by its Taylor polynomial
template <class T>
[[gnu::always_inline]] inline T exponential(const T& x) {
    if constexpr (std::is_same_v<T, float>) {
        const float held = x < -87.0f ? -87.0f : x > 88.0f ? 88.0f : x;
        constexpr float to_whole = 0x1.8p23f;  // adding and subtracting it rounds; -ffast-math would remove it
        const float n = (held * 1.44269504f + to_whole) - to_whole;
        const float r = (held - n * 0.693359375f) + n * 2.12194440e-4f;  // n ln 2 in two terms, the first exact
        // Written out: a loop here would prevent vectorisation of the loop around it.
        const float r2 = r * r;
        const float high = (1.0f / 24 + r * (1.0f / 120 + r * (1.0f / 720)));
        const float e = 1 + (r + r2 * (0.5f + r * (1.0f / 6) + r2 * high));
        return e * std::bit_cast<float>((std::int32_t(n) + 127) << 23);
    } else {
        using std::exp;
        return exp(x);
    }
}

}  // namespace loom
