// Family 0: edges as the camera sees them. Light jumps across an edge that moves on the film: silhouettes, borders, and
// creases of moving or sliding surfaces.
//   integral over edges of h(film) v_film . n (L_front - L_back) along the film; both sides by paths of equal numbers

#include <tbb/enumerable_thread_specific.h>

#include <algorithm>
#include <optional>

#include "stages/core/app/report.h"
#include "stages/core/compute/parallel.h"
#include "stages/core/edges/boundary.h"
#include "stages/core/sampling/streams.h"
#include "stages/derive/film_map.h"
#include "stages/derive/given_rays.h"

namespace loom::derive {
namespace {

using Vec = Vector3<double>;
using Pt = Point3<double>;

/// A visible curve: a part of an edge, straight on the film, or a round.
struct FilmCurve {
    std::uint32_t index;  // of the edge, or of the round
    bool is_round;
    Vec a, b;  // ends of the part of an edge, camera coordinates
    Point2<double> film_a, film_b;
    double s_a = 0, s_b = 1;  // on the edge
};

/// Clips a segment in camera coordinates to the space in front of the near plane, and on the film to its borders.
std::optional<FilmCurve> clipped(const FilmMap& map, const Sensor& sensor, const Edge& edge) {
    FilmCurve curve{};
    const Vec a = map.in_camera(Pt(edge.a)), b = map.in_camera(Pt(edge.b));
    double lo = 0, hi = 1;
    const double near = sensor.near_clip;
    if (a.z < near && b.z < near) return std::nullopt;
    if (a.z < near) lo = (near - a.z) / (b.z - a.z);
    if (b.z < near) hi = (near - a.z) / (b.z - a.z);
    const auto at = [&](double s) { return a + (b - a) * s; };
    const Vec p = at(lo), q = at(hi);
    const Point2<double> fp = map.film(p), fq = map.film(q);
    // Liang and Barsky, on the film.
    double t0 = 0, t1 = 1;
    const double reach = sensor.filter_radius;
    const auto cut = [&](double from, double to, double low, double high) {
        const double d = to - from;
        if (d == 0) return from >= low && from <= high;
        double enter = (low - from) / d, leave = (high - from) / d;
        if (enter > leave) std::swap(enter, leave);
        t0 = std::max(t0, enter);
        t1 = std::min(t1, leave);
        return t0 < t1;
    };
    if (!cut(fp.x, fq.x, -reach, sensor.width + reach) || !cut(fp.y, fq.y, -reach, sensor.height + reach))
        return std::nullopt;
    // Positions on the film are projective in the parameter of the edge.
    const auto on_edge = [&](double t) {
        if (!map.perspective()) return lo + (hi - lo) * t;
        const double s = t * p.z / ((1 - t) * q.z + t * p.z);
        return lo + (hi - lo) * s;
    };
    curve.s_a = on_edge(t0), curve.s_b = on_edge(t1);
    curve.a = at(curve.s_a), curve.b = at(curve.s_b);
    curve.film_a = map.film(curve.a), curve.film_b = map.film(curve.b);
    return curve;
}

/// Whether the light of a shared edge's faces differs: their shading normals do.
bool is_crease(const Scene& scene, const EdgeSet& set, const Edge& edge) {
    const Mesh& mesh = scene.shapes[edge.shape_idx].mesh;
    if (mesh.normals.empty()) return true;
    const std::span<const std::uint32_t> faces = set.faces_of(edge);
    if (faces.size() < 2) return true;
    for (const Point3f& end : {edge.a, edge.b}) {
        Normal3f first;
        bool known = false;
        for (const std::uint32_t face : faces)
            for (int corner = 0; corner < 3; ++corner) {
                const std::uint32_t i = mesh.indices[3 * std::size_t(face) + std::size_t(corner)];
                if (!(mesh.positions[i] == end)) continue;
                if (known && length(Vector3f(mesh.normals[i]) - Vector3f(first)) > 1e-4f) return true;
                first = mesh.normals[i];
                known = true;
            }
    }
    return false;
}

class Primary {
  public:
    Primary(const BoundaryScene& s) : s_(s), map_(s.scene.sensor), tree_(s.edges(s.tangents.camera_moves())) {
        const Sensor& sensor = s.scene.sensor;
        const bool all = s.tangents.camera_moves();
        const Vec axis =
            normalize(Vec{sensor.world_from_camera[2], sensor.world_from_camera[6], sensor.world_from_camera[10]});
        std::vector<Vec> v(s.n());
        std::vector<double> weights;
        for (std::uint32_t i = 0; i < tree_.n_edges(); ++i) {
            const Edge& edge = tree_.edge(i);
            const bool silhouette =
                map_.perspective() ? is_silhouette(edge, Pt(sensor.origin)) : is_silhouette_along(edge, -axis);
            if (!silhouette && !is_crease(s.scene, tree_.set(), edge)) continue;
            std::optional<FilmCurve> curve = clipped(map_, sensor, edge);
            if (!curve) continue;
            curve->index = i;
            s.edge_velocity(tree_.set(), edge, 0.5 * (curve->s_a + curve->s_b), v);
            const double weight = importance(*curve, edge.point(0.5 * (curve->s_a + curve->s_b)), v);
            if (!(weight > 0)) continue;
            curves_.push_back(*curve);
            weights.push_back(weight);
        }
        rounds_ = map_.perspective() ? s.rounds_from(Pt(sensor.origin), all) : s.rounds_along(-axis, all);
        for (std::uint32_t i = 0; i < rounds_.size(); ++i) {
            FilmCurve curve{};
            curve.index = i;
            curve.is_round = true;
            double weight = 0;
            constexpr int looked_at = 64;
            for (int k = 0; k < looked_at; ++k) {
                const double phi = 2 * pi_double * (k + 0.5) / looked_at;
                const Vec c = map_.in_camera(rounds_[i].point(phi));
                if (!(c.z > sensor.near_clip)) continue;
                const Point2<double> f = map_.film(c), along = map_.velocity(c, rounds_[i].tangent(phi));
                if (f.x < 0 || f.y < 0 || f.x > sensor.width || f.y > sensor.height) continue;
                weight += std::hypot(along.x, along.y) * 2 * pi_double / looked_at;
            }
            if (!(weight > 0)) continue;
            curves_.push_back(curve);
            weights.push_back(weight * speed_of_round(rounds_[i], v));
        }
        double sum = 0;
        for (const double w : weights) sum += w;
        if (sum > 0) choice_ = Distribution1(weights);
    }

