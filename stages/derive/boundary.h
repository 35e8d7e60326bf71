#pragma once
// Boundary terms: light that appears or disappears where an edge moves in front of what is behind it.  [TR Eqs. 16-18]
//
// Five estimators (families), each with samples of its own; every sample gives rows of (pixel, opl, derivative).

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <memory>
#include <span>
#include <vector>

#include "formats/derivative.h"
#include "stages/core/app/report.h"
#include "stages/core/compute/parallel.h"
#include "stages/core/edges/edge_tree.h"
#include "stages/core/edges/seams.h"
#include "stages/core/graph/graph_reader.h"
#include "stages/core/sampling/streams.h"
#include "stages/derive/adjoint.h"
#include "stages/derive/derive.h"
#include "stages/derive/surface_motion.h"

namespace loom::derive {

using Velocities = std::span<Vector3<double>>;             // [parameter], m per unit
using ConstVelocities = std::span<const Vector3<double>>;  // [parameter]

/// Rows of boundary samples, in the order in which they were made; with weights of a loss only their contraction.
struct BoundaryRows {
    BoundaryRows() = default;
    /// in:      bin_width_  rows of a sample that are nearer in time add up before they are squared, m
    BoundaryRows(const Adjoint* adjoint_, double bin_width_) : adjoint(adjoint_), bin_width(bin_width_) {}

    const Adjoint* adjoint = nullptr;  // null: rows are stored
    double bin_width = INFINITY;
    std::vector<double> gradient;  // of the loss, by parameter
    // [parameter]: sums over samples, pixels and bins of the squares of their derivatives, and of the squares of these
    std::vector<double> square, fourth;
    std::uint64_t n_rows = 0;

    std::vector<std::uint32_t> pixel;
    std::vector<double> opl;         // negative: never arrives
    std::vector<double> camera_opl;  // its share up to the first vertex
    std::vector<float> dL;           // [row, parameter, rgb]
    std::vector<std::uint8_t> family;
    std::vector<std::uint64_t> sample;

    /// in:      rates  by parameter: dL is light times rate
    void add(std::uint64_t pixel_, double opl_, double camera_opl_, const Rgb<double>& light,
             std::span<const double> rates, BoundaryFamily family_, std::uint64_t sample_) {
        ++n_rows;
        if (adjoint) {
            const Rgb<double> weight = adjoint->value_at(pixel_, opl_);
            const double by_rate = light.r * weight.r + light.g * weight.g + light.b * weight.b;
            gradient.resize(rates.size());
            for (std::size_t p = 0; p < rates.size(); ++p) gradient[p] += by_rate * rates[p];
            add_squares({0, 0, sample_}, Rgb<double>(by_rate, 0, 0), rates);
            return;
        }
        pixel.push_back(std::uint32_t(pixel_));
        opl.push_back(opl_);
        camera_opl.push_back(camera_opl_);
        for (const double rate : rates)
            for (int c = 0; c < 3; ++c) dL.push_back(float(light[c] * rate));
        family.push_back(std::uint8_t(family_));
        sample.push_back(sample_);
        add_squares({pixel_, std::int64_t(std::floor(opl_ / bin_width)), sample_}, light, rates);
    }

  private:
    /// What adds up before it is squared.
    struct Place {
        std::uint64_t pixel = 0;
        std::int64_t bin = 0;
        std::uint64_t sample = 0;
        bool operator==(const Place&) const = default;
    };
    void add_squares(const Place& place, const Rgb<double>& light, std::span<const double> rates) {
        const std::size_t n = rates.size();
        square.resize(n), fourth.resize(n);
        if (!places_.empty() && places_[0].sample != place.sample) places_.clear();
        std::size_t i = 0;
        while (i < places_.size() && !(places_[i] == place)) ++i;
        if (i == places_.size()) {
            if (i == most_places) places_.clear(), i = 0;
            places_.push_back(place);
            sums_.resize(most_places * n);
            std::fill_n(sums_.begin() + std::ptrdiff_t(i * n), n, Rgb<double>());
        }
        for (std::size_t p = 0; p < n; ++p) {
            Rgb<double>& sum = sums_[i * n + p];
            const double before = length2(sum);
            sum += light * Rgb<double>(rates[p]);
            const double after = length2(sum);
            square[p] += after - before;
            fourth[p] += sqr(after) - sqr(before);
        }
    }
    static double length2(const Rgb<double>& x) { return sqr(x.r) + sqr(x.g) + sqr(x.b); }

