#pragma once
#include "formats/image.h"

namespace loom::testing {

/// Returns a handmade image of 4 x 3 pixels with all layers.
Image tiny_image();
/// Returns an image with two edits added to it.
Image tiny_sum();

/// Returns a residual with the layers of its parts.
Image tiny_residual();

/// Expects equal sizes, samples, provenance and channels (in any order), bit for bit.
void expect_equal(const Image& a, const Image& b);

}  // namespace loom::testing
