#pragma once
// Paths of a graph that the edit of its scene touches, and the first change of each.

#include <cstdint>
#include <span>
#include <vector>

#include "stages/core/edit/edit_reach.h"
#include "stages/residual/stored/candidate_paths.h"
#include "stages/residual/stored/stored_paths.h"

namespace loom::residual {

/// Changes of a path that an edit may cause, on the safe side.
struct PathChange {
    static constexpr std::uint32_t never = ~0u;
    std::size_t path = 0, edge = 0;  // path of the graph; its first light edge, or that of a later path
    // Index in the path, from 0, of the first vertex whose ray may differ. n: the ray that left the last of n vertices
    // and found none
    std::uint32_t cut = never;
    bool repainted = false;     // an earlier vertex lies on EditReach::repainted
    bool sky = false;           // its last ray leaves the scene, towards another sky
    std::uint32_t n_again = 0;  // earlier vertices whose light sample or its visibility may differ
};

/// Changes of many paths, in order.
struct PathChanges {
    std::vector<PathChange> paths;
    std::vector<std::uint32_t> again;  // rows of vertices, n_again for each path
    void clear() {
        paths.clear();
        again.clear();
    }
};

/// Finds paths that may differ, or contribute differently, in the new scene with the same random stream. [METHODS 2.3]
///
/// A path is equal to the last bit if three conditions hold. No vertex lies on a changed surface. No light that it
/// sampled is changed. Every ray has the same result.
///   unoccluded rays (to the next vertex, a light, out of the scene) if no changed shape blocks them at its new place
///   occluded shadow rays if no changed shape blocked them at its old place: their occluder is then still there
/// Most rays follow from the graph. The rest is drawn again with the path's own random stream: failed light samples,
/// directions of rays that escaped, escaped camera rays. A ray that leads to a changed surface counts as one that may
/// differ.
/// State of one thread.
class TouchedPaths {
  public:
    TouchedPaths(const StoredPaths& paths, const EditReach& reach);

    /// in:      begin, end   paths of the graph; consecutive pixels of one sample index
    /// out:     touched      [path] 1: the edit may change it, 0: it does not
    ///          changes      of the paths that it may change; appended
    void find(std::size_t begin, std::size_t end, std::uint8_t* touched, PathChanges& changes);

  private:
    /// Rays of a block that wait for their test, and what may differ if they hit something.
    struct Asked {
        std::uint32_t path,
            vertex;    // from the begin of the block; for an arriving ray the vertex's number within the path
        bool arrives;  // else a shadow ray
    };
    struct Queue {
        std::vector<Ray> rays;
        std::vector<Asked> asked;
        void add(const Ray& ray, const Asked& what) {
            rays.push_back(ray);
            asked.push_back(what);
        }
    };
    /// A light sample that was not visible: from the graph, or drawn again.
    struct FailedLight {
        std::uint16_t emitter;
        Point3f y;                // or the direction towards it
        bool at_infinity, asked;  // asked: a shadow ray may have been traced
    };
    /// Returns the failed light sample of a vertex at p.
    FailedLight failed_light(std::size_t path, std::size_t vertex, const Point3f& p) const;
    /// A path and its rows: vertices [first, last), light edges [edges, next_edge_).
    struct Rows {
        std::size_t path, first, last, edges;
        std::uint32_t in_block;
    };
    void look_at(std::size_t path);
    void look_at_camera_ray(const Rows& of);
    void look_at_shapes(const Rows& of);
    void look_at_lights(const Rows& of);
    void look_at_rays(const Rows& of);
    // Test the rays of a vertex at p.
    void look_at_arriving_ray(const Rows& of, std::size_t vertex, const Point3f& p);
    void look_at_light_ray(const Rows& of, std::size_t edge, const Point3f& p);
    void look_at_failed_light(std::size_t path, std::size_t vertex);
    void look_at_last_ray(const Rows& of, const Point3f& p, bool hit_found);
    void see_other_sky(std::uint32_t path) { other_sky_[path] = touched_[path] = 1; }
    void answer(Queue& queue, const Obstacles& obstacles);
    /// Marks that the ray to a vertex may differ.
    void cut(std::uint32_t path, std::uint32_t number) {
        cuts_[path] = std::min(cuts_[path], number);
        touched_[path] = 1;
    }
    /// Marks that the light sample of a vertex may differ.
    void sample_again(std::uint32_t path, std::uint32_t vertex) {
        again_[vertex] = 1;
        touched_[path] = 1;
    }

    const StoredPaths& paths_;
    const EditReach& reach_;
    CandidatePaths candidates_;
    Queue through_, blocked_;  // unoccluded rays, and occluded ones
    std::vector<const Ray*> pointers_;
    // State of a block of paths: its begin; then arrays, [path].
    std::size_t begin_ = 0, first_vertex_ = 0, next_edge_ = 0;
    std::uint8_t* touched_ = nullptr;
    std::vector<std::uint32_t> cuts_;
    std::vector<std::size_t> edges_;
    std::vector<std::uint8_t> repainted_, other_sky_;
    std::vector<std::uint8_t> again_;  // [vertex]
};

}  // namespace loom::residual