    static constexpr std::size_t most_places = 64;
    std::vector<Place> places_;      // of the last sample, some of many
    std::vector<Rgb<double>> sums_;  // [place, parameter]
};

/// A curve that is no straight edge: the rim of a disk, or the outline of a sphere as seen from a point.
///   center + u_axis cos(phi) + v_axis sin(phi)
struct Round {
    Point3<double> center;
    Vector3<double> u_axis, v_axis;
    std::uint32_t shape_idx = 0;
    Point3<double> middle;  // of the occluder

    Point3<double> point(double phi) const { return center + u_axis * std::cos(phi) + v_axis * std::sin(phi); }
    Vector3<double> tangent(double phi) const { return v_axis * std::cos(phi) - u_axis * std::sin(phi); }
};

/// Whether one of the surfaces of a seam is an area light.
bool cuts_emitter(const Scene& scene, const Seam& seam);
/// Whether a lobe with a width, at its peak, is brighter than a white diffuse surface; where a texture says how, true.
bool has_narrow_lobe(const Material& material);
/// Returns the pairs of shapes that move relative to each other.
SeamQuery moving_pairs(const Scene& scene, const SceneTangents& tangents);

/// What all families share. Borrows all arguments of the constructor.
class BoundaryScene {
  public:
    BoundaryScene(const PathGraph& graph, const Scene& scene, const SceneTangents& tangents,
                  const BoundaryOptions& options);

    const PathGraph& graph;
    const Scene& scene;
    const SceneTangents& tangents;
    const BoundaryOptions& options;
    std::uint64_t seed;  // of the samples: those of a pilot are others
    GraphReader reader;
    SurfaceMotions motions;
    std::vector<std::vector<double>> shape_speed;  // [shape, parameter] largest, m per unit
    EdgeTree all_edges, moving_edges;              // of all shapes, and of those that move
    Attached attached;
    /// Below this share of slide_share() the points of a surface that pass its own edges are sampled with as much less
    /// probability.
    double always_passes_from = 0.25;
    /// A vertex near a shadow point would make light per distance squared without bound, m.
    double joined_beyond = 0;
    std::vector<char> narrow;  // [material] has_narrow_lobe()
    /// Whether family 4 joins a vertex to a shadow point of an area light; where it does not, family 1 takes over, from a
    /// stored vertex in place of the shadow point. Between two narrow lobes hardly any point that is joined has light.
    bool joins(double distance, std::size_t material, std::size_t material_there) const {
        return distance >= joined_beyond && !(narrow[material] && narrow[material_there]);
    }
    std::vector<std::uint32_t> creases;  // of all_edges; empty where all vertices stay on their surfaces
    /// A range of creases that lie near to each other.
    struct CreaseGroup {
        std::size_t begin, end;
        Box3f box;
        double reach;  // largest Attached::reach; infinite where a surface has a delta lobe
    };
    static constexpr std::size_t most_crease_groups = 32;
    std::vector<CreaseGroup> crease_groups;
    /// Lines where surfaces cut each other: first those of surfaces that move relative to each other, then, where points
    /// slide over surfaces or the camera moves, the others.
    std::vector<Seam> seams;
    std::size_t n_moving_seams = 0;
    /// [emitter] an area light on which an edge lies that moves relative to it: from points of the light, such an edge takes
    /// all the light at once, so that only stored vertices see it.
    std::vector<char> touched_emitters;
    bool emitter_seams = false;  // an area light is cut by a surface that moves relative to it
    bool all_seams = true;       // false: the search took too long and ended

    std::size_t n() const { return tangents.n(); }
    /// Of the film's bins, m; infinite where it has none.
    double bin_width() const {
        const auto& width = graph.transient.bin_width_opl;
        return !width.empty() && width[0] > 0 ? width[0] : INFINITY;
    }
    /// Numbers of sample i of a stream, of the kind of the graph's.
    Sampler sampler(std::uint64_t stream, std::uint64_t i) const {
        const bool sobol = graph.tracing.sampler == "sobol";
        const std::uint64_t of_stream = streams::family(seed, stream);
        return sobol ? Sampler(SamplerKind::sobol, of_stream, 0, i)
                     : Sampler(SamplerKind::independent, of_stream, i, 0);
    }
    /// Edges that matter between points of which one moves, or neither.
    const EdgeTree& edges(bool ends_move) const { return ends_move ? all_edges : moving_edges; }

