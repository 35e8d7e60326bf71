#pragma once
// Which paths of a graph the edit of its scene touches.

#include <cstdint>
#include <vector>

#include "stages/core/transport/graph_reader.h"
#include "stages/core/transport/path_tracer.h"
#include "stages/residual/candidate_paths.h"
#include "stages/residual/edit_reach.h"

namespace loom::residual {

/// What the graph knows of a path.
struct KnownPath {
    FirstHit first;  // of one that is not touched: what the tracer has said of its first surface, depth but for rounding
    Spectrum L;      // of one that is touched: what it has brought, to the last bit
};

/// Looks for paths that may be others, or worth something else, in the new scene with the same random numbers. [METHODS 2.3]
///
/// A path is the same to the last bit if no vertex lies on what the edit changed, no light that it sampled is changed, and
/// every ray answers as before: those that went through (to the next vertex, to a light, out of the scene) if nothing stands
/// in their way at its new place; those that did not (shadow rays) if nothing stood in their way at its old place, for then
/// what blocked them is still there. Most rays can be read off the graph. What it does not keep is drawn once more by the
/// path's own random numbers: light samples that failed, directions of rays that found nothing, camera rays that escaped.
/// One belongs to one thread.
class TouchedPaths {
  public:
    /// in:      options   with which the graph was traced in the old scene
    TouchedPaths(const Scene& old_scene, const EditReach& reach, const GraphReader& reader, const PathOptions& options);

    /// in:      begin, end   paths of the graph, one sample number of pixels in a row
    /// out:     touched      by path, 1: the edit may change it (with a little on the safe side), 0: it does not
    ///          known        by path, what its next use asks for
    void find(std::size_t begin, std::size_t end, std::uint8_t* touched, KnownPath* known);

  private:
    /// Rays of a block that wait for an answer.
    struct Queue {
        std::vector<Ray> rays;
        std::vector<std::uint32_t> paths;  // from the begin of the block
    };
    /// True: touched, whatever the rays say.
    bool touches(std::size_t path, std::size_t begin);
    FirstHit first_hit(std::size_t path);
    /// The tracer's own sum, without its rays: lights that were seen are in the graph, BSDFs are asked once more.
    /// in:  edge  first light edge of the path
    Spectrum light(std::size_t path, std::size_t edge) const;
    /// What the tracer has drawn at a vertex.
    BsdfSample<float> redraw(const ShadingPoint& here, std::size_t path, std::size_t vertex) const;
    bool vertex_touches(std::size_t path, std::size_t vertex, bool light_found, std::uint32_t in_block);
    void ask(Queue& queue, const Ray& ray, std::uint32_t in_block) {
        queue.rays.push_back(ray);
        queue.paths.push_back(in_block);
    }
    void answer(Queue& queue, const Obstacles& obstacles, std::uint8_t* touched);
    Sampler sampler_of(std::size_t path) const;
    Point3f camera_of(std::size_t path) const;
    Point3f position(std::size_t vertex) const;
    Vector3f arrival(std::size_t vertex) const;  // direction of the ray that found it
    Ray sampled_ray(std::size_t path, std::size_t vertex) const;  // from a vertex along its BSDF sample

    const Scene& scene_;
    const EditReach& reach_;
    CandidatePaths candidates_;
    const GraphReader& reader_;
    PathOptions options_;
    std::size_t next_edge_ = 0;  // light edge of the next path
    Queue through_, blocked_;    // rays that went through, and those that did not
    std::vector<const Ray*> pointers_;
    std::vector<std::size_t> edges_;  // first light edge, by path of the block
    std::vector<Spectrum> matte_;     // albedo by material and side, of matte ones without texture
    std::int16_t last_code_[2] = {0, 0};  // of a normal, and that normal: neighbours lie on one surface
    Normal3f last_normal_{0, 0, 1};
};

}  // namespace loom::residual
