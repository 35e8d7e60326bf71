#pragma once
// Random numbers are a function of (seed, pixel, sample, dimension) and of nothing else, so that a path
// can be replayed alone, is the same for any number of threads, and stays itself when another path or
// an edited object makes its neighbours longer or shorter.

#include <cstdint>

#include "stages/core/math/vector.h"

namespace loom {

/// Bijective 64-bit mixer.   [Stafford2011] variant 13, as in SplitMix64
constexpr std::uint64_t mix64(std::uint64_t x) {
    x ^= x >> 30;
    x *= 0xbf58476d1ce4e5b9ull;
    x ^= x >> 27;
    x *= 0x94d049bb133111ebull;
    return x ^ (x >> 31);
}

/// [0, 1), 24 bits: every value is a float, none rounds up to 1.
constexpr float unit_float(std::uint32_t bits) { return float(bits >> 8) * 0x1p-24f; }

enum class SamplerKind : std::uint8_t { sobol = 0, independent = 1 };

/// Two-dimensional random numbers of one (seed, pixel, sample), by pair of dimensions.
///
/// sobol:        each pair is the (0,2)-sequence, Owen-scrambled and shuffled by a hash of
///               (seed, pixel, pair); over the samples of a pixel each pair is well spread, pixels and
///               pairs are independent.        [Burley2020] "Practical Hash-based Owen Scrambling"
/// independent:  a hash of everything.
class Sampler {
  public:
    Sampler(SamplerKind kind, std::uint64_t seed, std::uint64_t pixel, std::uint64_t sample)
        : kind_(kind), index_(std::uint32_t(sample)) {
        key_ = mix64(seed * 0x9e3779b97f4a7c15ull + 0x632be59bd9b4e019ull);
        key_ = mix64(key_ ^ (pixel * 0xd6e8feb86659fd93ull + 0x2545f4914f6cdd1dull));
        // A sobol sequence has 2^32 points; what lies beyond starts a new scramble.
        const std::uint64_t block = kind == SamplerKind::sobol ? sample >> 32 : sample + 1;
        if (block != 0) key_ = mix64(key_ ^ (block * 0xa0761d6478bd642full));
    }

    Point2f pair(std::uint32_t dimension) const {
        const std::uint64_t h = mix64(key_ + dimension * 0x9e3779b97f4a7c15ull);
        const std::uint32_t lo = std::uint32_t(h), hi = std::uint32_t(h >> 32);
        if (kind_ == SamplerKind::independent) return {unit_float(lo), unit_float(hi)};
        const std::uint32_t i = reverse(scramble(reverse(index_), lo ^ hi));
        return {unit_float(reverse(scramble(i, lo))), unit_float(reverse(scramble(pascal(i), hi)))};
    }

  private:
    static constexpr std::uint32_t reverse(std::uint32_t x) {
        x = __builtin_bswap32(x);
        x = ((x & 0x0f0f0f0fu) << 4) | ((x >> 4) & 0x0f0f0f0fu);
        x = ((x & 0x33333333u) << 2) | ((x >> 2) & 0x33333333u);
        return ((x & 0x55555555u) << 1) | ((x >> 1) & 0x55555555u);
    }
    /// Owen scrambling of a bit-reversed number: bit k of the result depends on bits 0..k.
    ///                                        [Vegdahl2021] constants of the improved hash
    static constexpr std::uint32_t scramble(std::uint32_t x, std::uint32_t seed) {
        x ^= x * 0x3d20adeau;
        x += seed;
        x *= (seed >> 16) | 1u;
        x ^= x * 0x05526c56u;
        x ^= x * 0x53a22864u;
        return x;
    }
    /// Pascal's triangle mod 2 times x: the generator matrix of the second Sobol' dimension, which is a
    /// fivefold Kronecker power of (1 1; 0 1).
    static constexpr std::uint32_t pascal(std::uint32_t x) {
        x ^= (x & 0xaaaaaaaau) >> 1;
        x ^= (x & 0xccccccccu) >> 2;
        x ^= (x & 0xf0f0f0f0u) >> 4;
        x ^= (x & 0xff00ff00u) >> 8;
        return x ^ ((x & 0xffff0000u) >> 16);
    }

    SamplerKind kind_;
    std::uint32_t index_;
    std::uint64_t key_;
};

}  // namespace loom