    /// Velocity of a material point of a shape.
    void shape_velocity(std::uint32_t shape, std::uint32_t primitive, const Point3<double>& p, Velocities out) const;
    /// Velocity of the point s of an edge.
    void edge_velocity(const EdgeSet& set, const Edge& edge, double s, Velocities out) const;
    /// Velocity of the line of a seam, across itself.
    void seam_velocity(const Seam& seam, const Point3<double>& p, Velocities out) const;
    /// Velocity of a camera ray's end on a surface: it slides with the ray.
    /// in:      from, d  origin and unit direction of the ray
    void film_velocity(const SurfacePoint& at, const Point3<double>& from, const Vector3<double>& d,
                       Velocities out) const;
    /// Attached::reach of a material on a shape, m; infinite with a delta lobe.
    double reach(std::uint32_t shape, std::uint32_t material) const {
        if (has_delta_lobe(scene.materials[material].model.kind)) return INFINITY;
        return attached.reach.empty() ? 0 : attached.reach[shape];
    }
    /// The larger one of the two sides of a shape.
    double reach(std::uint32_t shape) const {
        const std::uint32_t material = scene.shapes[shape].material_idx;
        const int back = scene.materials[material].back_idx;
        return std::max(reach(shape, material), back < 0 ? 0 : reach(shape, std::uint32_t(back)));
    }
    /// Share of a ray's motion in that of its end on a surface: 1 where it slides with the ray, 0 where it keeps its place.
    /// in:      r  length of the ray, m
    double slide_share(std::uint32_t shape, double r) const { return Attached::share_of(reach(shape), r); }
    /// Probability to sample the points of a surface that pass its own edges: they do so by as much as they slide.
    double passing_share(double slide) const { return slide < always_passes_from ? slide / always_passes_from : 1; }
    /// Velocity of the end of a scattered ray: of its material point, of the ray, or between, as InteriorWalker has it.
    /// in:      from, v_from, turn  start of the ray, its velocity and the angular velocity of its frame
    void far_velocity(std::uint32_t shape, std::uint32_t primitive, std::uint32_t material, const Vector3<double>& ng,
                      const Point3<double>& p, const Point3<double>& from, ConstVelocities v_from, ConstVelocities turn,
                      Velocities out) const;
    /// Velocity of a point on or of an emitter; of a direction for one at infinity.
    void emitter_velocity(std::size_t emitter, const Point3<double>& y, Velocities out) const;
    bool emitter_moves(std::size_t emitter) const;

    /// Largest speeds of what may lie behind an edge, by parameter, m per unit: of any surface, of any surface as the
    /// camera sees it, and of an emitter (at infinity: of its direction).
    std::vector<double> surface_speed, film_speed;
    std::vector<std::vector<double>> emitter_speed;  // [emitter]

    /// Rounds (rims of disks, spheres) whose outline matters, as seen from a point.
    std::vector<Round> rounds_from(const Point3<double>& eye, bool ends_move) const;
    /// The same along a unit direction towards the eye.
    std::vector<Round> rounds_along(const Vector3<double>& direction, bool ends_move) const;

    /// EdgeCluster::motion_around() of all edges and rounds.
    double motion_around(const Point3<double>& eye, double end_speed) const;

    /// Surfaces that end at a point of an edge, on the two sides of it: front, against `out`, and back. Of two faces on one
    /// side the nearer one counts.
    struct Sides {
        Hit front, back;  // none: no face there
    };
    Sides sides_of(const EdgeSet& set, const Edge& edge, const Point3<double>& p, const Vector3<double>& view,
                   const Vector3<double>& out) const;
    /// The same of a seam, which has a face on each side.
    Sides sides_of(const Seam& seam, const Point3<double>& p, const Vector3<double>& view,
                   const Vector3<double>& out) const;
    /// Whether light differs on the two faces of a shared edge that both show: their shading normals do.
    bool is_crease(const EdgeSet& set, const Edge& edge) const;

    /// Returns the point at which the surface of a round is seen in front of its curve: on it, or of a sphere a little
    /// inside of its outline, where a surface of one side certainly faces the eye.
    /// in:      p     of the curve;  view  unit direction from the eye
    Point3<double> front_of_round(std::uint32_t shape_idx, const Point3<double>& p, const Vector3<double>& view) const;

    /// Distance beside an edge point by which a ray passes it, so that the edge's own faces do not block it.
    double clearance(const Point3<double>& x, double distance) const;

