#pragma once
// Which paths of a graph the edit of its scene touches, and where first.

#include <cstdint>
#include <span>
#include <vector>

#include "stages/core/edit/edit_reach.h"
#include "stages/residual/stored/candidate_paths.h"
#include "stages/residual/stored/stored_paths.h"

namespace loom::residual {

/// What an edit may change of a path, a little on the safe side.
struct PathChange {
    static constexpr std::uint32_t never = ~0u;
    std::size_t path = 0, edge = 0;  // of the graph; first light edge of it, or of a later one
    // number within the path, from 0, of the first vertex whose ray may be another; n: the ray that left the last of n
    // and found no vertex
    std::uint32_t cut = never;
    bool repainted = false;     // a vertex before that lies on EditReach::repainted
    std::uint32_t n_again = 0;  // vertices before that whose light sample may be another, or be answered otherwise
};

/// Those of many paths, in order.
struct PathChanges {
    std::vector<PathChange> paths;
    std::vector<std::uint32_t> again;  // rows of vertices, n_again for each path
    void clear() {
        paths.clear();
        again.clear();
    }
};

/// Looks for paths that may be others, or worth something else, in the new scene with the same random numbers. [METHODS
/// 2.3]
///
/// A path is the same to the last bit if no vertex lies on what the edit changed, no light that it sampled is changed,
/// and every ray answers as before: those that went through (to the next vertex, to a light, out of the scene) if
/// nothing stands in their way at its new place; those that did not (shadow rays) if nothing stood in their way at its
/// old place, for then what blocked them is still there. Most rays can be read off the graph. What it does not keep is
/// drawn once more by the path's own random numbers: light samples that failed, directions of rays that found nothing,
/// camera rays that escaped. A ray that leads to what the edit changed counts as one that may be another.
/// One belongs to one thread.
class TouchedPaths {
  public:
    TouchedPaths(const StoredPaths& paths, const EditReach& reach);

    /// in:      begin, end   paths of the graph, one sample number of pixels in a row
    /// out:     touched      by path, 1: the edit may change it, 0: it does not
    ///          changes      of those that it may change; others are added to
    void find(std::size_t begin, std::size_t end, std::uint8_t* touched, PathChanges& changes);

  private:
    /// Rays of a block that wait for an answer, and what becomes another if they meet something.
    struct Asked {
        std::uint32_t path,
            vertex;    // from the begin of the block; for an arriving ray the vertex's number within the path
        bool arrives;  // else it is a shadow ray
    };
    struct Queue {
        std::vector<Ray> rays;
        std::vector<Asked> asked;
        void add(const Ray& ray, const Asked& what) {
            rays.push_back(ray);
            asked.push_back(what);
        }
    };
    /// A light sample that was not seen: off the graph, or drawn once more.
    struct FailedLight {
        std::uint16_t emitter;
        Point3f y;                // or the direction towards it
        bool at_infinity, asked;  // asked: a shadow ray may have been
    };
    /// Of a vertex at p.
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
    // Of a vertex at p:
    void look_at_arriving_ray(const Rows& of, std::size_t vertex, const Point3f& p);
    void look_at_light_ray(const Rows& of, std::size_t edge, const Point3f& p);
    void look_at_failed_light(std::size_t path, std::size_t vertex);
    void look_at_last_ray(const Rows& of, const Point3f& p, bool hit_found);
    void answer(Queue& queue, const Obstacles& obstacles);
    /// The ray to a vertex may be another.
    void cut(std::uint32_t path, std::uint32_t number) {
        cuts_[path] = std::min(cuts_[path], number);
        touched_[path] = 1;
    }
    /// So may the light sample of a vertex.
    void sample_again(std::uint32_t path, std::uint32_t vertex) {
        again_[vertex] = 1;
        touched_[path] = 1;
    }

    const StoredPaths& paths_;
    const EditReach& reach_;
    CandidatePaths candidates_;
    Queue through_, blocked_;  // rays that went through, and those that did not
    std::vector<const Ray*> pointers_;
    // Of a block of paths: its begin; by path
    std::size_t begin_ = 0, first_vertex_ = 0, next_edge_ = 0;
    std::uint8_t* touched_ = nullptr;
    std::vector<std::uint32_t> cuts_;
    std::vector<std::size_t> edges_;
    std::vector<std::uint8_t> repainted_;
    std::vector<std::uint8_t> again_;  // by vertex
};

}  // namespace loom::residual
