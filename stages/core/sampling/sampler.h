#pragma once
// A sample is a function of (seed, pixel, sample, dimension) only. Thus a path can be replayed alone, is the same for
// any number of threads, and stays unchanged when another path or an edited object makes its neighbours longer or
// shorter.

#include <cstddef>
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

/// Bijective 32-bit mixer that vectorises in loops over columns.            [Wellons2018] lowbias32
constexpr std::uint32_t mix32(std::uint32_t x) {
    x ^= x >> 16;
    x *= 0x7feb352du;
    x ^= x >> 15;
    x *= 0x846ca68bu;
    return x ^ (x >> 16);
}

/// Maps to [0, 1) with 24 bits: every value is a float, none rounds up to 1.
constexpr float unit_float(std::uint32_t bits) {
    return float(bits >> 8) * 0x1p-24f;
}

enum class SamplerKind : std::uint8_t { sobol = 0, independent = 1 };

/// Two-dimensional samples of one (seed, pixel, sample), by pair of dimensions.
///
/// sobol:        each pair is the (0,2)-sequence, Owen-scrambled and shuffled by a hash of
///               (seed, pixel, pair). Each pair is well distributed over the samples of a pixel; pixels and
///               pairs are independent.        [Burley2020] "Practical Hash-based Owen Scrambling"
/// independent:  a hash of seed, pixel, sample and pair.
class Sampler {
  public:
    Sampler(SamplerKind kind, std::uint64_t seed, std::uint64_t pixel, std::uint64_t sample)
        : kind_(kind), index_(std::uint32_t(sample)) {
        std::uint64_t key = mix64(seed * 0x9e3779b97f4a7c15ull + 0x632be59bd9b4e019ull);
        key = mix64(key ^ (pixel * 0xd6e8feb86659fd93ull + 0x2545f4914f6cdd1dull));
        // A Sobol sequence has 2^32 points; later samples use another scramble.
        const std::uint64_t block = kind == SamplerKind::sobol ? sample >> 32 : sample + 1;
        if (block != 0) key = mix64(key ^ (block * 0xa0761d6478bd642full));
        key_lo_ = std::uint32_t(key);
        key_hi_ = std::uint32_t(key >> 32);
    }

    /// Returns both samples of a pair of dimensions.
    Point2f pair(std::uint32_t dimension) const {
        Point2f u;
        if (kind_ == SamplerKind::sobol)
            sobol(key_lo_, key_hi_, index_, dimension, u.x, u.y);
        else
            independent(key_lo_, key_hi_, dimension, u.x, u.y);
        return u;
    }

    std::uint32_t key_lo() const { return key_lo_; }
    std::uint32_t key_hi() const { return key_hi_; }
    std::uint32_t index() const { return index_; }

    /// Returns the samples of one pair from a sampler's keys and index.
    static constexpr void independent(std::uint32_t lo, std::uint32_t hi, std::uint32_t dimension, float& x, float& y) {
        std::uint32_t a = 0, b = 0;
        hash(lo, hi, dimension, a, b);
        x = unit_float(a);
        y = unit_float(b);
    }
    static constexpr void sobol(std::uint32_t lo, std::uint32_t hi, std::uint32_t index, std::uint32_t dimension,
                                float& x, float& y) {
        std::uint32_t a = 0, b = 0;
        hash(lo, hi, dimension, a, b);
        const std::uint32_t i = reverse(scramble(reverse(index), mix32(a + b)));
        x = unit_float(reverse(scramble(i, a)));
        y = unit_float(reverse(scramble(pascal(i), b)));
    }

  private:
    static constexpr std::uint32_t reverse(std::uint32_t x) {
        x = (x << 16) | (x >> 16);
        x = ((x & 0x00ff00ffu) << 8) | ((x >> 8) & 0x00ff00ffu);
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

    /// Two hashes of (key, dimension).
    static constexpr void hash(std::uint32_t lo, std::uint32_t hi, std::uint32_t dimension, std::uint32_t& a,
                               std::uint32_t& b) {
        a = mix32(lo ^ mix32(hi + dimension * 0x9e3779b9u));
        b = mix32(a ^ hi ^ 0x68bc21ebu);
    }

    SamplerKind kind_;
    std::uint32_t index_, key_lo_, key_hi_;
};

/// Sampler::pair for a column of samplers of one kind, given by their keys; bit-identical on every x86-64 level.
/// in:      key_lo, key_hi, index  uint32[n]
/// out:     x, y  float[n]
void sampler_pairs(SamplerKind kind, const std::uint32_t* key_lo, const std::uint32_t* key_hi,
                   const std::uint32_t* index, std::uint32_t dimension, std::size_t n, float* x, float* y);

}  // namespace loom