    /// A point of a curve, seen from an eye.
    struct Curve {
        Point3<double> p;
        Vector3<double> view;  // unit, from the eye
        double r = 0;          // from the eye, m
        std::uint32_t shape_idx = 0;
        const EdgeTree* tree = nullptr;  // from which edges are sampled
        const Edge* edge = nullptr;      // of the tree; null: of a round or a seam
        Hit front;                       // the surface that ends at the curve
        Hit touched;                     // one that the curve lies on, if any: out of shows()
    };
    /// Whether nothing hides a point of a curve. Where it lies on another surface, the space beside it may be behind that
    /// one: then the space in front of it counts. Of surfaces that are cut, not touched, the seam shows instead.
    /// in:      beside  unit, off the surfaces that meet at the point;  touches  whether the point may lie on another one
    ///          first   Hit(Point3f): the first surface between the eye and a point near the curve
    template <class First>
    bool shows(Curve& curve, const Vector3<double>& beside, bool touches, First&& first) const {
        const double off = clearance(curve.p, curve.r);
        const Hit hit = first(Point3f(curve.p + beside * off));
        if (!hit) return true;
        if (!touches || is_behind(curve.p, curve.view, hit.shape_idx, hit.primitive_idx) ||
            first(Point3f(curve.p - curve.view * off)))
            return false;
        if (lies_on(curve.p, hit.shape_idx, hit.primitive_idx)) curve.touched = hit;
        return true;
    }
    /// Velocity of a curve that lies on another surface, across itself: it stays on both, as if one grew through the other.
    /// Of motions that part them this is the derivative towards the side where they meet.
    /// out:     false, `out` unchanged: it touches none, or both are coplanar
    bool contact_velocity(const Curve& curve, Velocities out) const;
    /// Whether a point lies on the plane of a surface, or on a sphere.
    bool lies_on(const Point3<double>& p, std::uint32_t shape, std::uint32_t primitive) const;
    /// Whether a surface that shows beside a curve ends there, too, with an edge of its own that moves alike: then its light
    /// belongs to that edge.
    bool ends_too(const Curve& curve, std::uint32_t shape, std::uint32_t primitive) const;
    /// How far before a point of a curve, or behind it, a ray beside it may hit a surface that the curve lies on, m: the
    /// farther the flatter the ray. Its own faces do not count.
    double touching_depth(const Curve& curve, std::uint32_t shape, std::uint32_t primitive) const;

  private:
    std::vector<EdgeCluster> round_clusters_;

    /// Whether a point is behind a surface by more than rounding.
    bool is_behind(const Point3<double>& p, const Vector3<double>& view, std::uint32_t shape,
                   std::uint32_t primitive) const;
    bool is_face(const Curve& curve, std::uint32_t shape, std::uint32_t primitive) const;

    void find_speeds();
    void find_rounds();
    void find_creases();
    void find_all_seams();
    void find_touched_emitters();
};

/// Calls f(pixel, h) for the pixels whose reconstruction filter reaches a film position, h its density there.
template <class F>
void for_pixels_at(const Sensor& sensor, Point2f film, F&& f) {
    const float reach = sensor.filter_radius;
    const auto first = [&](float x) { return std::max(0, int(std::floor(x - reach - 0.5f))); };
    const auto last = [&](float x, std::uint32_t n) { return std::min(int(n) - 1, int(std::floor(x + reach))); };
    for (int py = first(film.y); py <= last(film.y, sensor.height); ++py)
        for (int px = first(film.x); px <= last(film.x, sensor.width); ++px) {
            const float h = sensor.filter_density(std::uint32_t(px), std::uint32_t(py), film);
            if (h > 0) f(std::uint64_t(py) * sensor.width + std::uint64_t(px), double(h));
        }
}

/// Work of a family, in numbers that depend neither on the machine nor on the threads: divide sums, not parts.
struct Effort {
    std::uint64_t rays = 0;
    std::uint64_t steps = 0;  // vertices walked, points drawn, some silhouettes listed: by measured times