    bool empty() const { return choice_.size() == 0; }

    /// A point of a curve on the film.
    struct Sample {
        Point2<double> film;
        Pt p;
        Vec camera;
        Point2<double> normal;  // unit, on the film, away from the occluder
        std::uint32_t shape_idx = 0;
        double density = 0;  // per pixel of length
        std::vector<double> rates;
    };
    bool sample(Point2f u, float u_place, std::vector<Vec>& v, Sample& out) const {
        float choice = u.x;
        const std::size_t k = choice_.sample(choice);
        const FilmCurve& curve = curves_[k];
        const Sensor& sensor = s_.scene.sensor;
        Vec outward_dir;
        Point2<double> along;
        if (curve.is_round) {
            const Round& round = rounds_[curve.index];
            const double phi = 2 * pi_double * double(u_place);
            out.p = round.point(phi);
            out.camera = map_.in_camera(out.p);
            if (!(out.camera.z > sensor.near_clip)) return false;
            out.film = map_.film(out.camera);
            along = map_.velocity(out.camera, round.tangent(phi));
            const double speed = std::hypot(along.x, along.y);
            if (!(speed > 0)) return false;
            along = {along.x / speed, along.y / speed};
            out.density = double(choice_.pmf(k)) / (2 * pi_double * speed);
            outward_dir = outward(normalize(round.tangent(phi)), direction(out.p), round.middle - out.p);
            out.shape_idx = round.shape_idx;
            s_.shape_velocity(round.shape_idx, 0, out.p, v);
        } else {
            const double t = double(u_place);
            const double s_on = map_.perspective() ? t * curve.a.z / ((1 - t) * curve.b.z + t * curve.a.z) : t;
            const double s = curve.s_a + (curve.s_b - curve.s_a) * s_on;
            const Edge& edge = tree_.edge(curve.index);
            out.p = edge.point(s);
            out.camera = map_.in_camera(out.p);
            out.film = map_.film(out.camera);
            along = {curve.film_b.x - curve.film_a.x, curve.film_b.y - curve.film_a.y};
            const double len = std::hypot(along.x, along.y);
            if (!(len > 0)) return false;
            along = {along.x / len, along.y / len};
            out.density = double(choice_.pmf(k)) / len;
            outward_dir = outward(edge, direction(out.p));
            out.shape_idx = edge.shape_idx;
            s_.edge_velocity(tree_.set(), edge, s, v);
        }
        out.normal = {-along.y, along.x};
        const Point2<double> outside = map_.velocity(out.camera, outward_dir);
        if (outside.x * out.normal.x + outside.y * out.normal.y < 0) out.normal = {along.y, -along.x};
        film_rates(out, v);
        return std::any_of(out.rates.begin(), out.rates.end(), [](double r) { return r != 0; });
    }

