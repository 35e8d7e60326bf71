#pragma once
#include "formats/clusters.h"

namespace loom::testing {

/// Returns three clusters over five of the six vertices of tiny_graph(); vertex 4 is solitary.
Clusters tiny_clusters();

}  // namespace loom::testing
