// Families 2 and 4: from a point of an emitter, the silhouettes seen from there; behind each the surface on which the
// shadow moves, as the camera sees it (2), or as a stored vertex does by its lobes with a width (4).
//   integral of W f_cos Le swept cos_y / (r_y^2 cos_x) over edges and the emitter, r_y = |x_B y|,
// cos_x geometric. The importance W per area of the surface is h(film) scale cos_cam for the camera, and
// beta f_cos cos / r^2 for a stored vertex at distance r.

#include <tbb/enumerable_thread_specific.h>

#include <algorithm>

#include "stages/core/sampling/streams.h"
#include "stages/core/scene/scene.h"
#include "stages/core/tracing/vertex_rules.h"
#include "stages/derive/interior.h"
#include "stages/derive/shadow_points.h"

namespace loom::derive {
namespace {

using Vec = Vector3<double>;
using Pt = Point3<double>;

class OnFilm {
  public:
    OnFilm(const BoundaryScene& s, std::uint64_t n, const std::vector<double>& weights)
        : s_(s), n_(n), points_(s, weights, per_light_point), v_surface_(s.n()), rates_(s.n()) {}

    static constexpr int per_light_point = 32;

    std::uint64_t n_rays = 0;
    std::uint64_t all_rays() const { return n_rays + points_.n_rays; }
    std::uint64_t n_listed() const { return points_.n_listed(); }

    void sample(std::uint64_t i, BoundaryRows& rows) {
        // Seen from the camera, surfaces that move or slide make every edge matter.
        const bool all = s_.tangents.camera_moves() || s_.tangents.any_shape_moves() || points_.emitters_move();
        points_.sample(s_.sampler(2, i), s_.film_speed, all, 0, [&](const ShadowPoint& x) { shade(i, x, rows); });
    }

  private:
    void shade(std::uint64_t i, const ShadowPoint& x, BoundaryRows& rows) {
        const Scene& scene = s_.scene;
        const float reach = scene.sensor.filter_radius;
        const std::optional<FilmPoint> film = scene.sensor.project(x.at.p);
        if (!film || !(film->film.x >= -reach && film->film.x <= float(scene.sensor.width) + reach &&
                       film->film.y >= -reach && film->film.y <= float(scene.sensor.height) + reach))
            return;
        if (x.is_seen_from_emitter(Pt(film->from))) return;
        const ShadingPoint here = shading_point(scene, x.at, -film->d);
        const Spectrum f_cos = f_cos_pdf(here, Vector3f(-x.b.omega)).f_cos;
        if (is_black(f_cos)) return;
        const double cos_camera = std::abs(dot(Vec(x.at.ng), Vec(film->d)));
        if (!(cos_camera > 0)) return;
        ++n_rays;
        if (scene.occluded(spawn_segment(here.end(), {film->from}))) return;
        s_.film_velocity(x.at, Pt(film->from), Vec(film->d), v_surface_);
        if (!x.rates(v_surface_, rates_)) return;
        const Rgb<double> value = Rgb<double>(f_cos) * x.light * Rgb<double>(film->scale * cos_camera / double(n_));
        // A surface that the camera sees lies in the medium around the camera.
        const double eta = double(scene.sensor_media.at(scene, film->from).medium().ior),
                     camera_opl = eta * double(film->t), opl = x.infinite ? -1 : camera_opl + eta * x.r;
        for_pixels_at(scene.sensor, film->film, [&](std::uint64_t pixel, double h) {
            rows.add(pixel, opl, camera_opl, value * Rgb<double>(h), rates_, BoundaryFamily::edge_light, i);
        });
    }

    const BoundaryScene& s_;
    std::uint64_t n_;
    ShadowPoints points_;
    std::vector<Vec> v_surface_;
    std::vector<double> rates_;
};

/// Shadow points that many vertices choose from.
class Pool {
  public:
    explicit Pool(std::size_t n_parameters) : n_(n_parameters) {}

