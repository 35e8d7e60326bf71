#pragma once
// The silhouettes seen from one point, and a point drawn from them.

#include <span>
#include <vector>

#include "stages/core/edges/boundary.h"
#include "stages/derive/boundary.h"

namespace loom::derive {

/// A point of a silhouette.
struct OutlinePoint {
    Point3<double> p;
    Vector3<double> omega;  // unit, from the eye
    double r = 0;           // from the eye, m; 1 for an eye at infinity
    Vector3<double> out;    // t x omega, turned away from the occluder
    double density = 0;     // per m of the silhouette
    std::uint32_t shape_idx = 0;
    const Edge* edge = nullptr;  // null: of a round
    double phi = 0;              // of a round
    bool is_crease = false;      // both faces show
};

/// Lists silhouettes, weights them by angle and speed, and samples points of them. State of one thread.
class Outline {
  public:
    explicit Outline(const BoundaryScene& s) : s_(s), velocity_(s.n()) {}

    /// Lists what a shaft contains, seen from its apex.
    /// in:      eye       the apex; at infinity: the direction towards it
    ///          v_eye     its velocity, by parameter
    ///          far_speed  largest speed of what may lie behind the silhouettes, by parameter
    ///          tree      edges to look for; all: rounds that rest count, too
    ///          n_points  points that sample() will draw
    ///          u         random bits: which part of many silhouettes
    /// out:     whether there is anything
    bool collect(const Shaft& shaft, const Point3<double>& eye, bool at_infinity, ConstVelocities v_eye,
                 std::span<const double> far_speed, const EdgeTree& tree, bool all, int n_points, float u);
    /// Adds creases in a shaft, a part of them where there are many. Must follow collect() over BoundaryScene::all_edges.
    /// in:      u  uniform: which part
    bool add_creases(const Shaft& shaft, std::span<const double> far_speed, float u);

    /// Draws a point. Its velocity is in velocity().
    /// in:      u  uniform: the choice, and the place along it
    /// out:     false where rounding leaves nothing
    bool sample(Point2f u, OutlinePoint& point);
    ConstVelocities velocity() const { return velocity_; }
    /// Number of silhouettes and creases found so far by all calls, and of a quarter of the nodes visited for them: a
    /// measure of the work.
    std::uint64_t n_found() const { return n_found_; }

  private:
    struct Arc {
        double begin, end;  // angle of a straight edge about the foot of the eye; phi of a round
        double height;      // distance of the eye from the edge's line
        double foot;        // position of the foot along the edge from its first end, m
    };
    double importance(const Point3<double>& x, const Vector3<double>& out) const;
    void combine_weights(std::span<const double> far_speed);
    bool place_on_edge(std::size_t i, double t, OutlinePoint& point);
    bool place_on_round(std::size_t i, double t, OutlinePoint& point);
    void look(OutlinePoint& point) const;
    void add_segment(const EdgeSegment& segment);

    const BoundaryScene& s_;
    const EdgeTree* tree_ = nullptr;
    Point3<double> eye_;
    bool at_infinity_ = false;
    std::vector<Vector3<double>> velocity_, v_eye_;
    std::vector<EdgeSegment> segments_;
    std::vector<Round> rounds_;
    std::size_t first_crease_ = 0;  // among arcs_: silhouettes, rounds, creases
    std::uint64_t n_found_ = 0;
    std::vector<EdgeSegment> creases_;
    std::vector<Arc> arcs_;               // [segment, round, crease]
    std::vector<double> known_, extent_;  // weights by the velocities of edge and eye, and by angle alone
    std::vector<double> cumulative_;      // of the weights
};

}  // namespace loom::derive
