// Family 0: edges as the camera sees them. Light jumps across a curve that moves on the film: silhouettes, borders,
// creases of moving or sliding surfaces, lines where surfaces cut each other, and the terminators of smooth shading, where
// an interpolated normal turns away from the camera before the surface does, so that a one-sided surface is black.
//   integral over curves of h(film) v_film . n (L_front - L_back) along the film; both sides by paths of equal numbers

#include <tbb/enumerable_thread_specific.h>

#include <algorithm>
#include <optional>

#include "stages/core/edges/boundary.h"
#include "stages/core/sampling/streams.h"
#include "stages/derive/film_map.h"
#include "stages/derive/given_rays.h"

namespace loom::derive {
namespace {

using Vec = Vector3<double>;
using Pt = Point3<double>;

/// A visible curve: a part of an edge, straight on the film, a round, or the terminator within a triangle.
struct FilmCurve {
    enum class Kind : std::uint8_t { edge, seam, round, terminator } kind = Kind::edge;
    std::uint32_t index = 0;      // of the edge, the seam, the round, or the triangle of a shape
    std::uint32_t shape_idx = 0;  // of a terminator
    // Of an edge or a seam:
    Vec a, b;  // ends of its part, camera coordinates
    Point2<double> film_a, film_b;
    double s_a = 0, s_b = 1;  // on the line
};

/// Clips a segment in camera coordinates to the space in front of the near plane, and on the film to its borders.
std::optional<FilmCurve> clipped(const FilmMap& map, const Sensor& sensor, const Pt& from, const Pt& to) {
    FilmCurve curve;
    const Vec a = map.in_camera(from), b = map.in_camera(to);
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

/// Returns the share of a straight line between its ends, given that of its image.
double share_on_line(const FilmMap& map, const FilmCurve& curve, double on_film) {
    return map.perspective() ? on_film * curve.a.z / ((1 - on_film) * curve.b.z + on_film * curve.a.z) : on_film;
}

/// Returns the parts of a straight curve, equally long on the film: the speed of an edge that turns has a zero somewhere,
/// so that one speed for all of it would be wrong.
std::vector<FilmCurve> parts_of(const FilmMap& map, const FilmCurve& whole) {
    constexpr double length_px = 2, most = 16;
    const double len = std::hypot(whole.film_b.x - whole.film_a.x, whole.film_b.y - whole.film_a.y);
    const int n = int(std::clamp(std::ceil(len / length_px), 1.0, most));
    std::vector<FilmCurve> parts(std::size_t(n), whole);
    for (int i = 1; i < n; ++i) {
        FilmCurve &before = parts[std::size_t(i - 1)], &after = parts[std::size_t(i)];
        const double s = share_on_line(map, whole, double(i) / n);
        before.s_b = after.s_a = whole.s_a + (whole.s_b - whole.s_a) * s;
        before.b = after.a = whole.a + (whole.b - whole.a) * s;
        before.film_b = after.film_a = map.film(after.a);
    }
    return parts;
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
            if (!silhouette && !s.is_crease(tree_.set(), edge)) continue;
            std::optional<FilmCurve> curve = clipped(map_, sensor, Pt(edge.a), Pt(edge.b));
            if (!curve) continue;
            curve->index = i;
            for (const FilmCurve& part : parts_of(map_, *curve)) {
                const double middle = 0.5 * (part.s_a + part.s_b);
                s.edge_velocity(tree_.set(), edge, middle, v);
                add_curve(part, importance(part, edge.point(middle), v), weights);
            }
        }
        // Without a motion of the camera, those whose surfaces do not move relative to each other may move together.
        for (std::uint32_t i = 0; i < s.seams.size(); ++i) {
            const Seam& seam = s.seams[i];
            std::optional<FilmCurve> curve = clipped(map_, sensor, Pt(seam.a), Pt(seam.b));
            if (!curve) continue;
            curve->kind = FilmCurve::Kind::seam;
            curve->index = i;
            for (const FilmCurve& part : parts_of(map_, *curve)) {
                const Pt middle = seam.point(0.5 * (part.s_a + part.s_b));
                s.seam_velocity(seam, middle, v);
                add_curve(part, importance(part, middle, v), weights);
            }
        }
        rounds_ = map_.perspective() ? s.rounds_from(Pt(sensor.origin), all) : s.rounds_along(-axis, all);
        for (std::uint32_t i = 0; i < rounds_.size(); ++i) {
            FilmCurve curve;
            curve.index = i;
            curve.kind = FilmCurve::Kind::round;
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
            add_curve(curve, weight * speed_of_round(rounds_[i], v), weights);
        }
        add_terminators(all, weights);
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
        Vec beside;             // unit, in space, off the surfaces that meet at the point
        double density = 0;     // per pixel of length
        std::vector<double> rates;
        Hit front, back;  // surfaces that end at the curve, on its two sides; none: whatever a ray beside it hits
        Pt front_p;       // where the ray to `front` ends
        const Edge* edge = nullptr;
        Hit touched;  // BoundaryScene::Curve
    };
    bool sample(Point2f u, float u_place, std::vector<Vec>& v, Sample& out) const {
        out = {};
        float choice = u.x;
        const std::size_t k = choice_.sample(choice);
        const FilmCurve& curve = curves_[k];
        const Sensor& sensor = s_.scene.sensor;
        Vec outward_dir;
        Point2<double> along;
        if (curve.kind == FilmCurve::Kind::terminator)
            return sample_terminator(curve, double(choice_.pmf(k)), u, u_place, v, out);
        if (curve.kind == FilmCurve::Kind::round) {
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
            out.front.shape_idx = round.shape_idx;
            out.front_p = s_.front_of_round(round.shape_idx, out.p, direction(out.p));
            if (s_.scene.shapes[round.shape_idx].kind == ShapeKind::disk)
                out.front.u = float(std::cos(phi)), out.front.v = float(std::sin(phi));
            s_.shape_velocity(round.shape_idx, 0, out.p, v);
        } else {
            const double s = curve.s_a + (curve.s_b - curve.s_a) * share_on_line(map_, curve, double(u_place));
            const bool is_seam = curve.kind == FilmCurve::Kind::seam;
            out.p = is_seam ? s_.seams[curve.index].point(s) : tree_.edge(curve.index).point(s);
            out.camera = map_.in_camera(out.p);
            out.film = map_.film(out.camera);
            along = {curve.film_b.x - curve.film_a.x, curve.film_b.y - curve.film_a.y};
            const double len = std::hypot(along.x, along.y);
            if (!(len > 0)) return false;
            along = {along.x / len, along.y / len};
            out.density = double(choice_.pmf(k)) / len;
            BoundaryScene::Sides sides;
            if (is_seam) {
                const Seam& seam = s_.seams[curve.index];
                outward_dir = cross(normalize(Pt(seam.b) - Pt(seam.a)), direction(out.p));
                sides = s_.sides_of(seam, out.p, direction(out.p), outward_dir);
                s_.seam_velocity(seam, out.p, v);
            } else {
                const Edge& edge = tree_.edge(curve.index);
                out.edge = &edge;
                outward_dir = outward(edge, direction(out.p));
                sides = s_.sides_of(tree_.set(), edge, out.p, direction(out.p), outward_dir);
                s_.edge_velocity(tree_.set(), edge, s, v);
            }
            out.front = sides.front, out.back = sides.back;
            out.front_p = out.p;
        }
        out.beside = lifted(curve, outward_dir, direction(out.p));
        out.normal = {-along.y, along.x};
        const Point2<double> outside = map_.velocity(out.camera, outward_dir);
        if (outside.x * out.normal.x + outside.y * out.normal.y < 0) out.normal = {along.y, -along.x};
        film_rates(out, v);
        return std::any_of(out.rates.begin(), out.rates.end(), [](double r) { return r != 0; });
    }