    void clear() {
        points_.clear(), v_edge_.clear(), v_emitter_.clear(), weight_.clear(), speed_.clear();
        for (std::vector<float>* column : {&x_, &y_, &z_, &nx_, &ny_, &nz_}) column->clear();
    }
    bool empty() const { return points_.empty(); }
    /// in:      speed      how fast light appears there, of any unit
    ///          reflected  share of the light that goes on, times its cosine
    void add(const ShadowPoint& p, double speed, double reflected) {
        const double weight = (p.light.r + p.light.g + p.light.b) * speed * reflected;
        if (!(weight > 0) || !std::isfinite(weight)) return;
        points_.push_back(p);
        v_edge_.insert(v_edge_.end(), p.v_edge.begin(), p.v_edge.end());
        v_emitter_.insert(v_emitter_.end(), p.v_emitter.begin(), p.v_emitter.end());
        weight_.push_back(float(weight)), speed_.push_back(float(speed));
        x_.push_back(p.at.p.x), y_.push_back(p.at.p.y), z_.push_back(p.at.p.z);
        nx_.push_back(p.at.ng.x), ny_.push_back(p.at.ng.y), nz_.push_back(p.at.ng.z);
    }
    /// Sets the references of the points, which borrow the pool, after the last add().
    void finish() {
        for (std::size_t i = 0; i < points_.size(); ++i) {
            points_[i].v_edge = ConstVelocities(v_edge_).subspan(i * n_, n_);
            points_[i].v_emitter = ConstVelocities(v_emitter_).subspan(i * n_, n_);
        }
        cumulative_.resize(points_.size());
    }

    /// A point that a vertex may choose.
    struct Candidate {
        const ShadowPoint* point;
        float speed;
        double probability;
    };
    /// Draws candidates by their light times both cosines over the square of the distance.
    /// in:      n  side of the surface at p that scatters; 0: both
    /// out:     none, or out.size()
    bool draw(const Point3f& p, const Normal3f& n, float u, std::span<Candidate> out) {
        const bool both = n == Normal3f{};
        float total = 0;
        for (std::size_t i = 0; i < points_.size(); ++i) {
            const float dx = x_[i] - p.x, dy = y_[i] - p.y, dz = z_[i] - p.z;
            const float r2 = dx * dx + dy * dy + dz * dz;
            const float cos_here = both ? std::sqrt(r2) : std::max(n.x * dx + n.y * dy + n.z * dz, 0.0f);
            const float cos_there = std::abs(nx_[i] * dx + ny_[i] * dy + nz_[i] * dz);
            total += r2 > 0 ? weight_[i] * cos_here * cos_there / (r2 * r2) : 0;
            cumulative_[i] = total;
        }
        // Where cosines of shading normals differ from these, a share keeps the weights bounded.
        constexpr float share = 0.1f;
        if (!(total > 0) || !std::isfinite(total)) return false;
        for (std::size_t k = 0; k < out.size(); ++k) {
            const float v = (float(k) + u) / float(out.size());
            const auto i = std::min(v < share ? std::size_t(v / share * float(points_.size()))
                                              : std::size_t(std::upper_bound(cumulative_.begin(), cumulative_.end(),
                                                                             (v - share) / (1 - share) * total) -
                                                            cumulative_.begin()),
                                    points_.size() - 1);
            const float weight = cumulative_[i] - (i > 0 ? cumulative_[i - 1] : 0);
            out[k] = {&points_[i], speed_[i],
                      double(share) / double(points_.size()) + (1 - double(share)) * double(weight) / double(total)};
        }
        return true;
    }

