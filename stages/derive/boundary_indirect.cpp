// Family 3: from a stored vertex, the edges in front of surfaces and of an environment; the light beside the edge by
// paths of their own.
//   sum over visible silhouettes of beta f_cos(omega) dL swept / r_B^2 dl_B
// Both sides count, each with the velocity of its own far point (Attached): the light beside the edge, and that of the
// surface in front, whose points slide over the edge unless they keep their places. So do points over creases. Over lines
// where surfaces cut each other (seams) they do so even then, and over the border of an emitter that is cut so.

#include <tbb/enumerable_thread_specific.h>

#include <algorithm>
#include <functional>
#include <numeric>

#include "stages/core/edges/boundary.h"
#include "stages/core/sampling/streams.h"
#include "stages/core/scene/media.h"
#include "stages/derive/given_rays.h"
#include "stages/derive/interior.h"
#include "stages/derive/outline.h"

namespace loom::derive {
namespace {

using Vec = Vector3<double>;
using Pt = Point3<double>;

/// A sample whose light is yet to be traced.
struct Pending {
    std::uint64_t path = 0, vertex = 0;
    Rgb<double> value;  // all but the light and the rate
    double opl = 0;     // up to the vertex
    double camera_opl = 0;
    Pt x_s;
    OutlinePoint b;
    Hit front, touched;  // BoundaryScene::Curve
    std::vector<Vec> v_s, v_b;
    std::vector<Vec> turn;
};
/// A ray of a sample.
struct Side {
    std::uint32_t pending_idx;
    double factor;  // negative: the surface in front
    Hit at_edge;    // the surface that ends at the edge; none: any that the ray hits
};

class Sampling {
  public:
    /// in:      share  above 1: of all paths, with as many times the points
    Sampling(const BoundaryScene& s, double share, const IndirectUnits& units, bool surfaces, bool environment)
        : s_(s),
          share_(std::min(share, 1.0)),
          units_{units.around / std::max(share, 1.0), units.outline / std::max(share, 1.0)},
          surfaces_(surfaces),
          environment_(environment),
          slide_(s.attached.any_slides()),
          outline_(s),
          walker_(s.graph, s.scene, s.tangents, s.attached),
          light_(s, streams::family(s.seed, 3)),
          v_light_(s.n()),
          rates_(s.n()),
          emission_rates_(s.n()),
          far_speed_(s.surface_speed) {
        if (!environment || s.scene.environment_idx < 0) return;
        const std::vector<double>& turns = s.emitter_speed[std::size_t(s.scene.environment_idx)];
        for (std::size_t p = 0; p < s.n(); ++p) far_speed_[p] = std::max(far_speed_[p], turns[p]);
    }

    std::uint64_t n_samples = 0, n_walked = 0, n_looks = 0;
    std::uint64_t n_rays() const { return light_.n_rays + n_checks_; }
    std::uint64_t n_listed() const { return outline_.n_found(); }

    void sample_paths(std::uint64_t begin, std::uint64_t end, BoundaryRows& rows) {
        for_chosen(streams::family(s_.seed, 5), share_, begin, end, [&](std::size_t path) {
            for_vertices(path, [&](const VertexState& x, int depth, const MediumStack& media, const Sampler& sampler) {
                ++n_samples;
                sample_vertex(x, path, depth, media, sampler);
                if (rays_.size() + 2 * most_points > PathBatch::capacity) finish(rows);
            });
        });
        finish(rows);
    }
    /// Adds the importance of the vertices of a path.
    void add_importance(std::size_t path, std::vector<double>& around, std::vector<double>& outline) {
        for_vertices(path, [&](const VertexState& x, int depth, const MediumStack&, const Sampler& sampler) {
            around.push_back(importance_around(x));
            outline.push_back(look(x, depth + 2, sampler) ? importance(x) : 0);
        });
    }