    /// Computes the speed of a curve on the film along its normal.
    /// in:      v  its velocities, which are changed
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

    const FilmMap& map() const { return map_; }
    const EdgeTree& edges() const { return tree_; }

  private:
    /// The function whose zero is the terminator of a triangle, N . (eye - p), over barycentric coordinates.
    struct Terminator {
        Pt p0;
        Vec e1, e2, n0, n_u, n_v;
        Pt eye;
        Vec axis;  // orthographic: the direction to the eye
        bool perspective;

        Vec normal(double u, double v) const { return n0 + n_u * u + n_v * v; }
        Pt point(double u, double v) const { return p0 + e1 * u + e2 * v; }
        Vec to_eye(double u, double v) const { return perspective ? eye - point(u, v) : axis; }
        double operator()(double u, double v) const { return dot(normal(u, v), to_eye(u, v)); }
        /// False where the quadratic has one sign over the whole triangle, by its Bernstein coefficients.
        bool may_vanish() const {
            const double a = (*this)(0, 0), b = (*this)(1, 0), c = (*this)(0, 1);
            const auto between = [](double middle, double p, double q) { return 2 * middle - 0.5 * (p + q); };
            const std::array<double, 6> coefficients{a,
                                                     b,
                                                     c,
                                                     between((*this)(0.5, 0), a, b),
                                                     between((*this)(0, 0.5), a, c),
                                                     between((*this)(0.5, 0.5), b, c)};
            const auto [low, high] = std::minmax_element(coefficients.begin(), coefficients.end());
            return *low <= 0 && *high >= 0;
        }
        Point2<double> gradient(double u, double v) const {
            const Vec n = normal(u, v), w = to_eye(u, v);
            const double near = perspective ? 1 : 0;
            return {dot(n_u, w) - near * dot(n, e1), dot(n_v, w) - near * dot(n, e2)};
        }
    };
    void add_curve(const FilmCurve& curve, double weight, std::vector<double>& weights) {
        if (!(weight > 0)) return;
        curves_.push_back(curve);
        weights.push_back(weight);
    }
    /// Direction from a curve's point to the open space in front of it: beside a silhouette, above a crease.
    Vec lifted(const FilmCurve& curve, const Vec& outward_dir, const Vec& view) const {
        const Vec beside = normalize(outward_dir);
        if (curve.kind == FilmCurve::Kind::seam) return s_.seams[curve.index].lifted(view);
        if (curve.kind != FilmCurve::Kind::edge) return beside;
        const Edge& edge = tree_.edge(curve.index);
        if (is_silhouette_along(edge, -view)) return beside;
        const Vec above = Vec(edge.n0) + Vec(edge.n1);
        return normalize(dot(above, view) > 0 ? -above : above);
    }
    Terminator terminator(std::uint32_t shape_idx, std::uint32_t triangle) const {
        const Mesh& mesh = s_.scene.shapes[shape_idx].mesh;
        const std::uint32_t* i = &mesh.indices[3 * std::size_t(triangle)];
        const Pt p0(mesh.positions[i[0]]);
        const Vec n0(mesh.normals[i[0]]);
        return {p0,
                Pt(mesh.positions[i[1]]) - p0,
                Pt(mesh.positions[i[2]]) - p0,
                n0,
                Vec(mesh.normals[i[1]]) - n0,
                Vec(mesh.normals[i[2]]) - n0,
                Pt(s_.scene.sensor.origin),
                -direction({}),
                map_.perspective()};
    }

