#pragma once
// Pictures of a difference: numbers as an EXR, false colours with a legend as a PNG.

#include <filesystem>
#include <span>
#include <string>

#include "formats/image.h"
#include "stages/compare/significance.h"

namespace loom::compare {

/// The difference as layers of an image:
///   R, G, B       x - r
///   Relative.RGB  (x - r) / sqrt(r^2 + 0.01); its mean square is the relMSE
///   Tile.RGB      mean of x - r over the pixel's tile (8 x 8 of them)
///   TileZ.RGB     that over its standard error; left out where nothing is known of it
/// in:      x, r  [y, x, rgb]
Image difference_image(std::span<const float> x, std::span<const float> r, std::size_t width, std::size_t height,
                       const Significance& significance);

/// Luminance of a layer of an image in false colours: blue below 0, white at 0, red above; beyond +-reach in the
/// full colour, NaN black. Small pictures are magnified by a whole number. Below lies the legend, -reach … reach.
/// in:      reach  0: the 99th percentile of the absolute values, in two digits
/// out:     a picture for write_png
Image false_colours(const Image& image, std::string_view layer, double reach);

}  // namespace loom::compare
