#pragma once
#include <cstdint>
#include <span>

namespace loom::denoise {

/// Input of a denoiser: columns [y, x] of one image. A layer that the image does not have is empty.
struct Layers {
    std::uint32_t width = 0, height = 0;
    std::span<const float> color[3];     // R, G, B; finite, of any sign
    std::span<const float> var_mean[3];  // variance of color; finite, not negative
    std::span<const float> albedo[3], normal[3], depth;

    std::size_t n_pixels() const { return std::size_t{width} * height; }
};

}  // namespace loom::denoise