    const FilmMap& map() const { return map_; }

  private:
    Vec direction(const Pt& p) const {
        if (map_.perspective()) return normalize(p - Pt(s_.scene.sensor.origin));
        const auto& m = s_.scene.sensor.world_from_camera;
        return normalize(Vec{m[2], m[6], m[10]});
    }
    /// Speed of the curve on the film along its normal.
    void film_rates(Sample& out, std::vector<Vec>& v) const {
        for (const auto& [k, motion] : s_.tangents.camera) v[k] = v[k] - motion.at(out.p);
        out.rates.assign(s_.n(), 0);
        for (std::size_t k = 0; k < s_.n(); ++k) {
            const Point2<double> f = map_.velocity(out.camera, v[k]);
            out.rates[k] = f.x * out.normal.x + f.y * out.normal.y;
        }
        const Point2<double> lens = map_.lens_velocity(out.camera);
        for (const auto& [k, relative] : s_.tangents.lens)
            out.rates[k] += relative * (lens.x * out.normal.x + lens.y * out.normal.y);
    }
    double importance(const FilmCurve& curve, const Pt& middle, std::vector<Vec>& v) const {
        Sample at;
        at.p = middle;
        at.camera = map_.in_camera(middle);
        const Point2<double> along{curve.film_b.x - curve.film_a.x, curve.film_b.y - curve.film_a.y};
        const double len = std::hypot(along.x, along.y);
        if (!(len > 0)) return 0;
        at.normal = {-along.y / len, along.x / len};
        film_rates(at, v);
        double sum = 0;
        for (std::size_t k = 0; k < s_.n(); ++k) {
            const Point2<double> f = map_.velocity(at.camera, v[k]);
            sum += std::abs(at.rates[k]) + 0.02 * std::hypot(f.x, f.y);
        }
        return len * sum;
    }
    double speed_of_round(const Round& round, std::vector<Vec>& v) const {
        s_.shape_velocity(round.shape_idx, 0, round.middle, v);
        Sample at;
        at.p = round.middle;
        at.camera = map_.in_camera(round.middle);
        if (!(at.camera.z > 0)) return 1;
        at.normal = {1, 0};
        film_rates(at, v);
        double sum = 1e-6;
        for (std::size_t k = 0; k < s_.n(); ++k) {
            const Point2<double> f = map_.velocity(at.camera, v[k]);
            // A scaled or turned round moves at its rim, too.
            s_.shape_velocity(round.shape_idx, 0, round.point(0), v);
            const Point2<double> rim = map_.velocity(map_.in_camera(round.point(0)), v[k]);
            sum += std::hypot(f.x, f.y) + std::hypot(rim.x, rim.y);
        }
        return sum;
    }

