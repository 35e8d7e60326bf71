#pragma once
// A signed layer of an image as a picture to look at.

#include <string_view>

#include "formats/image.h"

namespace loom {

/// Luminance of a layer of an image in false colours: blue below 0, white at 0, red above; beyond +-reach in the
/// full colour, NaN black. Small pictures are magnified by a whole number. Below lies the legend, -reach … reach.
/// in:      reach  0: the 99th percentile of the absolute values, in two digits
/// out:     a picture for write_png
Image false_colours(const Image& image, std::string_view layer, double reach);

}  // namespace loom