    /// In rays; a step costs about as much as two.
    double cost() const { return double(rays) + 2 * double(steps); }
};

/// Index of refraction of the medium in which a stored vertex was reached.
inline double arriving_index(const PathGraph& graph, std::size_t vertex) {
    return graph.vertices.eta.empty() ? 1.0 : double(graph.vertices.eta[vertex]);
}
/// Index of refraction on the side of wi.
/// in:      arriving  that on the side of wo
inline double index_towards(double arriving, const ShadingPoint& at, const Vector3f& wi) {
    if (!is_interface(*at.bsdf.model) || dot(at.n_side, wi) * dot(at.n_side, at.wo) > 0) return arriving;
    return dot(at.n_side, wi) > 0 ? double(at.bsdf.model->ext_ior) : double(at.bsdf.model->int_ior);
}

/// Calls work(worker of the thread, rows of the chunk, begin, end) for chunks of [0, n).
/// out:     rows  one element more for each chunk
template <class Workers, class Work>
void sample_in_chunks(const BoundaryScene& s, std::uint64_t n, std::uint64_t chunk, const char* title, Workers& workers,
                      std::vector<BoundaryRows>& rows, app::Report& report, const Work& work) {
    const std::size_t first = rows.size();
    rows.resize(first + (n + chunk - 1) / chunk, BoundaryRows(s.options.adjoint, s.bin_width()));
    app::Progress progress(report, title, n);
    parallel_chunks(n, chunk, s.options.threads, [&](std::uint64_t i, std::uint64_t begin, std::uint64_t end) {
        work(workers.local(), rows[first + i], begin, end);
        progress.add(end - begin);
    });
}

/// Calls f(i) for numbers of [begin, end), each with the probability `share`: one of each of as many equal parts of all
/// numbers, by luck one twice. Only they cost time; the ranges of all numbers may be walked in any order.
template <class F>
void for_chosen(std::uint64_t seed, double share, std::uint64_t begin, std::uint64_t end, F&& f) {
    if (share >= 1) {
        for (std::uint64_t i = begin; i < end; ++i) f(i);
        return;
    }
    // The part before, by rounding, may reach into the range, too.
    const double first = std::max(double(begin) * share - 1, 0.0), last = double(end) * share;
    for (auto k = std::uint64_t(first); double(k) < last; ++k) {
        const auto i = std::uint64_t((double(k) + streams::selection(seed, k)) / share);
        if (i >= begin && i < end) f(i);
    }
}

/// The families. Each adds its samples to `samples[family]`.
/// in:      n_samples  points of curves, or light points
///          share      probability of each path to be sampled, at most 1
Effort add_primary(const BoundaryScene& s, std::uint64_t n_samples, std::vector<BoundaryRows>& rows,
                   std::span<std::uint64_t> samples, app::Report& report);
/// Vertices by what leads to them: the camera; a lobe with a width, from a vertex to which BoundaryScene::joins() would
/// join them or not; or a delta lobe (or the camera through a mask).
namespace reached_by {
inline constexpr char camera = 1, unjoined = 2, joined = 4, delta = 8, any = 15;
}
/// in:      sampled_at  by emitter: the vertices (reached_by) that sample it
Effort add_vertex_light(const BoundaryScene& s, double share, const std::vector<char>& sampled_at,
                        std::vector<BoundaryRows>& rows, std::span<std::uint64_t> samples, app::Report& report);
/// in:      wanted  by emitter
Effort add_edge_light(const BoundaryScene& s, std::uint64_t n_samples, const std::vector<char>& wanted,
                      std::vector<BoundaryRows>& rows, std::span<std::uint64_t> samples, app::Report& report);
/// Shadows of lights at points that vertices of paths see by lobes with a width: of those with area, where
/// BoundaryScene::joins() says so.
/// in:      wanted  by emitter
Effort add_joined_light(const BoundaryScene& s, double share, const std::vector<char>& wanted,
                        std::vector<BoundaryRows>& rows, std::span<std::uint64_t> samples, app::Report& report);
/// Importance of vertices for add_indirect(), in units of its own: how much the edges around one may bring.
struct IndirectUnits {
    /// From clusters of all edges: a vertex of this importance lists its outline, less important ones with that probability.
    double around = 0;
    /// From its outline: a vertex of this importance has one point of it, more important ones up to 16.
    double outline = 0;
};
/// Finds the units by a look at some vertices.
IndirectUnits indirect_units(const BoundaryScene& s, bool surfaces, bool environment);
/// in:      share  above 1: of all paths, with as many times the points
///          surfaces, environment  whether light of surfaces, and that of an environment, is wanted
Effort add_indirect(const BoundaryScene& s, double share, const IndirectUnits& units, bool surfaces, bool environment,
                    std::vector<BoundaryRows>& rows, std::span<std::uint64_t> samples, app::Report& report);

/// Samples all boundary terms that `parts` requires.
/// out:     samples  [family]
std::vector<BoundaryRows> sample_boundary(BoundaryScene& s, const Parts& parts, app::Report& report,
                                          std::vector<std::uint64_t>& samples, DeriveCounts& counts);
/// sample_boundary(), into the rows of `out`, sorted by pixel, family and sample.
void differentiate_boundary(BoundaryScene& s, const Parts& parts, app::Report& report, Derivative& out,
                            DeriveCounts& counts);

}  // namespace loom::derive