    const BoundaryScene& s_;
    FilmMap map_;
    const EdgeTree& tree_;
    std::vector<Round> rounds_;
    std::vector<FilmCurve> curves_;
    Distribution1 choice_;
};

/// State of one thread.
struct Worker {
    RayLight light;
    std::vector<GivenRay> rays;
    std::vector<Primary::Sample> samples;
    std::vector<std::uint64_t> sample_ids;
    std::vector<Vec> v;
    std::uint64_t n_checks = 0;

    explicit Worker(const BoundaryScene& s) : light(s, streams::family(s.options.seed, 0)), v(s.n()) {}
};

}  // namespace

std::uint64_t add_primary(const BoundaryScene& s, std::uint64_t n_samples, std::vector<BoundaryRows>& rows,
                          std::span<std::uint64_t> samples, app::Report& report) {
    const Primary primary(s);
    if (primary.empty()) return 0;
    const Scene& scene = s.scene;
    constexpr std::uint64_t chunk = PathBatch::capacity / 2;
    const std::size_t first = rows.size();
    rows.resize(first + (n_samples + chunk - 1) / chunk);
    app::Progress progress(report, "edges seen by the camera", n_samples);
    // Rays pass the edge by this many pixels.
    const double beside = 2e-5 * primary.map().pixels_per_radian();
    tbb::enumerable_thread_specific<Worker> workers([&] { return Worker(s); });
    parallel_chunks(n_samples, chunk, s.options.threads, [&](std::uint64_t i, std::uint64_t begin, std::uint64_t end) {
        Worker& w = workers.local();
        w.rays.clear();
        w.samples.clear();
        w.sample_ids.clear();
        for (std::uint64_t k = begin; k < end; ++k) {
            const Sampler sampler(SamplerKind::independent, streams::family(s.options.seed, 4), k, 0);
            Primary::Sample sample;
            if (!primary.sample(sampler.pair(0), sampler.pair(1).x, w.v, sample)) continue;
            const auto ray = [&](double side) {
                const Ray camera = primary.map().ray(scene.sensor, {sample.film.x + side * beside * sample.normal.x,
                                                                    sample.film.y + side * beside * sample.normal.y});
                return GivenRay{camera, {k, 0}, scene.sensor_media.at(scene, camera.o), 1};
            };
            const GivenRay front = ray(-1);
            const Hit hit = scene.intersect_from_camera(front.ray);
            ++w.n_checks;
            const double r = length(sample.p - Pt(front.ray.o));
            if (!hit || hit.shape_idx != sample.shape_idx || !(double(hit.t) > r * (1 - 1e-3))) continue;
            w.rays.push_back(front);
            w.rays.push_back(ray(1));
            w.samples.push_back(std::move(sample));
            w.sample_ids.push_back(k);
        }
        w.light.trace(w.rays, [&](std::size_t path, const PathGraph&, std::size_t& edge) {
            const Primary::Sample& at = w.samples[path / 2];
            const double sign = path % 2 == 0 ? 1 : -1;
            w.light.walk(path, edge, [&](const Spectrum& L, double opl) {
                for_pixels_at(scene.sensor, {float(at.film.x), float(at.film.y)}, [&](std::uint64_t pixel, double h) {
                    rows[first + i].add(pixel, std::isfinite(opl) ? opl : -1,
                                        Rgb<double>(L) * Rgb<double>(sign * h / (at.density * double(n_samples))),
                                        at.rates, BoundaryFamily::primary, w.sample_ids[path / 2]);
                });
            });
        });
        progress.add(end - begin);
    });
    samples[std::size_t(BoundaryFamily::primary)] += n_samples;
    std::uint64_t rays = 0;
    for (const Worker& worker : workers) rays += worker.n_checks + worker.light.n_rays;
    return rays;
}

}  // namespace loom::derive
