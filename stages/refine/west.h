#pragma once
#include "stages/refine/system.h"

namespace loom::refine {

struct Filtered {
    HugeArray<Light> L, direct;  // by vertex
};

/// One aggregation over the nearest neighbours of each vertex, O(K^2) densities per vertex, of what the paths
/// themselves know; nothing is propagated. The baseline that path graphs are measured against.     [West2020]
/// in:    members     vertices that share; the others keep what they have
///        neighbours  K, the vertex itself included; nearest by position
Filtered west_filter(const PathGraph& graph, std::span<const std::uint32_t> members, std::uint32_t neighbours,
                     const SharingOptions& sharing, int threads);

}  // namespace loom::refine