  private:
    std::size_t n_;
    std::vector<ShadowPoint> points_;
    std::vector<Vec> v_edge_, v_emitter_;                                        // [point, parameter]
    std::vector<float> x_, y_, z_, nx_, ny_, nz_, weight_, speed_, cumulative_;  // [point]
};

class Joined {
  public:
    Joined(const BoundaryScene& s, double share, const std::vector<double>& weights)
        : s_(s),
          share_(share),
          points_(s, weights, per_light_point),
          pool_(s.n()),
          walker_(s.graph, s.scene, s.tangents, s.attached),
          velocity_(s.n()),
          rates_(s.n()),
          far_speed_(s.surface_speed) {
        // A vertex that keeps its direction slides where the one before it moves, as first hits do with the camera.
        if (s.attached.any_slides()) far_speed_ = s.film_speed;
    }

    std::uint64_t n_rays = 0, n_samples = 0, n_walked = 0;
    std::uint64_t all_rays() const { return n_rays + points_.n_rays; }
    std::uint64_t n_listed() const { return points_.n_listed(); }

    /// Samples the paths of a chunk. They share a pool of shadow points, other chunks have others.
    void sample_chunk(std::uint64_t begin, std::uint64_t end, BoundaryRows& rows) {
        const int n = std::max(2, int(std::lround(most_light_points * std::sqrt(share_))));
        fill_pool(begin, 0, n);
        if (pool_.empty()) return;
        for_chosen(seed(), share_, begin, end, [&](std::uint64_t path) { sample_path(path, rows); });
    }
    /// Samples the paths of pixels that have laser spots, and so pools, of their own.
    void sample_pixels(std::uint64_t begin, std::uint64_t end, BoundaryRows& rows) {
        const std::uint64_t n_pixels = s_.graph.n_pixels(), spp = s_.graph.tracing.samples_per_pixel;
        // About as many shadow points as paths.
        const double wanted = share_ * double(spp) / per_light_point;
        const int n = int(std::clamp(std::round(wanted), 1.0, double(most_light_points)));
        for (std::uint64_t pixel = begin; pixel < end; ++pixel) {
            fill_pool(pixel, pixel, n);
            if (pool_.empty()) continue;
            for_chosen(seed(), share_, pixel * spp, (pixel + 1) * spp,
                       [&](std::uint64_t i) { sample_path(i % spp * n_pixels + pixel, rows); });
        }
    }

  private:
    static constexpr int most_light_points = 32;  // of a pool
    static constexpr int per_light_point = 16;
    static constexpr std::size_t n_candidates = 4;  // of a vertex

    std::uint64_t seed() const { return streams::family(s_.seed, 7); }

    /// Whether the capture or depth limit has paths of this many edges.
    bool has_paths_of(int n_edges) const {
        const int max_depth = s_.graph.tracing.max_depth;
        if (max_depth >= 0 && n_edges > max_depth) return false;
        return !s_.scene.nlos || s_.scene.nlos->filter_depth < 0 || n_edges == s_.scene.nlos->filter_depth;
    }

    void sample_path(std::size_t path, BoundaryRows& rows) {
        const std::size_t first = s_.graph.paths.first_vertex[path];
        const int further = s_.scene.nlos ? 4 : 3;  // a laser's spot is a vertex, too
        walker_.walk_vertices(path, [&](const VertexState& x) {
            ++n_walked;
            if (!has_paths_of(int(x.vertex - first) + further)) return;
            if (!(s_.graph.vertices.flags[x.vertex] & vertex_flag::attempted_bsdf) || !has_smooth_lobe(x.at->bsdf))
                return;
            ++n_samples;
            join(x, path, Sampler(SamplerKind::independent, seed(), x.vertex, 0).pair(0), rows);
        });
    }

