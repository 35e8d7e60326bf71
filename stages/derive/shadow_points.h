#pragma once
// Points of surfaces at which the light of an emitter begins: behind the silhouettes seen from points of emitters.

#include <functional>
#include <vector>

#include "stages/core/scene/emitter.h"
#include "stages/core/scene/nlos.h"
#include "stages/derive/outline.h"

namespace loom::derive {

/// A point of a surface at the border of a shadow, on its lit side.
///
/// The derivative of the integral over surfaces of W f_cos L, where W is the importance per area that arrives at a
/// point, changes at the borders of shadows by
///   integral of W f_cos light rate,
/// which the sum over sampled points estimates. `light` has the densities of the sample, and the geometric cosine that
/// turns area across omega into area of the surface.
struct ShadowPoint {
    std::uint32_t emitter_idx = 0;
    bool infinite = false;  // the emitter is at infinity
    Point3<double> y;       // of the emitter, or the direction towards it
    OutlinePoint b;         // of the occluder; omega points from the emitter to the surface
    double r = 0;           // from y to the surface, m; 0 for an emitter at infinity
    double laser_r = 0;     // from the laser to its spot y, m
    SurfacePoint at;
    Rgb<double> light;
    ConstVelocities v_edge, v_emitter;  // [parameter]

    /// Whether the surface is seen from the place of the emitter: then one edge ends both the view and the light, and
    /// belongs to the view.
    bool is_seen_from_emitter(const Point3<double>& eye) const {
        constexpr double rounding = 1e-6;
        return !infinite && length(eye - y) <= rounding * r;
    }
    /// Computes the rates at which light appears beside the edge.
    /// in:      v_surface  velocities of `at`
    /// out:     out  by parameter; returns whether any is not 0
    bool rates(ConstVelocities v_surface, std::span<double> out) const;
};

/// Samples shadow points. State of one thread.
class ShadowPoints {
  public:
    /// in:      weights          by emitter, for the choice between them
    ///          per_light_point  silhouette points seen from one point of an emitter
    ShadowPoints(const BoundaryScene& s, const std::vector<double>& weights, int per_light_point);

    /// Calls found(point) for the points, per_light_point at most, seen from one point of an emitter.
    /// in:      sampler    from its pair 0
    ///          far_speed  largest speeds of the surfaces behind the silhouettes, by parameter
    ///          all        edges at rest count, too
    ///          pixel      of the film: in an NLOS capture, whose laser spot is the emitter
    void sample(const Sampler& sampler, std::span<const double> far_speed, bool all, std::uint64_t pixel,
                const std::function<void(const ShadowPoint&)>& found);

    /// Whether one of the emitters moves, so that edges at rest count.
    bool emitters_move() const { return emitters_move_; }

    std::uint64_t n_rays = 0;
    std::uint64_t n_listed() const { return outline_.n_found(); }

  private:
    /// Finds the surface behind an edge. Returns whether there is one that the light reaches.
    /// in:      spot  in an NLOS capture, else null
    bool complete(const LightPoint& light, const LitSpot* spot, double density, ShadowPoint& point);

    const BoundaryScene& s_;
    int per_light_point_;
    Distribution1 choice_;
    Outline outline_;
    std::vector<Vector3<double>> v_emitter_;
    bool emitters_move_ = false;
};

/// Weights of the choice between emitters, those that are not wanted left out.
std::vector<double> emitter_weights(const Scene& scene, const std::vector<char>& wanted);

}  // namespace loom::derive
