#pragma once
// The residual as the difference of two parts: of the paths of the new scene and of those of the old scene that the edit
// touches.
//   L_new - L_old = L_plus - L_minus                                                              [HY] Eq. (1) to (6)

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "formats/image.h"
#include "stages/core/edit/edit_reach.h"
#include "stages/core/edit/scene_pair.h"
#include "stages/core/tracing/graph_builder.h"
#include "stages/residual/stored/path_terms.h"

namespace loom::residual {

/// Parts of what the two paths of a pair bring.
struct Parts {
    Spectrum plus, minus;
};

/// Divides two paths with the same random numbers, one of each scene, into what they have in common and the rest.
///
/// A path is touched from its first vertex on that lies on a changed shape, or that the path of the other scene does not
/// have: the other scene's shape is in the way there. All that a touched path gains belongs to its part. Before that, a
/// light sample belongs to the part of its scene alone where its emitter is changed or where the other scene's shadow ray
/// is occluded; a shadow ray that crosses a changed shape does not make the path behind it touched.   [HY] algorithms 1, 2
/// differs: where the choice among lights has other probabilities, light samples of all vertices are in both parts
class PathParts {
  public:
    PathParts(const EditReach& reach, const Edit& edit) : reach_(reach), edit_(edit) {}

    /// in:      edge, new_edge  first light edge of each path, or that of a later path
    ///          sampler         of both paths
    Parts of(const StoredPaths& old_paths, std::size_t old_path, std::size_t old_edge, const StoredPaths& new_paths,
             std::size_t new_path, std::size_t new_edge, const Sampler& sampler) const;

  private:
    bool same_vertex(const PathGraph& before, std::size_t i, const PathGraph& after, std::size_t j) const;
    bool same_edge(const PathGraph& before, std::size_t i, const PathGraph& after, std::size_t j) const;
    bool same_emitter(std::size_t before, std::size_t after) const {
        return edit_.new_emitters[after].partner_idx == before && !edit_.new_emitters[after].changed;
    }

    const EditReach& reach_;
    const Edit& edit_;
};

/// Sums of the parts of an image; a pixel belongs to one thread, and its pairs come in the order of the samples.
class PartSums {
  public:
    PartSums(const ScenePair& scenes, const EditReach& reach, const Edit& edit)
        : finder_(reach, edit), sums_(scenes.new_scene.sensor.n_pixels()) {}

    const PathParts& finder() const { return finder_; }
    void add(std::uint64_t pixel, const Parts& parts) {
        for (int c = 0; c < 3; ++c) {
            sums_[pixel].plus[std::size_t(c)] += double(parts.plus[c]);
            sums_[pixel].minus[std::size_t(c)] += double(parts.minus[c]);
        }
    }
    /// Adds the layers Plus and Minus, means over the samples, to a residual.
    void write(Image& residual, std::uint64_t samples) const;

  private:
    struct Sums {
        std::array<double, 3> plus{}, minus{};
    };
    PathParts finder_;
    std::vector<Sums> sums_;
};

/// Traces paths of one scene in batches and keeps them as a graph. State of one thread.
class RecordedPaths {
  public:
    RecordedPaths(const Scene& scene, const PathOptions& path)
        : path_(path),
          batch_(scene, path),
          graph_(scene, path, {}),
          reader_(graph_.graph()),
          paths_(scene, reader_, path) {}
    RecordedPaths(const RecordedPaths&) = delete;

    /// in:      ids, at most PathBatch::capacity
    /// out:     their paths in this order, until the next call; results of the same length
    const StoredPaths& trace(std::span<const PathId> ids, std::span<PathResult> results);
    /// Returns the first light edge of a path of the batch.
    std::size_t first_edge(std::size_t path) const;

  private:
    PathOptions path_;
    PathBatch batch_;
    PathRecords records_;
    BatchGraph graph_;
    GraphReader reader_;
    StoredPaths paths_;
};

}  // namespace loom::residual
