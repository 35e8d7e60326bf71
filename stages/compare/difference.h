#pragma once
// The difference of two images as layers of an image.

#include <span>

#include "formats/image.h"
#include "stages/compare/significance.h"

namespace loom::compare {

/// Returns the difference as layers of an image:
///   R, G, B       x - r
///   Relative.RGB  (x - r) / sqrt(r^2 + 0.01); its mean square is the relMSE
///   Tile.RGB      mean of x - r over the pixel's tile (8 x 8 tiles)
///   TileZ.RGB     that mean over its standard error; omitted where the error is unknown
/// in:      x, r  [y, x, rgb]
Image difference_image(std::span<const float> x, std::span<const float> r, std::size_t width, std::size_t height,
                       const Significance& significance);

}  // namespace loom::compare