    /// in:      first  number of the pool
    ///          pixel  of the film, in an NLOS capture
    void fill_pool(std::uint64_t first, std::uint64_t pixel, int n_light_points) {
        pool_.clear();
        n_light_points_ = n_light_points;
        const bool all = s_.tangents.any_shape_moves() || points_.emitters_move() ||
                         (s_.tangents.camera_moves() && s_.attached.any_slides());
        double slide = 0;
        for (const double v : far_speed_) slide += v;
        for (int k = 0; k < n_light_points; ++k)
            points_.sample(s_.sampler(8, first * most_light_points + std::uint64_t(k)), far_speed_, all, pixel,
                           [&](const ShadowPoint& p) {
                               s_.shape_velocity(p.at.shape_idx, p.at.primitive_idx, Pt(p.at.p), velocity_);
                               p.rates(velocity_, rates_);
                               double speed = 0.05 * slide * length(p.b.out);
                               for (const double rate : rates_) speed += std::abs(rate);
                               pool_.add(p, speed, reflected(p));
                           });
        pool_.finish();
    }
    /// Returns the share of the light of a shadow point that goes on, times its cosine: where it goes is not known yet.
    double reflected(const ShadowPoint& p) const {
        const Vector3f to_light(-p.b.omega);
        const ShadingPoint there = shading_point(s_.scene, p.at, to_light);
        const Spectrum all = albedo(there.bsdf, there.wo_local);
        constexpr double least = 0.01;
        return (double(all.r + all.g + all.b) / 3 + least) * std::abs(double(dot(p.at.ng, to_light)));
    }

    /// A shadow point as a vertex sees it if nothing is between.
    struct Join {
        const ShadowPoint* to = nullptr;
        Vector3f wi;
        double r = 0;
        Rgb<double> value;  // over the throughput of the vertex and the rate
        double share = 0;   // of being taken, of any unit
    };
    Join join_to(const ShadingPoint& at, std::size_t material, const Pool::Candidate& candidate) const {
        const ShadowPoint& to = *candidate.point;
        Join join;
        const Vec d = Pt(to.at.p) - Pt(at.p);
        const double r2 = length2(d);
        join.r = std::sqrt(r2);
        if (!(r2 > 0) || to.is_seen_from_emitter(Pt(at.p))) return {};
        const bool area = s_.scene.emitters[to.emitter_idx].kind == EmitterKind::area;
        if (area && !s_.joins(join.r, material, to.at.material_idx)) return {};
        join.wi = Vector3f(d / join.r);
        const Spectrum f_here = f_cos_pdf(at, join.wi).f_cos;
        if (is_black(f_here)) return {};
        const ShadingPoint there = shading_point(s_.scene, to.at, -join.wi);
        const Spectrum f_there = f_cos_pdf(there, Vector3f(-to.b.omega)).f_cos;
        const double cos_there = std::abs(dot(Vec(to.at.ng), Vec(join.wi)));
        join.value = Rgb<double>(f_here) * Rgb<double>(f_there) * to.light *
                     Rgb<double>(cos_there / (r2 * candidate.probability));
        join.share = (join.value.r + join.value.g + join.value.b) * double(candidate.speed);
        join.to = &to;
        return join;
    }

    void join(const VertexState& x, std::size_t path, Point2f u, BoundaryRows& rows) {
        const ShadingPoint& at = *x.at;
        const Normal3f side = is_interface(*at.bsdf.model) ? Normal3f{} : facing(at.ng, at.wo);
        std::array<Pool::Candidate, n_candidates> candidates;
        if (!pool_.draw(at.p, side, u.x, candidates)) return;
        // Which lobes see the light shows only now: of several points one is taken, and stands for all.
        std::array<Join, n_candidates> joins;
        double total = 0;
        for (std::size_t k = 0; k < n_candidates; ++k) {
            joins[k] = join_to(at, s_.graph.vertices.material[x.vertex], candidates[k]);
            total += joins[k].share;
        }
        if (!(total > 0) || !std::isfinite(total)) return;
        double left = double(u.y) * total;
        const Join* join = nullptr;
        for (const Join& one : joins) {
            if (!(one.share > 0)) continue;
            join = &one;
            if ((left -= one.share) < 0) break;
        }
        const ShadowPoint& to = *join->to;
        s_.far_velocity(to.at.shape_idx, to.at.primitive_idx, to.at.material_idx, Vec(to.at.ng), Pt(to.at.p), Pt(at.p),
                        x.velocity, x.turn, velocity_);
        if (!to.rates(velocity_, rates_)) return;
        const ShadingPoint there = shading_point(s_.scene, to.at, -join->wi);
        const float hit_error = s_.scene.shapes[s_.graph.vertices.shape[x.vertex]].hit_error;
        ++n_rays;
        if (s_.scene.occluded(spawn_segment(RayEnd{at.p, at.ng, hit_error}, there.end()))) return;
        const double taken = double(n_candidates) * join->share / total;
        const Rgb<double> value =
            x.beta * join->value *
            Rgb<double>(1 / (taken * share_ * n_light_points_ * double(s_.graph.tracing.samples_per_pixel)));
        const double eta = index_towards(arriving_index(s_.graph, x.vertex), at, join->wi),
                     eta_light = index_towards(eta, there, Vector3f(-to.b.omega)), laser_opl = eta_light * to.laser_r,
                     opl = to.infinite ? -1 : x.opl + eta * join->r + eta_light * to.r + laser_opl;
        rows.add(path % s_.graph.n_pixels(), opl, x.camera_opl + laser_opl, value, rates_, BoundaryFamily::joined_light,
                 path);
    }

