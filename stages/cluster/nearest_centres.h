#pragma once
#include <cstdint>
#include <span>

#include "stages/cluster/metric.h"

namespace loom::cluster {

/// For each point the row of the nearest centre, exactly: a k-d tree over the centres (FLANN).
/// Fast when neighbouring points lie close together: a query then walks what the one before has left in the cache.
/// in:      dimensions  3 (positions alone) or 6
/// out:     nearest     uint32[points]
/// needs:   at least one centre
void nearest_centres(std::span<const Point> points, std::span<const Point> centres, int dimensions, int threads,
                     std::span<std::uint32_t> nearest);

}  // namespace loom::cluster
