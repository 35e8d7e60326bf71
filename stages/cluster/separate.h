#pragma once
#include <cstdint>
#include <span>
#include <vector>

#include "stages/cluster/metric.h"
#include "stages/cluster/pool.h"
#include "stages/cluster/scratch.h"

namespace loom {
class RayEngine;
}

namespace loom::cluster {

/// What was kept apart, in vertices.
struct Separation {
    bool tested_visibility = false;
    std::uint64_t n_rays = 0;
    std::uint64_t n_media = 0;      // cut off from their cell because of other media
    std::uint64_t n_same_path = 0;  // cut off because their path has another member in the cell
    std::uint64_t n_occluded = 0;   // cut off because a surface hides them from the middle of their cell

    Separation& operator+=(const Separation& other) {
        n_rays += other.n_rays, n_media += other.n_media;
        n_same_path += other.n_same_path, n_occluded += other.n_occluded;
        return *this;
    }
};

/// Cuts cells into groups whose members may share light:
///   media      all have the same index of refraction on the side of wo, and transmissive ones across the surface too
///   path       none is of the path of another: where a path comes back, and how often, depends on what was sampled
///              before, and a sum over all its visits counts long paths too often. In a house of thin panes that
///              lost 2 % of the light
///   occlusion  each is visible from the middle member, the one closest to the centroid
/// Segments of the visibility test are raised along the geometric normals on the side of wo by a tenth of their length:
/// a wall lower than that casts little shade. Where the two members lie in parallel planes, by a quarter of the
/// distance of the planes if that is less, but by enough to clear a smooth convex surface.
/// What is cut off forms groups of its own by the same rule.
class Separator {
  public:
    /// in:   first, second  ray engines of the scenes of the pool's graphs; null: no visibility test
    ///       memory         for as long as the separator lives
    /// The pool and the metric are borrowed.
    Separator(const Pool& pool, const Metric& metric, const RayEngine* first, const RayEngine* second, int threads,
              Scratch<std::uint64_t>& memory);

    /// in/out:  points  cell after cell, in each ascending by vertex; so they are afterwards in each group
    ///          sizes   of the cells; then of the groups, those of a cell one after the other
    void cut(std::span<Point> points, std::vector<std::uint32_t>& sizes, Separation& count) const;

  private:
    struct Group;
    void keep_one_medium(Group& group, Separation& count) const;
    void keep_one_of_each_path(Group& group, Separation& count) const;
    void keep_visible(Group& group, Separation& count) const;
    bool one_path(std::uint32_t a, std::uint32_t b) const;

    const Metric& metric_;
    std::size_t n_first_;
    const RayEngine* engines_[2];
    std::span<std::uint64_t> media_;     // by vertex, a key; empty: no media but vacuum
    std::vector<std::uint64_t> starts_;  // bits of vertices: where a path begins
    std::uint32_t longest_ = 0;          // path, in vertices
};

}  // namespace loom::cluster
