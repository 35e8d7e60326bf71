#pragma once
// Images of an animation as a strip, single frames and a movie.

#include <filesystem>

#include "stages/frames/frames.h"

namespace loom::frames {

/// Whether the input is images, not a cube.
bool is_images(const Options& options);

/// Draws the images in their order into a strip and what lies beside it, all with one exposure: white is the median over the images of the luminance that
/// --quantile of their lit pixels do not exceed, times 2^-exposure.
/// throws:  InputError for an option of cubes, and for an image of another size than the first
void draw_images(const Options& options, const std::filesystem::path& strip, app::Report& report);

}  // namespace loom::frames