    /// Adds triangles in which the interpolated normal turns away from the camera.
    void add_terminators(bool all, std::vector<double>& weights) {
        const Sensor& sensor = s_.scene.sensor;
        for (std::uint32_t k = 0; k < s_.scene.shapes.size(); ++k) {
            const Shape& shape = s_.scene.shapes[k];
            const bool turns = !s_.tangents.shading_normals[k].empty();
            if (shape.mesh.normals.empty() || !(all || turns || s_.tangents.moves(k))) continue;
            for (std::uint32_t t = 0; t < shape.mesh.n_triangles(); ++t) {
                const Terminator g = terminator(k, t);
                if (!g.may_vanish()) continue;
                const Vec a = map_.in_camera(g.p0), b = map_.in_camera(g.p0 + g.e1), c = map_.in_camera(g.p0 + g.e2);
                if (!(std::min({a.z, b.z, c.z}) > sensor.near_clip)) continue;
                const Point2<double> fa = map_.film(a), fb = map_.film(b), fc = map_.film(c);
                const double reach = sensor.filter_radius;
                if (std::max({fa.x, fb.x, fc.x}) < -reach || std::min({fa.x, fb.x, fc.x}) > sensor.width + reach ||
                    std::max({fa.y, fb.y, fc.y}) < -reach || std::min({fa.y, fb.y, fc.y}) > sensor.height + reach)
                    continue;
                FilmCurve curve;
                curve.kind = FilmCurve::Kind::terminator;
                curve.index = t;
                curve.shape_idx = k;
                curves_.push_back(curve);
                // The terminator's length on the film is at most that of the triangle's sides.
                std::vector<Vec> v(s_.n());
                s_.shape_velocity(k, t, g.p0, v);
                weights.push_back((std::hypot(fb.x - fa.x, fb.y - fa.y) + std::hypot(fc.x - fa.x, fc.y - fa.y)) *
                                  speed_on_film(a, g.p0, v));
            }
        }
    }

