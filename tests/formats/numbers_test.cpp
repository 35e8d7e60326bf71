// Halves, octahedral directions, content hash: against their definitions.

#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "formats/io/content_hash.h"
#include "formats/io/half.h"
#include "formats/io/octahedral.h"

namespace loom {
namespace {

/// The value of a half by its definition.
double slow_value(std::uint16_t bits) {
    const int exponent = (bits >> 10) & 31, mantissa = bits & 1023;
    const double sign = (bits & 0x8000) != 0 ? -1.0 : 1.0;
    if (exponent == 31) return mantissa == 0 ? sign * INFINITY : NAN;
    if (exponent == 0) return sign * std::ldexp(mantissa, -24);
    return sign * std::ldexp(1024 + mantissa, exponent - 25);
}

TEST(Half, EveryHalfHasItsValueAndComesBack) {
    for (unsigned bits = 0; bits < 65536; ++bits) {
        const Half half{static_cast<std::uint16_t>(bits)};
        const double value = slow_value(half.bits);
        const float converted = float_from_half(half);
        if (std::isnan(value)) {
            EXPECT_TRUE(std::isnan(converted));
            EXPECT_TRUE(std::isnan(float_from_half(half_from_float(converted))));
        } else {
            EXPECT_EQ(converted, value);
            EXPECT_EQ(half_from_float(converted).bits, half.bits);
        }
    }
}

// Between two neighbours the nearer one is chosen, and the even one in the middle.
TEST(Half, RoundsToNearestEven) {
    for (unsigned bits = 0; bits < 0x7c00; ++bits) {
        const auto low = static_cast<std::uint16_t>(bits), high = static_cast<std::uint16_t>(bits + 1);
        const double above = high == 0x7c00 ? 65536.0 : slow_value(high);
        const auto middle = static_cast<float>(0.5 * (slow_value(low) + above));
        EXPECT_EQ(half_from_float(middle).bits, (low & 1) == 0 ? low : high);
        EXPECT_EQ(half_from_float(std::nextafter(middle, 0.0f)).bits, low);
        EXPECT_EQ(half_from_float(std::nextafter(middle, 1e9f)).bits, high);
    }
    EXPECT_EQ(half_from_float(1e9f).bits, 0x7c00);
    EXPECT_EQ(half_from_float(-INFINITY).bits, 0xfc00);
}

TEST(Octahedral, AxesAreExact) {
    for (int axis = 0; axis < 3; ++axis) {
        for (float sign : {1.0f, -1.0f}) {
            std::array<float, 3> v{};
            v[static_cast<std::size_t>(axis)] = sign;
            const auto [u, w] = octahedral_from_unit(v[0], v[1], v[2]);
            const auto back = unit_from_octahedral(u, w);
            for (std::size_t c = 0; c < 3; ++c) EXPECT_EQ(back[c], v[c]);
        }
    }
}

// A reader of the graph gets exactly the value that a tracer rounded. All 4.3e9 codes were tried. With a fold that
// rounding could cross, 21,344 codes on its edges came back as another vector.
TEST(Octahedral, WhatCameBackOnceComesBackTheSame) {
    const auto same_again = [](int u, int v) {
        const auto once = unit_from_octahedral(static_cast<std::int16_t>(u), static_cast<std::int16_t>(v));
        const auto code = octahedral_from_unit(once[0], once[1], once[2]);
        return once == unit_from_octahedral(code[0], code[1]);
    };
    for (int u = -32767; u <= 32767; ++u)
        for (const int v : {-32767, 32767, -32766, 32766}) {
            ASSERT_TRUE(same_again(u, v)) << u << " " << v;
            ASSERT_TRUE(same_again(v, u)) << v << " " << u;
        }
    std::mt19937 rng(2);
    std::uniform_int_distribution<int> code(-32767, 32767);
    for (int i = 0; i < 1000000; ++i) {
        const int u = code(rng), v = code(rng);
        ASSERT_TRUE(same_again(u, v)) << u << " " << v;
    }
}

TEST(Octahedral, OppositeIsRightToRounding) {
    std::mt19937 rng(3);
    std::uniform_int_distribution<int> code(-32767, 32767), pick(0, 4);
    const int edges[] = {-32767, 0, 32767, 1};
    for (int i = 0; i < 1000000; ++i) {
        const auto one = [&] { return static_cast<std::int16_t>(pick(rng) == 0 ? edges[i % 4] : code(rng)); };
        const std::int16_t u = one(), v = one();
        const auto n = unit_from_octahedral(u, v);
        const auto [ou, ov] = octahedral_opposite(u, v);
        const auto opposite = unit_from_octahedral(ou, ov);
        for (std::size_t c = 0; c < 3; ++c) ASSERT_NEAR(opposite[c], -n[c], 3e-7) << u << " " << v;
    }
}

TEST(Octahedral, ErrorIsBoundedEverywhere) {
    std::mt19937 random(1);
    std::normal_distribution<double> gauss;
    double worst = 0;
    for (int i = 0; i < 1'000'000; ++i) {
        double x = gauss(random), y = gauss(random), z = gauss(random) * (i % 4 == 0 ? 1e-4 : 1.0);
        const double r = std::sqrt(x * x + y * y + z * z);
        x /= r, y /= r, z /= r;
        const auto [u, v] = octahedral_from_unit(static_cast<float>(x), static_cast<float>(y), static_cast<float>(z));
        const auto back = unit_from_octahedral(u, v);
        const double cx = y * back[2] - z * back[1], cy = z * back[0] - x * back[2], cz = x * back[1] - y * back[0];
        worst = std::max(worst, std::sqrt(cx * cx + cy * cy + cz * cz));
        EXPECT_GT(x * back[0] + y * back[1] + z * back[2], 0);
    }
    EXPECT_LT(worst, 6.5e-5);  // rad
}

// Known answers of XXH64 with seed 0, one per branch of the tail.
TEST(ContentHash, KnownAnswers) {
    const auto hash = [](std::string_view text) {
        return content_hash_text(content_hash(std::as_bytes(std::span(text))));
    };
    EXPECT_EQ(hash(""), "ef46db3751d8e999");
    EXPECT_EQ(hash("a"), "d24ec4f1a98c6e5b");
    EXPECT_EQ(hash("abc"), "44bc2cf5ad770999");
    EXPECT_EQ(hash("Nobody inspects the spammish repetition"), "fbcea83c8a378bf1");
}

}  // namespace
}  // namespace loom
