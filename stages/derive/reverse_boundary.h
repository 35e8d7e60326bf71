#pragma once
// Boundary terms of the reverse mode: the gradient of a loss by the motions of shapes, emitters and camera.
//
// The rate of a boundary sample is linear in the velocities of its edge and of the ends of its line of sight, and these
// are linear in the motions. So the families of the forward mode sample a basis of the motions, whose size is that of the
// scene, not of the parameters; each row is contracted with the weights as it is made.

#include <string>

#include "stages/derive/derive.h"
#include "stages/derive/reverse.h"

namespace loom::derive {

/// The motions that a set of parameters and wanted parts needs, as columns in blocks that one run can take.
class MotionBasis {
  public:
    MotionBasis(const Scene& scene, const SceneTangents& tangents, const WantedParts& wanted);

    /// Largest number of columns; vertices beyond it have no boundary terms.
    static constexpr std::size_t max_columns = 4096;

    std::size_t n_columns() const { return n_columns_; }
    std::size_t n_blocks() const { return blocks_.size(); }
    /// Meshes whose vertices were left out.
    const std::string& left_out() const { return left_out_; }

    /// Adds the gradient by the boundary terms of all columns.
    void add_boundary(const PathGraph& graph, const Scene& scene, const std::vector<std::string>& off,
                      const BoundaryOptions& options, app::Report& report, GradientSums& sums,
                      std::vector<double>& by_vertex, DeriveCounts& counts) const;

  private:
    enum class Of { shape, normals, emitter, camera, lens, vertex };
    /// A basis motion about a centre, in units of a size: component `number` of an affine field, or a vertex and an axis.
    struct ColumnOf {
        Of of;
        std::uint32_t index;  // shape, emitter, mesh
        int number;           // 0 to 8: linear, 9 to 11: offset; axis of a vertex
        std::uint32_t vertex = 0;
        Vector3<double> centre{};
        double size = 1;
    };
    using Block = std::vector<ColumnOf>;
    static AffineVelocity field(const ColumnOf& c);
    SceneTangents tangents_of(const Block& block, const Scene& scene) const;
    void add(const Block& block, const std::vector<double>& gradient, GradientSums& sums,
             std::vector<double>& by_vertex) const;

    const WantedParts& wanted_;
    std::vector<Block> blocks_;
    std::size_t n_columns_ = 0;
    std::string left_out_;
};

}  // namespace loom::derive