    /// Traces the light of the samples so far.
    void finish(BoundaryRows& rows) {
        light_.trace(rays_, [&](std::size_t i, const PathGraph& g, std::size_t& edge) {
            const Pending& p = pending_[sides_[i].pending_idx];
            const double factor = sides_[i].factor;
            const std::size_t begin = g.paths.first_vertex[i], end = g.paths.first_vertex[i + 1];
            if (begin == end) {
                // Light of an environment keeps its direction, or turns with its emitter.
                if (environment_ && s_.scene.environment_idx >= 0) {
                    s_.emitter_velocity(std::size_t(s_.scene.environment_idx), Pt(p.b.omega), v_light_);
                    for (std::size_t k = 0; k < s_.n(); ++k)
                        rates_[k] = swept(p.b.out, p.v_b[k] - p.v_s[k] - v_light_[k] * p.b.r);
                }
                light_.walk(i, edge, [&](const Spectrum& L, double opl) {
                    if (std::isfinite(opl))
                        add_emission(p, sides_[i], L, opl, rows);
                    else if (environment_)
                        add(p, Rgb<double>(L), -1, rates_, rows);
                });
                return;
            }
            const Pt x_l = position<double>(g, begin);
            const double r = length(x_l - p.x_s);
            const bool at_edge = bool(sides_[i].at_edge);
            const bool counts = surfaces_ && (at_edge || is_beside(p, g, begin, r));
            if (counts) {
                s_.far_velocity(g.vertices.shape[begin], g.vertices.primitive[begin], g.vertices.material[begin],
                                Vec(geometric_normal(g, begin)), at_edge ? p.b.p : x_l, p.x_s, p.v_s, p.turn, v_light_);
                for (std::size_t k = 0; k < s_.n(); ++k)
                    rates_[k] = swept(p.b.out, relative_velocity(at_edge ? 1 : std::min(p.b.r / r, 1.0), p.v_b[k],
                                                                 p.v_s[k], v_light_[k]));
            }
            if (s_.scene.nlos) {
                light_.walk_from_laser(i, edge, [&](const Spectrum& L, double opl, double laser_opl) {
                    if (counts) add(p, Rgb<double>(L) * Rgb<double>(factor), opl, rates_, rows, laser_opl);
                });
                return;
            }
            bool emitted_first = !is_black(rgb(g.paths.Le, i));
            light_.walk(i, edge, [&](const Spectrum& L, double opl) {
                if (std::exchange(emitted_first, false))
                    add_emission(p, sides_[i], L, opl, rows);
                else if (counts)
                    add(p, Rgb<double>(L) * Rgb<double>(factor), opl, rates_, rows);
            });
        });
        pending_.clear();
        sides_.clear();
        rays_.clear();
    }

  private:
    static constexpr int most_points = 16;  // of an outline

    BoundaryScene::Curve curve_of(const Pending& p) const {
        return {p.b.p, p.b.omega, p.b.r, p.b.shape_idx, &s_.edges(all_), p.b.edge, p.front, p.touched};
    }
    /// Whether the surface that a ray hits shows beside an edge, and its light belongs to it.
    bool is_beside(const Pending& p, const PathGraph& g, std::size_t hit, double r) const {
        const std::uint32_t shape = g.vertices.shape[hit], primitive = g.vertices.primitive[hit];
        const BoundaryScene::Curve curve = curve_of(p);
        const double depth = s_.touching_depth(curve, shape, primitive);
        return r > p.b.r - depth && (r > p.b.r + depth || !s_.ends_too(curve, shape, primitive));
    }

    /// Calls on_vertex(vertex, depth, media, sampler) for the vertices of a path.
    template <class OnVertex>
    void for_vertices(std::size_t path, OnVertex&& on_vertex) {
        const std::uint64_t seed = streams::family(s_.seed, 5);
        const std::size_t first = s_.graph.paths.first_vertex[path];
        MediumStack media;
        if (s_.scene.features.dielectric) media = s_.scene.sensor_media.at(s_.scene, camera_origin(s_.graph, path));
        walker_.walk_vertices(path, [&](const VertexState& x) {
            ++n_walked;
            const auto flags = s_.graph.vertices.flags[x.vertex];
            if ((flags & vertex_flag::attempted_bsdf) && has_smooth_lobe(x.at->bsdf))
                on_vertex(x, int(x.vertex - first), media, Sampler(SamplerKind::independent, seed, x.vertex, 0));
            if (s_.scene.features.dielectric && (flags & vertex_flag::continued)) follow(x, media);
        });
    }

