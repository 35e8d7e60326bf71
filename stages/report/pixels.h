#pragma once
// Encodes images for a page.

#include <cstdint>
#include <string>

#include "formats/image.h"

namespace loom::report {

/// Linear RGB as half floats, [y, x, rgb], little-endian, in base64; the page applies the exposure.
struct Pixels {
    std::size_t width = 0, height = 0;
    std::size_t factor = 1;       // each pixel is the mean of factor x factor pixels
    std::uint64_t n_clipped = 0;  // values beyond the largest half (65504), clamped to it
    std::string data;
};

/// in:      longest_side  px; the factor is the smallest integer that fits the image into it
Pixels pixels_of(const Image& image, std::size_t longest_side);

}  // namespace loom::report
