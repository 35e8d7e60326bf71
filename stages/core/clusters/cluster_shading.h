#pragma once
#include <span>

#include "stages/core/clusters/cluster_columns.h"
#include "stages/core/clusters/cluster_rows.h"

namespace loom {

/// The vertices of one cluster, evaluated together: the light that each reflects from one direction or point, and the
/// density of its own sampling there. Reused from cluster to cluster.
class ClusterShading {
  public:
    explicit ClusterShading(const GraphReader& reader)
        : reader_(reader), make_row_(reader), kernels_(cluster_kernels()) {}

    /// Loads a cluster. Lanes are ordered by material, then as in `vertices`, which is borrowed.
    /// needs:   at most max_lanes vertices
    void load(std::span<const std::uint32_t> vertices);
    /// Loads a cluster whose vertex rows are given.
    void load(std::span<const std::uint32_t> vertices, std::span<const VertexRow> rows);

    int size() const { return columns_.n; }
    int padded() const { return padded_lanes(columns_.n); }
    std::uint32_t vertex(int lane) const { return vertices_[place_[lane]]; }
    /// Returns a lane's index among the loaded vertices.
    std::size_t place(int lane) const { return place_[lane]; }
    const VertexRow& row(int lane) const { return rows_[place_[lane]]; }
    const RowMaker& make_row() const { return make_row_; }

    /// Evaluates light from direction wi: f cos and densities in sr^-1.
    void light_direction(const Vector3f& wi);
    /// Evaluates light from direction wi, split into base and coat.
    /// needs:   lobes().split
    void light_lobes(const Vector3f& wi);
    /// Evaluates light from a surface point, with its normal facing the cluster: f cos G and densities per m^2.
    void light_point(const Point3f& y, const Normal3f& n);
    /// Evaluates light from a point source: f cos / d^2.
    void light_delta_point(const Point3f& y);

    // Results by lane; 0 from size() up to padded().
    const float* f(int channel) const {
        return channel == 0 ? columns_.f_r : channel == 1 ? columns_.f_g : columns_.f_b;
    }
    /// Returns the factor that converts a lane's result to sr^-1; 0 where it underflowed.
    float to_solid_angle(int lane) const { return columns_.geometry[lane] > 0 ? 1 / columns_.geometry[lane] : 0.0f; }
    Spectrum f(int lane, float scale) const {
        return {columns_.f_r[lane] * scale, columns_.f_g[lane] * scale, columns_.f_b[lane] * scale};
    }
    /// Stores the results as 16-bit fractions of their largest value: row[rgb][lane]; largest value and weighted sum by
    /// channel.
    void fix_row(const float* weight, std::uint16_t* row, float* largest, float* sum) const {
        kernels_.fix_row(columns_, weight, row, largest, sum);
    }
    bool sees(int lane) const { return columns_.f_r[lane] + columns_.f_g[lane] + columns_.f_b[lane] > 0; }
    /// Density of BSDF sampling, survival of roulette included; 0 where none was attempted.
    float pdf_bsdf(int lane) const { return columns_.pdf[lane]; }
    float pdf_bsdf_sum() const { return columns_.pdf_sum; }
    /// Whether the next vertex of any continuation must end the path (vertex_bit::last_step).
    bool has_last_steps() const { return has_last_steps_; }
    /// Returns the number of vertices that attempted next-event estimation and reflect this light. The others would
    /// have dropped such a sample before its shadow ray; for it they are no technique.
    int n_next_event() const;
    bool attempted_nee(int lane) const { return attempted_nee_[lane] != 0; }

    /// Split of f cos into tint * base + coat at all vertices.
    struct Lobes {
        bool split = false;  // the split exists: every coat is grey
        bool base = false, coat = false;
        bool one_base = false;  // the base is the same at all lanes and in all directions
    };
    const Lobes& lobes() const { return lobes_; }
    const ClusterColumns& columns() const { return columns_; }
    Spectrum f_of_lobes(int lane, float scale) const {
        const ClusterColumns& c = columns_;
        const float base = c.base[lane], coat = c.coat[lane];
        return Spectrum{c.tint_r[lane] * base + coat, c.tint_g[lane] * base + coat, c.tint_b[lane] * base + coat} *
               scale;
    }
    void fix_lobes(bool base, bool coat, const float* weight, std::uint16_t* row, float* largest, float* sum) const {
        kernels_.fix_lobes(columns_, base, coat, weight, row, largest, sum);
    }

  private:
    bool has_one_base(std::uint8_t textured) const;
    bool has_own(std::uint16_t material) const;
    void load_textures(const ClusterColumns::Run& run, std::uint8_t textured);
    void shadow_bumps();

    const GraphReader& reader_;
    RowMaker make_row_;
    const ClusterKernels& kernels_;
    ClusterColumns columns_{};
    Lobes lobes_;
    std::vector<ShadingPoint> perturbed_;  // at vertices with bump or normal maps
    std::vector<int> perturbed_lane_;
    bool has_last_steps_ = false;
    std::vector<VertexRow> own_rows_;
    std::span<const std::uint32_t> vertices_;
    std::span<const VertexRow> rows_;
    std::uint16_t place_[max_lanes];
    std::uint8_t attempted_nee_[max_lanes + lane_block];
};

}  // namespace loom
