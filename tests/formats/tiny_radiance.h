#pragma once
#include "formats/radiance.h"

namespace loom::testing {

/// Radiance of the six vertices and four paths of tiny_graph(), refined with tiny_clusters().
Radiance tiny_radiance();

}  // namespace loom::testing
