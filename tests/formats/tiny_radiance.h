#pragma once
#include "formats/radiance.h"

namespace loom::testing {

/// Returns radiance of the six vertices and four paths of tiny_graph(), refined with tiny_clusters().
Radiance tiny_radiance();

}  // namespace loom::testing