    const BoundaryScene& s_;
    double share_;
    int n_light_points_ = 0;  // of the pool
    ShadowPoints points_;
    Pool pool_;
    InteriorWalker walker_;
    std::vector<Vec> velocity_;
    std::vector<double> rates_, far_speed_;
};

}  // namespace

Effort add_edge_light(const BoundaryScene& s, std::uint64_t n_samples, const std::vector<char>& wanted,
                      std::vector<BoundaryRows>& rows, std::span<std::uint64_t> samples, app::Report& report) {
    const std::vector<double> weights = emitter_weights(s.scene, wanted);
    tbb::enumerable_thread_specific<OnFilm> workers([&] { return OnFilm(s, n_samples, weights); });
    sample_in_chunks(s, n_samples, 256, "silhouettes visible from emitters", workers, rows, report,
                     [](OnFilm& worker, BoundaryRows& out, std::uint64_t begin, std::uint64_t end) {
                         for (std::uint64_t k = begin; k < end; ++k) worker.sample(k, out);
                     });
    samples[std::size_t(BoundaryFamily::edge_light)] += n_samples;
    Effort effort;
    std::uint64_t n_listed = 0;
    for (const OnFilm& worker : workers) effort.rays += worker.all_rays(), n_listed += worker.n_listed();
    effort.steps = n_samples * OnFilm::per_light_point / 2 + n_listed / 8;
    return effort;
}

Effort add_joined_light(const BoundaryScene& s, double share, const std::vector<char>& wanted,
                        std::vector<BoundaryRows>& rows, std::span<std::uint64_t> samples, app::Report& report) {
    const std::vector<double> weights = emitter_weights(s.scene, wanted);
    tbb::enumerable_thread_specific<Joined> workers([&] { return Joined(s, std::min(share, 1.0), weights); });
    const bool by_pixel = s.scene.nlos && s.scene.nlos->laser_points.size() > 1;
    sample_in_chunks(s, by_pixel ? s.graph.n_pixels() : s.graph.n_paths(), by_pixel ? 8 : 16384,
                     "shadows behind stored vertices", workers, rows, report,
                     [by_pixel](Joined& worker, BoundaryRows& out, std::uint64_t begin, std::uint64_t end) {
                         by_pixel ? worker.sample_pixels(begin, end, out) : worker.sample_chunk(begin, end, out);
                     });
    Effort effort;
    std::uint64_t n_walked = 0, n_listed = 0;
    for (const Joined& worker : workers) {
        effort.rays += worker.all_rays();
        n_walked += worker.n_walked, n_listed += worker.n_listed();
        samples[std::size_t(BoundaryFamily::joined_light)] += worker.n_samples;
    }
    effort.steps = n_walked + n_listed / 8;
    return effort;
}

}  // namespace loom::derive
