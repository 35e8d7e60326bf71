#pragma once
// Displays a signed layer of an image in false colours.

#include <array>
#include <string_view>

#include "formats/image.h"

namespace loom {

/// Maps t in [-1, 1] to the linear RGB of the signed colour map: blue below 0, white at 0, red above; black for NaN.
std::array<float, 3> signed_colour(double t);

/// Maps the luminance of a layer to false colours: blue below 0, white at 0, red above; full colour beyond +-reach,
/// black for NaN. Small images are magnified by a whole number. The legend -reach … reach is at the bottom.
/// in:      reach  0: the 99th percentile of the absolute values, rounded to two digits
/// out:     an image for write_png
Image false_colours(const Image& image, std::string_view layer, double reach);

}  // namespace loom
