#pragma once
#include "formats/radiance_cache.h"

namespace loom::testing {

/// Returns a cache of three points.
RadianceCache tiny_point_cache();
/// Returns a cache of two levels of features and two layers.
RadianceCache tiny_grid_cache();

}  // namespace loom::testing
