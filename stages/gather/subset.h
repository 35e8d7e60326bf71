#pragma once
// Light at a first hit from its own samples and those of a few other members of its cluster, drawn anew for each path.
// It lies between K = 1, where neighbouring pixels share nothing, and the whole cluster, where they share all.

#include <cstdint>
#include <vector>

#include "formats/clusters.h"
#include "formats/radiance.h"
#include "stages/core/clusters/cluster_edges.h"

namespace loom {
struct Scene;
}

namespace loom::gather {

struct SubsetOptions {
    std::uint32_t members = 4;        // besides the vertex itself
    Reuse reuse = Reuse::directions;  // of a continuation, without rays
    const Scene* scene = nullptr;     // if set, continuations are reconnected and tested by occlusion rays
    std::uint64_t seed = 0;
};

/// Estimates the light at vertex c with a random subset S of M other members.
///   no rays   sum over k in S + c of f_c cos_c X(y_k) / sum_m p_m(y_k): the cluster's estimate, on a smaller cluster
///   rays      pairwise: each member against the vertex's own sample,                       [Bitterli2022]
///                 sum over i in S of f_c cos_c G_c V_c(y_i) X(y_i) / (M p_i(y_i) + p_c(y_i))
///               + f_c cos_c G_c X(y_c) / M sum over i in S of 1 / (M p_i(y_c) V_i(y_c) + p_c(y_c))
///             densities per area of the continuation's surface
///
/// A sample's density is 0 where the point is occluded from its vertex, so every density includes V, not only f_c. With
/// V_c alone the weights of point y sum to sum_k p_k V_k / sum_m p_m. That is below 1 wherever a point visible from c
/// is occluded from some member, and shadows spread. The balance heuristic would need M (M + 1) rays; pairwise weights
/// need 2 M and sum to 1 too. The mean is therefore that of K = 1, whose X it uses, as far as light from the
/// continuation is the same in all directions.
class SubsetGather {
  public:
    struct Light {
        Spectrum direct, indirect;
    };

    /// Borrows the graph of `reader`, clusters, radiance and scene.
    SubsetGather(const GraphReader& reader, const Clusters& clusters, const Radiance& radiance,
                 const SubsetOptions& options);

    /// State of one thread.
    class Worker {
      public:
        explicit Worker(const SubsetGather& gather) : gather_(gather), shading_(gather.reader_) {}
        /// Returns the light at the first vertex of a path.
        /// in:      own  estimate of the vertex's own samples; used alone for a solitary vertex and for continuations
        ///          of delta lobes
        /// needs:   `first` the first vertex of the path
        Light at(std::size_t path, std::uint32_t first, const Light& own, bool direct, bool indirect);
        std::uint64_t rays() const { return rays_; }

      private:
        Spectrum shared();
        Spectrum reconnected(std::uint32_t first);
        int own_lane() const;

        const SubsetGather& gather_;
        ClusterShading shading_;
        std::vector<std::uint32_t> members_;  // the vertex itself, then the others
        std::uint32_t first_ = 0;
        std::uint64_t rays_ = 0;
    };

  private:
    void choose(std::size_t path, std::uint32_t first, std::vector<std::uint32_t>& members) const;

    const GraphReader& reader_;
    const Clusters& clusters_;
    const Radiance& radiance_;
    SubsetOptions options_;
    std::vector<std::uint32_t> cluster_;  // [path] cluster of the first vertex
    std::vector<std::uint32_t> light_edges_;
};

}  // namespace loom::gather
