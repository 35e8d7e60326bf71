#pragma once
#include "formats/image.h"

namespace loom::testing {

/// A picture of 4 x 3 pixels with all layers, made by hand.
Image tiny_image();
/// A picture that two edits were added to.
Image tiny_sum();

/// Equal sizes, samples, provenance and channels (in any order), bit for bit.
void expect_equal(const Image& a, const Image& b);

}  // namespace loom::testing
