#pragma once
// Random streams: the seed of each computation, and the use of each dimension of a sample. All seeds that the stages
// derive from --seed are defined here, so that no two computations share one by accident.

#include <cstdint>
#include <string_view>

#include "stages/core/sampling/sampler.h"

namespace loom {

// Each decision has its own pair of dimensions, used or not, so that an edit that skips one leaves all others
// unchanged.

/// Pair of dimensions of a camera path for its position on the film.
inline constexpr std::uint32_t film_pair = 0;
/// Pair of dimensions of a camera path for whether it is traced on from where a cache answers: beyond those of all
/// vertices.
inline constexpr std::uint32_t correction_pair = ~0u;
/// Pairs of dimensions of a camera path at one vertex.
enum class Dimension : std::uint32_t { light = 1, direction = 2, lobe = 3, roulette = 4 };
/// Pair of dimensions of a camera path.
/// in:      depth  index of the vertex that decides, from 1
constexpr std::uint32_t dimension(int depth, Dimension of) {
    return std::uint32_t(depth - 1) * 4 + std::uint32_t(of);
}

/// Pairs of dimensions of a path that starts from a site of an edit. Each bounce has its own pairs, so that both scenes
/// of the edit use the same ones.
namespace site_dimension {
inline constexpr std::uint32_t choice = 0, point = 1, light = 2, lobe = 3, first_walk = 8;
/// in: k     number of the bounce, from 0
///     what  decision at the bounce, 0 to 3
constexpr std::uint32_t walk(int k, bool to_light, std::uint32_t what) {
    return first_walk + std::uint32_t(k) * 8 + (to_light ? 4 : 0) + what;
}
}  // namespace site_dimension

namespace streams {

/// 2^64 over the golden ratio: consecutive multiples differ in about half of their bits.   [Steele2014] "Fast Splittable
/// Pseudorandom Number Generators"
inline constexpr std::uint64_t golden_gamma = 0x9e3779b97f4a7c15ull;

/// Bits of a name of at most eight characters, as a salt.
constexpr std::uint64_t salt(std::string_view name) {
    std::uint64_t bits = 0;
    for (const char c : name) bits = bits << 8 | static_cast<unsigned char>(c);
    return bits;
}

/// Seed of stream n of a seed.
constexpr std::uint64_t numbered(std::uint64_t seed, std::uint64_t n) {
    return mix64(seed ^ n * golden_gamma);
}

// Residual.

/// Paths of a residual. They differ from those of an image of equal --seed, to which a residual is added.
constexpr std::uint64_t residual(std::uint64_t seed) {
    return mix64(seed ^ salt("residual"));
}
/// Paths of the new scene that must be independent of those of the old one.
/// in:      old_scene  seed of the old scene's paths
constexpr std::uint64_t independent_of(std::uint64_t old_scene) {
    return mix64(old_scene);
}
/// Samples of a pass whose number of samples is not known beforehand.
/// in:      first_sample  index of the first sample of the pass
constexpr std::uint64_t pass(std::uint64_t seed, std::uint64_t first_sample) {
    return numbered(seed, first_sample + 1);
}
/// Paths of a frame of an animation that is traced by itself.
constexpr std::uint64_t frame(std::uint64_t seed, std::uint64_t number) {
    return numbered(mix64(seed ^ salt("frame")), number + 1);
}
/// Camera rays that look for what an edit shows or hides.
constexpr std::uint64_t coverage(std::uint64_t seed) {
    return mix64(seed ^ salt("coverage"));
}
/// Camera rays for the emission that they find at their first hits.
constexpr std::uint64_t seen_emission(std::uint64_t seed) {
    return mix64(seed ^ salt("emission"));
}
/// Further pairs of paths where those of a residual differ much.
constexpr std::uint64_t extra(std::uint64_t seed) {
    return mix64(seed ^ salt("extra"));
}
/// Pilot of a pass.
constexpr std::uint64_t pilot(std::uint64_t pass_seed) {
    return mix64(pass_seed ^ salt("pilot"));
}
/// Paths that start from sites of one family.
constexpr std::uint64_t family(std::uint64_t pass_seed, std::uint64_t family_idx) {
    return numbered(pass_seed, family_idx + 1);
}
/// Edit k of a chain, from 1; the first uses the seed itself.
///   seed_k = seed XOR mix64(k - 1),  mix64(0) = 0
/// For one seed all streams are different, so that edits are independent and their variances add up. With equal streams
/// the residuals of consecutive edits would telescope:
///   [L_2(u) - L_1(u)] + [L_1(u) - L_0(u)] = L_2(u) - L_0(u)
/// An emitter that brightens twice by the same step would have twice the variance that the ledger states; one that
/// returns to its old value would have none. Passes of one edit share one seed.
constexpr std::uint64_t edit(std::uint64_t seed, std::uint64_t k) {
    return seed ^ mix64(k - 1);
}

// Radiance caches.

/// Choice of the vertices of a graph that are held back, as `selection` with this seed.
/// in:      graph_idx  of the graphs that a cache is made of
constexpr std::uint64_t held_back(std::uint64_t seed, std::uint64_t graph_idx) {
    return numbered(mix64(seed ^ salt("cache")), graph_idx + 1);
}
/// Choice of the vertices to train on where there are more than training samples, as `selection` with this seed.
constexpr std::uint64_t training_subset(std::uint64_t seed) {
    return mix64(seed ^ salt("subset"));
}
/// Step i of the shuffling of training samples.
constexpr std::uint64_t shuffle(std::uint64_t seed, std::uint64_t i) {
    return numbered(mix64(seed ^ salt("shuffle")), i);
}
/// Initial value of weight i of a network.
constexpr std::uint64_t weight(std::uint64_t seed, std::uint64_t i) {
    return numbered(mix64(seed ^ salt("network")), i);
}

// Clusters and gathering.

/// Rotations of the metric's position and normal axes, per pass.
constexpr std::uint64_t position_rotation(std::uint64_t seed) {
    return mix64(seed);
}
constexpr std::uint64_t normal_rotation(std::uint64_t seed) {
    return mix64(~seed);
}
/// Vertex i of the subset that defines the buckets.
constexpr std::uint64_t subset(std::uint64_t seed, std::uint64_t i) {
    return mix64(seed * golden_gamma + i);
}
/// Splits of one part (bucket or cell) of the points.
constexpr std::uint64_t part(std::uint64_t seed, std::uint64_t part_idx) {
    return mix64(seed + part_idx);
}
/// Uniform sample i in [0, 1) of a selection without replacement.
constexpr double selection(std::uint64_t seed, std::uint64_t i) {
    return double(mix64(seed * 0xd6e8feb86659fd93ull + i + 1) >> 11) * 0x1p-53;
}
/// Members from which a path gathers.
/// in:      first_sample  index of the first sample of the pass
constexpr std::uint64_t gather(std::uint64_t seed, std::uint64_t first_sample, std::uint64_t path_idx) {
    return mix64(numbered(seed, first_sample) ^ path_idx);
}
/// Next state of a sequence of 64-bit numbers.
constexpr std::uint64_t next(std::uint64_t state) {
    return mix64(state + golden_gamma);
}

}  // namespace streams
}  // namespace loom
