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

/// Numbers of separated vertices.
struct Separation {
    bool tested_visibility = false;
    std::uint64_t n_rays = 0;
    std::uint64_t n_media = 0;      // separated from their cell because of another medium
    std::uint64_t n_same_path = 0;  // separated because their path has another member in the cell
    std::uint64_t n_occluded = 0;   // separated because a surface occludes them from the middle of their cell

    Separation& operator+=(const Separation& other) {
        n_rays += other.n_rays, n_media += other.n_media;
        n_same_path += other.n_same_path, n_occluded += other.n_occluded;
        return *this;
    }
};

/// Cuts cells into groups whose members may share light:
///   media      all have the same index of refraction on the side of wo; transmissive ones also across the surface
///   path       no two belong to one path. Where and how often a path returns depends on its earlier samples, so a sum
///              over all its visits overcounts long paths. In a house of thin panes this lost 2 % of the light.
///   occlusion  each is visible from the middle member, the one closest to the centroid
/// Segments of the visibility test are raised along the geometric normals on the side of wo. The rise is a tenth of
/// their length; a wall lower than that casts little shadow. For members in parallel planes it is at most a quarter of
/// the planes' distance, but enough to clear a smooth convex surface.
/// Separated vertices form groups of their own by the same rule.
class Separator {
  public:
    /// in:   first, second  ray engines of the scenes of the pool's graphs; null: no visibility test
    ///       memory         must outlive the separator
    /// Borrows the pool and the metric.
    Separator(const Pool& pool, const Metric& metric, const RayEngine* first, const RayEngine* second, int threads,
              Scratch<std::uint64_t>& memory);

    /// in/out:  points  cell after cell, each ascending by vertex; afterwards group after group, each ascending
    ///          sizes   sizes of the cells; afterwards of the groups, those of one cell consecutively
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
    std::span<std::uint64_t> media_;     // [vertex] key of the medium; empty: vacuum only
    std::vector<std::uint64_t> starts_;  // one bit per vertex: a path begins there
    std::uint32_t longest_ = 0;          // longest path, in vertices
};

}  // namespace loom::cluster
