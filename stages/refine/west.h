#pragma once
#include "stages/refine/system.h"

namespace loom::refine {

struct Filtered {
    HugeArray<Light> L, direct;  // [vertex]
};

/// Aggregates the paths' own estimates once over the nearest neighbours of each vertex, O(K^2) densities per vertex.
/// Nothing is propagated. This is the baseline for path graphs.     [West2020]
/// in:    members     vertices that share; the others keep their values
///        neighbours  K, the vertex itself included; nearest by position
Filtered west_filter(const PathGraph& graph, std::span<const std::uint32_t> members, std::uint32_t neighbours,
                     const SharingOptions& sharing, int threads);

}  // namespace loom::refine