    /// A root along one of the two axes of the triangle, weighted by the squared cosine between axis and gradient, so
    /// that no direction of the curve is singular.
    bool sample_terminator(const FilmCurve& curve, double pmf, Point2f u, float u_place, std::vector<Vec>& velocity,
                           Sample& out) const {
        const Terminator g = terminator(curve.shape_idx, curve.index);
        const bool along_u = u.y < 0.5f;
        const double fixed = double(u_place);
        const auto at = [&](double x) { return along_u ? Point2<double>{x, fixed} : Point2<double>{fixed, x}; };
        // Quadratic along the line: from three values.
        const double end = 1 - fixed;
        const auto value = [&](double x) { return g(at(x).x, at(x).y); };
        const double y0 = value(0), y1 = value(0.5 * end), y2 = value(end);
        const double a = 2 * (y0 - 2 * y1 + y2), b = 4 * y1 - 3 * y0 - y2, c = y0;
        std::array<double, 2> roots{};
        int n_roots = 0;
        const auto keep = [&](double x) {
            if (x >= 0 && x < 1) roots[std::size_t(n_roots++)] = x * end;
        };
        const double discriminant = b * b - 4 * a * c;
        if (!(discriminant > 0)) return false;
        const double q = -0.5 * (b + std::copysign(std::sqrt(discriminant), b));
        if (a != 0) keep(q / a);
        if (q != 0) keep(c / q);
        if (n_roots == 0) return false;
        const float u_root = along_u ? 2 * u.y : 2 * u.y - 1;
        const double root = roots[std::min(std::size_t(u_root * float(n_roots)), std::size_t(n_roots) - 1)];
        const Point2<double> uv = at(root), gradient = g.gradient(uv.x, uv.y);
        const double g2 = sqr(gradient.x) + sqr(gradient.y), g_axis = along_u ? gradient.x : gradient.y;
        if (!(g2 > 0) || g_axis == 0) return false;

        out.p = g.point(uv.x, uv.y);
        out.camera = map_.in_camera(out.p);
        if (!(out.camera.z > s_.scene.sensor.near_clip)) return false;
        out.film = map_.film(out.camera);
        const Point2<double> j1 = map_.velocity(out.camera, g.e1), j2 = map_.velocity(out.camera, g.e2);
        const double det = j1.x * j2.y - j1.y * j2.x;
        if (det == 0) return false;
        // Of g over the film: the inverse transpose of the map.
        const Point2<double> on_film{(j2.y * gradient.x - j1.y * gradient.y) / det,
                                     (j1.x * gradient.y - j2.x * gradient.x) / det};
        const double slope = std::hypot(on_film.x, on_film.y);
        out.normal = {-on_film.x / slope, -on_film.y / slope};
        out.density = pmf * 0.5 / n_roots * std::abs(g_axis) * g2 / (sqr(g_axis) * std::abs(det));

        // The lit side: off the root by more than stored normals are rounded.
        constexpr double cosine = 2e-4;
        const double step = cosine * length(g.normal(uv.x, uv.y)) * length(g.to_eye(uv.x, uv.y)) / std::sqrt(g2);
        out.front_p = out.p;
        out.front.shape_idx = curve.shape_idx;
        out.front.primitive_idx = curve.index;
        out.front.u = float(uv.x + step * gradient.x / std::sqrt(g2));
        out.front.v = float(uv.y + step * gradient.y / std::sqrt(g2));
        out.back = out.front;
        out.back.u = float(uv.x - step * gradient.x / std::sqrt(g2));
        out.back.v = float(uv.y - step * gradient.y / std::sqrt(g2));
        const Vec face = normalize(cross(g.e1, g.e2));
        out.beside = dot(face, g.to_eye(uv.x, uv.y)) < 0 ? -face : face;

        // Rate of g at a point that stays on the film.
        SurfacePoint place;
        place.p = Point3f(out.p);
        place.shape_idx = curve.shape_idx;
        place.primitive_idx = curve.index;
        place.ng = Normal3f(normalize(cross(g.e1, g.e2)));
        const Pt from = map_.perspective() ? g.eye : out.p - direction(out.p) * out.camera.z;
        s_.film_velocity(place, from, direction(out.p), velocity);
        std::vector<Vec> material(s_.n());
        s_.shape_velocity(curve.shape_idx, curve.index, out.p, material);
        out.rates.assign(s_.n(), 0);
        const Vec n = g.normal(uv.x, uv.y), w = g.to_eye(uv.x, uv.y);
        for (std::size_t k = 0; k < s_.n(); ++k) {
            const Point2<double> b =
                s_.motions.barycentric_of_vector(curve.shape_idx, curve.index, velocity[k] - material[k]);
            out.rates[k] = dot(g.n_u * b.x + g.n_v * b.y, w) - (map_.perspective() ? dot(n, velocity[k]) : 0);
        }
        const double size = length(n);
        const auto turn = [&](const Effects<AffineVelocity>& effects) {
            for (const auto& [k, motion] : effects) out.rates[k] += size * dot(motion.of_normal(n / size), w);
        };
        turn(s_.tangents.shapes[curve.shape_idx]);
        turn(s_.tangents.shading_normals[curve.shape_idx]);
        for (const auto& [k, motion] : s_.tangents.camera)
            out.rates[k] += dot(n, map_.perspective() ? motion.at(g.eye) : motion.turned(w));
        return std::any_of(out.rates.begin(), out.rates.end(), [](double r) { return r != 0; });
    }

