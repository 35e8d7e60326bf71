#pragma once
#include <array>
#include <cstdint>
#include <vector>

#include "stages/cluster/pool.h"
#include "stages/cluster/scratch.h"
#include "stages/core/math/vector.h"

namespace loom {
class RayEngine;
}

namespace loom::cluster {

/// Cells of a pool: runs of members, which are vertices of the pool.
struct Cells {
    std::vector<std::uint32_t> first, member;
};

/// What the tests read of a vertex, in one place: position, geometric normal on the side of wo, octahedral, and a key of
/// the media on its two sides.
struct PackedVertex {
    Point3f p;
    std::array<std::int16_t, 2> n;
    std::uint64_t media;
};
static_assert(sizeof(PackedVertex) == 24);

/// What was kept apart, in vertices.
struct Separation {
    bool tested_visibility = false;
    std::uint64_t n_rays = 0;
    std::uint64_t n_media = 0;      // cut off from their cell because of other media
    std::uint64_t n_same_path = 0;  // cut off because their path has another member in the cell
    std::uint64_t n_occluded = 0;   // cut off because a surface hides them from the middle of their cell
};

/// Cuts each cell into groups whose members may share light:
///   media      all have the same index of refraction on the side of wo, and transmissive ones across the surface too
///   path       none is of the path of another: where a path comes back, and how often, depends on what was sampled
///              before, and a sum over all its visits counts long paths too often. In a house of thin panes that
///              lost 2 % of the light
///   occlusion  each is visible from the middle member, the one closest to the centroid
/// Segments of the visibility test are raised along the geometric normals on the side of wo by a tenth of their length:
/// a wall lower than that casts little shade. Where the two members lie in parallel planes, by a quarter of the
/// distance of the planes if that is less, but by enough to clear a smooth convex surface.
/// What is cut off forms groups of its own by the same rule. Groups of a cell follow one another; members ascend.
/// in:   first, second  ray engines of the scenes of the pool's graphs; null: no visibility test
Separation separate(const Pool& pool, const RayEngine* first, const RayEngine* second, int threads,
                    Scratch<PackedVertex>& memory, Cells& cells);

}  // namespace loom::cluster
