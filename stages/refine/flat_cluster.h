#pragma once
#include <span>

#include "stages/core/clusters/cluster_rows.h"
#include "stages/refine/flat_columns.h"

namespace loom::refine {

/// The vertices of a flat diffuse cluster (flat_columns.h). Reused from cluster to cluster.
class FlatCluster {
  public:
    explicit FlatCluster(const GraphReader& reader) : reader_(reader), kernels_(flat_kernels()) {}

    /// Loads a cluster; lanes are in the order of the rows. Returns false when this is no flat diffuse cluster.
    /// needs:   at most max_lanes rows
    bool load(std::span<const VertexRow> rows);

    int size() const { return columns_.n; }
    const VertexRow& row(int lane) const { return rows_[std::size_t(lane)]; }
    const Spectrum& albedo(int lane) const { return albedo_[lane]; }
    const Normal3f& normal() const { return columns_.normal; }
    /// Survival of roulette in a lane; 0 where no BSDF sample was drawn.
    float survival(int lane) const { return columns_.survival[lane]; }

    /// Gathers the light edges of all vertices.
    /// in:      place  of the first lane
    void gather_lights(const ClusterRows& rows, std::size_t place);
    // After gather_lights(): light that a lane reflects, pooled, and by its own samples.
    Spectrum direct(int lane) const;
    Spectrum own_direct(int lane) const { return albedo_[lane] * own_white_[lane]; }

  private:
    struct Batch {
        FlatLights edges;
        int lane[FlatLights::capacity];
        Spectrum Li[FlatLights::capacity];
    };

    void add_far_light(int lane, const LightRow& light, bool delta);
    void add_near_light(Batch& batch, int lane, const LightRow& light, decltype(FlatKernels::area) kernel);
    void flush(Batch& batch, decltype(FlatKernels::area) kernel);

    const GraphReader& reader_;
    const FlatKernels& kernels_;
    std::span<const VertexRow> rows_;
    FlatColumns columns_{};
    Batch area_{}, point_{};
    float survival_sum_ = 0, nee_sum_ = 0;
    Spectrum far_;  // reflection of lights at infinity at a white vertex, equal for all
    Spectrum albedo_[max_lanes], own_white_[max_lanes];
};

}  // namespace loom::refine
