#pragma once
// Derivatives of a loss by any number of parameters, from one backward sweep over each stored path.
//
//   loss = sum over pixels, bins, channels of weight H,   dloss = sum over paths, light edges of [L' a(opl) + L opl' a'(opl)]
//
// The sweep is the transpose of the walk in interior.cpp, step by step: each vertex receives the gradient by its position,
// normals and material, and passes the rest on towards the camera. The sums that every parameter is contracted from have
// a fixed size: a gradient by the affine velocity of each shape, and the numbers of each material and emitter.

#include <array>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "formats/gradient.h"
#include "formats/path_graph.h"
#include "stages/derive/adjoint.h"
#include "stages/derive/scene_tangents.h"
#include "stages/derive/wanted_parts.h"

namespace loom::app {
class Report;
}

namespace loom::derive {

/// Gradient by an affine velocity field.
struct AffineGradient {
    std::array<double, 9> linear{};  // row-major
    Vector3<double> offset;

    /// Adds the gradient g by the velocity of a point.
    void add_point(const Vector3<double>& g, const Point3<double>& at) {
        add_vector(g, Vector3<double>(at));
        offset = offset + g;
    }
    /// Adds the gradient g by the turn of a vector.
    void add_vector(const Vector3<double>& g, const Vector3<double>& v) {
        for (int r = 0; r < 3; ++r)
            for (int c = 0; c < 3; ++c) linear[std::size_t(3 * r + c)] += g[r] * v[c];
    }
    /// Adds the gradient g by AffineVelocity::of_normal(n).
    void add_normal(const Vector3<double>& g, const Vector3<double>& n) {
        const double along = loom::dot(g, n);
        for (int r = 0; r < 3; ++r)
            for (int c = 0; c < 3; ++c) linear[std::size_t(3 * r + c)] += n[r] * (along * n[c] - g[c]);
    }
    /// Adds the gradient g by AffineVelocity::area_growth(n).
    void add_area(double g, const Vector3<double>& n) {
        for (int r = 0; r < 3; ++r)
            for (int c = 0; c < 3; ++c) linear[std::size_t(3 * r + c)] += g * ((r == c ? 1 : 0) - n[r] * n[c]);
    }
    AffineGradient& operator+=(const AffineGradient& o);
    double along(const AffineVelocity& v) const;
};

/// Sums of gradients over paths.
struct GradientSums {
    std::vector<AffineGradient> shapes, normals;  // [shape]
    std::vector<MaterialTangent> materials;       // [material]
    std::vector<AffineGradient> emitters;         // [emitter]
    std::vector<Rgb<double>> radiance;            // [emitter]
    AffineGradient camera;
    double lens = 0;
    double loss = 0;

    /// A gradient by one vertex (xyz) or one texel (rgb), at its row of all that are wanted.
    struct Scattered {
        std::uint64_t row;
        std::array<double, 3> by;
    };
    std::vector<Scattered> vertices, texels;

    GradientSums() = default;
    explicit GradientSums(const Scene& scene);
    /// Adds all but the scattered.
    void add_dense(const GradientSums& o);
    /// Returns the gradient by parameter, from the effects of each.
    std::vector<double> by_parameter(const SceneTangents& tangents) const;
};

/// Sweeps backward along stored paths. Borrows all arguments of the constructor; one per thread.
class ReverseWalker {
  public:
    ReverseWalker(const PathGraph& graph, const Scene& scene, const SceneTangents& tangents, const WantedParts& wanted,
                  const Adjoint& adjoint);
    ~ReverseWalker();
    ReverseWalker(ReverseWalker&&) noexcept;

    /// Adds the gradient of one path, which counts as one of the samples of its pixel.
    /// in:      edge  first light edge of the path; out: that of the next path
    /// out:     whether the path depends on a parameter
    bool walk(std::size_t path, std::size_t& edge, GradientSums& sums);

  private:
    struct Impl;
    std::unique_ptr<Impl> impl_;
};

/// Adds the interior gradients of all paths. Equal bits for any number of threads.
/// out:     number of paths that depend on a parameter
std::uint64_t sweep_paths(const PathGraph& graph, const Scene& scene, const SceneTangents& tangents,
                          const WantedParts& wanted, const Adjoint& adjoint, int threads, app::Report& report,
                          GradientSums& sums, std::vector<double>& by_vertex, std::vector<double>& by_texel);

/// Returns the file of a gradient, without provenance.
Gradient gradient_of(const SceneTangents& tangents, const WantedParts& wanted, const GradientSums& sums,
                     std::vector<double> by_vertex, std::vector<double> by_texel);

}  // namespace loom::derive
