#pragma once
#include <cstdint>
#include <span>

#include "stages/cluster/metric.h"

namespace loom::cluster {

/// Finds for each point the index of the nearest centre, exactly, by a k-d tree over the centres (FLANN). Fast when
/// consecutive points are close together: a query then reuses the cache lines of the previous one.
/// in:      dimensions  3 (positions alone) or 6
/// out:     nearest     uint32[points]
/// needs:   at least one centre
void nearest_centres(std::span<const Point> points, std::span<const Point> centres, int dimensions, int threads,
                     std::span<std::uint32_t> nearest);

}  // namespace loom::cluster
