#pragma once
// The silhouettes seen from one point, and a point drawn from them.

#include <array>
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
    const Edge* edge = nullptr;  // null: of a round or a seam
    const Seam* seam = nullptr;
    double phi = 0;          // of a round
    bool is_crease = false;  // both faces show
};

/// Lists silhouettes, weights them by angle and speed, and samples points of them. State of one thread.
class Outline {
  public:
    explicit Outline(const BoundaryScene& s);

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

    /// Adds seams in a shaft, a part of them where there are many. Must follow collect().
    /// in:      all  seams of surfaces that do not move relative to each other, too
    ///          u    uniform: which part
    bool add_seams(const Shaft& shaft, std::span<const double> far_speed, bool all, float u);

    /// Share of the largest speed of what lies behind that counts for importance(): little of it moves.
    static constexpr double part_of_behind = 0.05;
    /// How fast light may appear beside all that is listed, in units of its own: to compare eyes.
    double importance() const { return total_importance_; }
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
        // Of a seam or round; of an edge they are found when it is chosen.
        double begin = 0, end = 0;  // angle of a straight edge about the foot of the eye; phi of a round
        double height = 1;          // distance of the eye from the edge's line
        double foot = 0;            // position of the foot along the edge from its first end, m
        /// Importance at begin, middle and end, linear between them: the speed of an edge that turns has a zero somewhere.
        std::array<double, 3> importance = {1, 1, 1};

        /// The integral of the importance over the share t, in [0, 1], of the arc.
        double mean() const { return 0.25 * importance[0] + 0.5 * importance[1] + 0.25 * importance[2]; }
        double at(double t) const;
        double sample(double u) const;
    };
    double importance(const Point3<double>& x, const Vector3<double>& out) const;
    void combine_weights(std::span<const double> far_speed);
    Arc arc_between(const Point3<double>& a, const Point3<double>& b, double begin, double end) const;
    /// Position along a line, m, at the share t of an arc.
    double along_arc(const Arc& arc, double t) const;
    bool place_on_edge(std::size_t i, double t, OutlinePoint& point);
    bool place_on_seam(std::size_t i, double t, OutlinePoint& point);
    bool place_on_round(std::size_t i, double t, OutlinePoint& point);
    void look(OutlinePoint& point) const;
    /// in:      share_at  share of the motion that counts, by the distance of the middle
    template <class ShareAt>
    void add_segment(const EdgeSegment& segment, ShareAt&& share_at);
    void add_crease(std::uint32_t edge_idx, double share, const Shaft& shaft);
    void add_seam(std::size_t seam_idx, const EdgeInterval& inside, double share);

    const BoundaryScene& s_;
    const EdgeTree* tree_ = nullptr;
    Point3<double> eye_;
    bool at_infinity_ = false;
    std::vector<Vector3<double>> velocity_, v_eye_;
    std::vector<EdgeSegment> segments_;
    std::vector<Round> rounds_;
    std::size_t first_crease_ = 0;  // among arcs_: silhouettes, rounds, creases, seams
    std::size_t first_seam_ = 0;
    std::uint64_t n_found_ = 0;
    std::vector<EdgeSegment> creases_;
    struct SeamPart {
        EdgeInterval inside;
        std::size_t seam_idx;
        double share;  // probability to be listed
    };
    std::vector<SeamPart> seams_;
    std::vector<double> seam_share_, seam_sum_;  // [seam] probability to be listed, and its sum over the kind
    std::vector<Vector3<double>> v_face_;
    std::vector<Arc> arcs_;  // [segment, round, crease, seam]
    // The exact angles of the edge that was drawn last: often the next one.
    static constexpr std::size_t no_arc = ~std::size_t{0};
    std::size_t exact_arc_ = no_arc;
    Arc exact_;
    std::vector<double> known_, extent_;  // weights by the velocities of edge and eye, and by angle alone
    double total_known_ = 0, total_importance_ = 0;
    std::vector<double> cumulative_;  // of the weights
};

}  // namespace loom::derive
