#pragma once
// Pictures as a page carries them.

#include <cstdint>
#include <string>

#include "formats/image.h"

namespace loom::report {

/// Linear RGB as half floats, [y, x, rgb], little endian, in base64: the page does the exposure itself.
struct Pixels {
    std::size_t width = 0, height = 0;
    std::size_t factor = 1;       // each pixel is the mean of factor x factor
    std::uint64_t n_clipped = 0;  // values beyond what a half holds (65504), shown as that
    std::string data;
};

/// in:      longest_side  px; the factor is the smallest whole number that fits the picture into it
Pixels pixels_of(const Image& image, std::size_t longest_side);

}  // namespace loom::report
