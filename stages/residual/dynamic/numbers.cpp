#include "stages/residual/dynamic/numbers.h"

namespace loom::residual {

Numbers NumbersBlock::of(SamplerKind kind, std::uint64_t seed, std::uint64_t index) {
    if (samplers_.empty() || kind != kind_ || seed != seed_ || index < first_ || index >= first_ + size) {
        kind_ = kind;
        seed_ = seed;
        first_ = index;
        samplers_.clear();
        std::uint32_t key_lo[size], key_hi[size], indices[size];
        for (std::uint32_t i = 0; i < size; ++i) {
            samplers_.emplace_back(kind, seed, 0, index + i);
            key_lo[i] = samplers_[i].key_lo();
            key_hi[i] = samplers_[i].key_hi();
            indices[i] = samplers_[i].index();
        }
        known_.resize(std::size_t(n_known) * size);
        float x[size], y[size];
        for (std::uint32_t dimension = 0; dimension < n_known; ++dimension) {
            sampler_pairs(kind, key_lo, key_hi, indices, dimension, size, x, y);
            for (std::uint32_t i = 0; i < size; ++i) known_[std::size_t(dimension) * size + i] = {x[i], y[i]};
        }
    }
    const auto i = std::uint32_t(index - first_);
    return {samplers_[i], known_.data() + i, n_known, size};
}

}  // namespace loom::residual