    /// Lists the edges that a vertex sees.
    /// in:      edge_number  of the path's edge that starts there
    /// out:     whether there are any
    bool look(const VertexState& x, int edge_number, const Sampler& sampler) {
        ++n_looks;
        const int max_depth = s_.graph.tracing.max_depth;
        // The last edge reaches emitters alone: an environment, or an area light beside a seam.
        const bool seams_alone = edge_number == max_depth && !environment_;
        if (max_depth >= 0 && (edge_number > max_depth || (seams_alone && !s_.emitter_seams))) return false;
        RayEnd from = end_of(x);
        from.n = is_interface(*x.at->bsdf.model) ? Normal3f{} : facing(x.at->ng, x.at->wo);
        const Shaft shaft = Shaft::to_infinity(from);
        const auto moving = [](std::span<const Vec> v) {
            return std::any_of(v.begin(), v.end(), [](const Vec& x) { return !(x == Vec{}); });
        };
        // Rays cross the creases of what moves, and attached to surfaces, what lies behind an edge may move although
        // neither the edge nor the vertex does.
        const bool ends_move = moving(x.velocity) || moving(x.turn);
        all_ = !s_.attached.all_to_rays() || !s_.creases.empty() || ends_move;
        static const EdgeTree no_edges;
        bool any = outline_.collect(shaft, Pt(from.p), false, x.velocity, far_speed_,
                                    seams_alone ? no_edges : s_.edges(all_), all_, 1, sampler.pair(2).y);
        if (all_ && !seams_alone && !s_.creases.empty())
            any = outline_.add_creases(shaft, far_speed_, sampler.pair(2).x);
        if (surfaces_ && !s_.seams.empty()) any = outline_.add_seams(shaft, far_speed_, slide_, sampler.pair(3).x);
        return any;
    }

    RayEnd end_of(const VertexState& x) const {
        return {x.at->p, x.at->ng, s_.scene.shapes[s_.graph.vertices.shape[x.vertex]].hit_error};
    }

    static double largest(const Rgb<double>& beta) { return std::max({beta.r, beta.g, beta.b}); }
    double importance_around(const VertexState& x) const {
        double speed = 0;
        for (const Vec& v : x.velocity) speed += length(v);
        for (const double v : far_speed_) speed += Outline::part_of_behind * v;
        return largest(x.beta) * s_.motion_around(Pt(x.at->p), speed);
    }
    /// The same of what look() found.
    double importance(const VertexState& x) const { return largest(x.beta) * outline_.importance(); }

    void sample_vertex(const VertexState& x, std::size_t path, int depth, const MediumStack& arriving,
                       const Sampler& sampler) {
        const int edge_number = depth + 2;
        // A part of the looks does not depend on what is known from afar.
        constexpr double least = 1.0 / 32;
        const double known = importance_around(x),
                     looks = known < units_.around ? std::max(known / units_.around, least) : 1;
        const Point2f chosen = sampler.pair(4);
        if (!(double(chosen.y) < looks) || !look(x, edge_number, sampler)) return;
        // Points of the outline in proportion to what they may bring.
        const double wanted = std::min(importance(x) / (units_.outline * looks), double(most_points));
        const int n_points = int(wanted + double(chosen.x));
        const double weight = 1 / (wanted * looks * share_ * double(s_.graph.tracing.samples_per_pixel));
        for (int k = 0; k < n_points; ++k) {
            const Point2f u = sampler.pair(std::uint32_t(5 + 2 * k));
            Pending p;
            if (!outline_.sample({(float(k) + u.x) / float(n_points), u.y}, p.b)) continue;
            p.path = path;
            p.value = x.beta * Rgb<double>(weight);
            sample_point(x, p, k, edge_number, arriving, double(sampler.pair(std::uint32_t(6 + 2 * k)).x));
        }
    }