    Vec direction(const Pt& p) const {
        if (map_.perspective()) return normalize(p - Pt(s_.scene.sensor.origin));
        const auto& m = s_.scene.sensor.world_from_camera;
        return normalize(Vec{m[2], m[6], m[10]});
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
    /// Sum over parameters of the speed on the film of a point in space, at least a little.
    double speed_on_film(const Vec& camera, const Pt& p, std::vector<Vec>& v) const {
        for (const auto& [k, motion] : s_.tangents.camera) v[k] = v[k] - motion.at(p);
        double sum = 1e-6;
        for (const Vec& world : v) {
            const Point2<double> f = map_.velocity(camera, world);
            sum += std::hypot(f.x, f.y);
        }
        const Point2<double> lens = map_.lens_velocity(camera);
        for (const auto& [k, relative] : s_.tangents.lens) sum += std::abs(relative) * std::hypot(lens.x, lens.y);
        return sum;
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

BoundaryScene::Curve curve_of(const Primary& primary, const Point3f& camera, const Primary::Sample& at) {
    const Vec d = at.p - Pt(camera);
    return {at.p, normalize(d), length(d), at.front.shape_idx, &primary.edges(), at.edge, at.front, at.touched};
}
/// Whether nothing lies between the camera and a point of a curve.
/// in:      v  velocities to use
bool visible(const BoundaryScene& s, const Primary& primary, const Point3f& camera, Primary::Sample& at,
             std::vector<Vec>& v) {
    BoundaryScene::Curve curve = curve_of(primary, camera, at);
    const bool shows = s.shows(curve, at.beside, !at.back, [&](const Point3f& to) {
        const Ray ray = spawn_segment({camera}, {to});
        const Hit hit = s.scene.intersect_from_camera(ray);
        return hit.t < ray.t_max ? hit : Hit{};
    });
    at.touched = curve.touched;
    if (shows && s.contact_velocity(curve, v)) primary.film_rates(at, v);
    return shows;
}
/// Whether the first hit of a ray beside a curve has light of its own there.
bool ends_too(const BoundaryScene& s, const Primary& primary, const Point3f& camera, const Primary::Sample& at,
              const PathGraph& g, std::size_t hit) {
    const BoundaryScene::Curve curve = curve_of(primary, camera, at);
    const std::uint32_t shape = g.vertices.shape[hit], primitive = g.vertices.primitive[hit];
    return std::abs(length(position<double>(g, hit) - Pt(camera)) - curve.r) <
               s.touching_depth(curve, shape, primitive) &&
           s.ends_too(curve, shape, primitive);
}

/// State of one thread.
struct Worker {
    RayLight light;
    std::vector<GivenRay> rays;
    std::vector<double> signs;             // [ray]
    std::vector<std::uint32_t> sample_of;  // [ray]
    std::vector<Primary::Sample> samples;
    std::vector<std::uint64_t> sample_ids;
    std::vector<Vec> v;
    std::uint64_t n_checks = 0;

    explicit Worker(const BoundaryScene& s) : light(s, streams::family(s.seed, 0)), v(s.n()) {}
};

}  // namespace

Effort add_primary(const BoundaryScene& s, std::uint64_t n_samples, std::vector<BoundaryRows>& rows,
                   std::span<std::uint64_t> samples, app::Report& report) {
    const Primary primary(s);
    if (primary.empty()) return {};
    const Scene& scene = s.scene;
    // Rays pass the edge by this many pixels.
    const double beside = 2e-5 * primary.map().pixels_per_radian();
    tbb::enumerable_thread_specific<Worker> workers([&] { return Worker(s); });
    const auto sample_chunk = [&](Worker& w, BoundaryRows& out, std::uint64_t begin, std::uint64_t end) {
        w.rays.clear();
        w.samples.clear();
        w.signs.clear();
        w.sample_of.clear();
        w.sample_ids.clear();
        for (std::uint64_t k = begin; k < end; ++k) {
            const Sampler sampler = s.sampler(4, k);
            Primary::Sample sample;
            if (!primary.sample(sampler.pair(0), sampler.pair(1).x, w.v, sample)) continue;
            const auto ray = [&](double side, const Hit& hit) {
                const double off = hit ? 0 : side * beside;
                const Pt& end = side < 0 ? sample.front_p : sample.p;
                Point2<double> film{sample.film.x + off * sample.normal.x, sample.film.y + off * sample.normal.y};
                if (hit) film = primary.map().film(primary.map().in_camera(end));
                const Ray camera = primary.map().ray(scene.sensor, film);
                GivenRay given{camera, {k, 0}, scene.sensor_media.at(scene, camera.o), 1, hit};
                if (hit) given.hit.t = float(length(end - Pt(camera.o)));
                return given;
            };
            ++w.n_checks;
            const GivenRay front = ray(-1, sample.front);
            if (!visible(s, primary, front.ray.o, sample, w.v)) continue;
            w.signs.push_back(1);
            w.sample_of.push_back(std::uint32_t(w.samples.size()));
            w.rays.push_back(front);
            w.signs.push_back(-1);
            w.sample_of.push_back(std::uint32_t(w.samples.size()));
            w.rays.push_back(ray(1, sample.back));
            w.samples.push_back(std::move(sample));
            w.sample_ids.push_back(k);
        }
        w.light.trace(w.rays, [&](std::size_t path, const PathGraph& g, std::size_t& edge) {
            const Primary::Sample& at = w.samples[w.sample_of[path]];
            const GivenRay& ray = w.rays[path];
            const std::size_t hit = g.paths.first_vertex[path];
            const bool theirs =
                !ray.hit && hit < g.paths.first_vertex[path + 1] && ends_too(s, primary, ray.ray.o, at, g, hit);
            const double sign = theirs ? 0 : w.signs[path];
            w.light.walk(path, edge, [&](const Spectrum& L, double opl) {
                for_pixels_at(scene.sensor, {float(at.film.x), float(at.film.y)}, [&](std::uint64_t pixel, double h) {
                    out.add(pixel, std::isfinite(opl) ? opl : -1, w.light.to_first_hit(path),
                            Rgb<double>(L) * Rgb<double>(sign * h / (at.density * double(n_samples))), at.rates,
                            BoundaryFamily::primary, w.sample_ids[w.sample_of[path]]);
                });
            });
        });
    };
    sample_in_chunks(s, n_samples, PathBatch::capacity / 2, "edges visible from the camera", workers, rows, report,
                     sample_chunk);
    samples[std::size_t(BoundaryFamily::primary)] += n_samples;
    Effort effort{0, n_samples};
    for (const Worker& worker : workers) effort.rays += worker.n_checks + worker.light.n_rays;
    return effort;
}

}  // namespace loom::derive
