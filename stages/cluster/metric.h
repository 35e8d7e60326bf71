#pragma once
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>

#include "stages/cluster/pool.h"
#include "stages/core/math/vector.h"

namespace loom::cluster {

/// A vertex in the space of the metric; its Euclidean distance is the metric.
struct Point {
    std::array<float, 6> x;  // rotated p / s, rotated w n
    std::uint32_t vertex;
    std::array<std::int16_t, 2> ng{};  // geometric normal on the side of wo, octahedral; read by Separator only
};
static_assert(sizeof(Point) == 32);  // half a cache line

/// distance^2 = |dp|^2 / s^2 + w^2 |dn|^2, n the shading normal on the side of wo.
/// The position and the normal space are rotated randomly, by the seed. Distances are kept, but axis-aligned structures
/// (splits, boxes) lie elsewhere in each pass.
class Metric {
  public:
    Metric(const Pool& pool, float length_scale, float normal_weight, std::uint64_t seed);
    /// Maps a vertex to a point; ng stays unset.
    Point operator()(std::size_t vertex) const;
    std::array<std::int16_t, 2> geometric_normal(std::size_t vertex) const;
    /// Returns the position of the vertex, up to rounding().
    Point3f position(const Point& point) const {
        Vector3f p = origin_;
        for (std::size_t i = 0; i < 3; ++i) p = p + p_rows_[i] * (point.x[i] * length_scale_ * length_scale_);
        return {p.x, p.y, p.z};
    }
    /// Returns a bound on the error of position().
    float rounding(const Point& point) const {
        const float size = std::abs(point.x[0]) + std::abs(point.x[1]) + std::abs(point.x[2]);
        return 8 * std::numeric_limits<float>::epsilon() * size * length_scale_;
    }

  private:
    const Pool& pool_;
    std::array<Vector3f, 3> p_rows_, n_rows_;
    Vector3f origin_;
    float length_scale_;
};

/// Returns the typical radius (m) of a cluster of k vertices. It is the median root mean square distance to the
/// centroid over clusters of a subset of the sharing vertices, made by median splits. The radius is scaled from the
/// density of the subset to that of all vertices. Vertices lie on surfaces, so the radius is proportional to the square
/// root of the area per cluster. The median prevents a ground plane that reaches to the horizon from counting for more
/// than its share of vertices.
/// in: n_sharing  number of sharing vertices in the pool
/// out: > 0 (1 when all vertices lie at one point)
float typical_radius(const Pool& pool, std::size_t n_sharing, std::uint32_t k);

}  // namespace loom::cluster