    /// Adds the rays of a point of the outline.
    /// in:      p  its point, and the value without the point's part;  k  its number;  u  uniform
    void sample_point(const VertexState& x, Pending& p, int k, int edge_number, const MediumStack& arriving, double u) {
        const ShadingPoint& at = *x.at;
        const Vector3f wi(p.b.omega);
        const Spectrum f_cos = f_cos_pdf(at, wi).f_cos;
        if (is_black(f_cos)) return;
        const RayEnd end = end_of(x);
        const double clearance = s_.clearance(p.b.p, p.b.r);
        // Nothing may lie between: to the open space beside a silhouette or above a crease.
        const Vec lift = p.b.seam        ? p.b.seam->lifted(p.b.omega)
                         : p.b.is_crease ? lifted(*p.b.edge, p.b.omega)
                                         : p.b.out / length(p.b.out);
        BoundaryScene::Sides sides;
        if (p.b.seam) {
            sides = s_.sides_of(*p.b.seam, p.b.p, p.b.omega, p.b.out);
        } else if (p.b.edge) {
            sides = s_.sides_of(s_.edges(all_).set(), *p.b.edge, p.b.p, p.b.omega, p.b.out);
        } else {
            sides.front.shape_idx = p.b.shape_idx;
            sides.front.u = float(std::cos(p.b.phi)), sides.front.v = float(std::sin(p.b.phi));
        }
        p.front = sides.front;
        BoundaryScene::Curve curve = curve_of(p);
        if (!s_.shows(curve, lift, !p.b.is_crease, [&](const Point3f& to) {
                ++n_checks_;
                const Ray ray = spawn_segment(end, {to});
                return s_.scene.occluded(ray) ? s_.scene.intersect(ray) : Hit{};
            }))
            return;

        p.vertex = x.vertex;
        p.opl = x.opl;
        p.camera_opl = x.camera_opl;
        p.value = p.value * Rgb<double>(f_cos) * Rgb<double>(1 / (p.b.r * p.b.r * p.b.density));
        p.x_s = Pt(at.p);
        p.v_s.assign(x.velocity.begin(), x.velocity.end());
        p.v_b.assign(outline_.velocity().begin(), outline_.velocity().end());
        s_.contact_velocity(curve, p.v_b);
        p.touched = curve.touched;
        p.turn.assign(x.turn.begin(), x.turn.end());
        MediumStack media = arriving;
        if (is_interface(*at.bsdf.model) && dot(at.n_side, wi) * dot(at.n_side, at.wo) < 0)
            media.pass(surface(x.vertex), dot(at.n_side, wi) < 0, *at.bsdf.model);
        const auto pending_idx = std::uint32_t(pending_.size());
        const GivenRay from_vertex{
            Ray{at.p, {}, 0, INFINITY}, {x.vertex, std::uint64_t(k)}, media, edge_number, {}, pixel_of(p)};
        // Points in front pass an edge of their own surface by as much as they slide. Creases were chosen by that.
        const double passes = p.b.is_crease ? 1 : s_.passing_share(s_.slide_share(p.b.shape_idx, p.b.r));
        if ((slide_ || p.b.seam) && u < passes) push(from_vertex, p, sides.front, pending_idx, -1 / passes);
        if (p.b.is_crease) {
            push(from_vertex, p, sides.back, pending_idx, 1);
        } else {
            const Vec beside = p.b.omega + p.b.out * (clearance / (length(p.b.out) * p.b.r));
            rays_.push_back(from_vertex);
            rays_.back().ray = spawn_ray(end, Vector3f(normalize(beside)));
            sides_.push_back({pending_idx, 1, {}});
        }
        pending_.push_back(std::move(p));
    }

    static Vec lifted(const Edge& edge, const Vec& view) {
        const Vec above = Vec(edge.n0) + Vec(edge.n1);
        return normalize(dot(above, view) > 0 ? -above : above);
    }

    /// Adds a ray that hits a known surface at the edge point.
    void push(const GivenRay& from_vertex, const Pending& p, Hit hit, std::uint32_t pending_idx, double factor) {
        if (!hit) return;
        const bool round = !p.b.edge && !p.b.seam;
        const Vec d = (round ? s_.front_of_round(p.b.shape_idx, p.b.p, p.b.omega) : p.b.p) - p.x_s;
        hit.t = float(length(d));
        rays_.push_back(from_vertex);
        rays_.back().ray.d = Vector3f(normalize(d));
        rays_.back().hit = hit;
        sides_.push_back({pending_idx, factor, hit});
    }

    SurfaceIdx surface(std::size_t vertex) const {
        return {s_.graph.vertices.shape[vertex], s_.graph.vertices.material[vertex]};
    }
    /// Moves the media past a vertex that the path crosses.
    void follow(const VertexState& x, MediumStack& media) const {
        const Lobe lobe = Lobe(s_.graph.vertices.lobe[x.vertex]);
        if (lobe != Lobe::delta_transmission && lobe != Lobe::glossy_transmission) return;
        const Vector3f wi = x.at->frame.to_local(continuation_direction(s_.graph, x.vertex));
        media.pass(surface(x.vertex), wi.z < 0, *x.at->bsdf.model);
    }

    /// Emission at the first hit belongs to the families of emitters, but for seams, which these do not look for. Points of
    /// emitters keep their places.
    void add_emission(const Pending& p, const Side& side, const Spectrum& L, double opl, BoundaryRows& rows) {
        if (!p.b.seam) return;
        s_.shape_velocity(side.at_edge.shape_idx, side.at_edge.primitive_idx, p.b.p, v_light_);
        for (std::size_t k = 0; k < s_.n(); ++k) emission_rates_[k] = swept(p.b.out, p.v_b[k] - v_light_[k]);
        add(p, Rgb<double>(L) * Rgb<double>(side.factor), opl, emission_rates_, rows);
    }

    std::uint64_t pixel_of(const Pending& p) const { return p.path % s_.graph.n_pixels(); }

    /// in:      laser_opl  share of opl that, like the camera's, may not count
    void add(const Pending& p, const Rgb<double>& L, double opl, std::span<const double> rates, BoundaryRows& rows,
             double laser_opl = 0) {
        if (std::all_of(rates.begin(), rates.end(), [](double r) { return r == 0; })) return;
        const bool arrives = opl >= 0 && std::isfinite(opl);
        rows.add(pixel_of(p), arrives ? p.opl + opl : -1, p.camera_opl + laser_opl, p.value * L, rates,
                 BoundaryFamily::indirect, p.path);
    }

    const BoundaryScene& s_;
    double share_;
    IndirectUnits units_;
    bool surfaces_, environment_, slide_;
    bool all_ = true;  // edges at rest were looked for, too
    Outline outline_;
    InteriorWalker walker_;
    RayLight light_;
    std::vector<Vec> v_light_;
    std::vector<double> rates_, emission_rates_, far_speed_;
    std::uint64_t n_checks_ = 0;
    std::vector<Pending> pending_;
    std::vector<Side> sides_;  // [ray]
    std::vector<GivenRay> rays_;
};

/// Returns the unit of which so many values are at least one, or with that probability where they are less.
double unit_of(std::vector<double> values, double share) {
    std::sort(values.begin(), values.end(), std::greater<>());
    double rest = std::accumulate(values.begin(), values.end(), 0.0);
    const double wanted = share * double(values.size());
    for (std::size_t k = 0; double(k) < wanted; ++k) {
        const double unit = rest / (wanted - double(k));
        if (values[k] <= unit) return unit;
        rest -= values[k];
    }
    return values.empty() ? 0 : values[std::size_t(wanted)];
}

}  // namespace

IndirectUnits indirect_units(const BoundaryScene& s, bool surfaces, bool environment) {
    // Listing an outline costs ten times as much as reading its vertex, and few vertices have most of the variance. The
    // optimum is flat.
    constexpr double look_from = 0.25, points = 0.4;
    constexpr std::uint64_t most_paths = 1024;
    const std::uint64_t n_paths = s.graph.n_paths(), n = std::min(n_paths, most_paths);
    Sampling sampling(s, 1, {}, surfaces, environment);
    std::vector<double> around, outline;
    // Evenly spaced: over all pixels, and over all samples of them.
    for (std::uint64_t i = 0; i < n; ++i) sampling.add_importance(i * n_paths / n, around, outline);
    return {unit_of(std::move(around), look_from), unit_of(std::move(outline), points)};
}

Effort add_indirect(const BoundaryScene& s, double share, const IndirectUnits& units, bool surfaces, bool environment,
                    std::vector<BoundaryRows>& rows, std::span<std::uint64_t> samples, app::Report& report) {
    tbb::enumerable_thread_specific<Sampling> workers([&] { return Sampling(s, share, units, surfaces, environment); });
    sample_in_chunks(s, s.graph.n_paths(), 16384, "edges in front of surfaces", workers, rows, report,
                     [](Sampling& worker, BoundaryRows& out, std::uint64_t begin, std::uint64_t end) {
                         worker.sample_paths(begin, end, out);
                     });
    Effort effort;
    std::uint64_t n_walked = 0, n_looks = 0, n_listed = 0;
    for (const Sampling& worker : workers) {
        effort.rays += worker.n_rays();
        n_walked += worker.n_walked, n_looks += worker.n_looks, n_listed += worker.n_listed();
        samples[std::size_t(BoundaryFamily::indirect)] += worker.n_samples;
    }
    effort.steps = 2 * n_walked / 5 + n_looks + n_listed / 5;
    return effort;
}

}  // namespace loom::derive
