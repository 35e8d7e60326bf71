#include "stages/derive/boundary.h"

#include <algorithm>
#include <functional>
#include <numeric>

#include "stages/core/app/report.h"

namespace loom::derive {

using Vec = Vector3<double>;
using Pt = Point3<double>;

namespace {

std::vector<bool> moving_shapes(const Scene& scene, const SceneTangents& tangents) {
    std::vector<bool> moving;
    for (std::uint32_t s = 0; s < scene.shapes.size(); ++s) moving.push_back(tangents.moves(s));
    return moving;
}

EdgeTree tree_of(const Scene& scene, const std::vector<bool>& wanted) {
    if (!wanted.empty() && std::none_of(wanted.begin(), wanted.end(), [](bool w) { return w; })) return {};
    return EdgeTree(find_edges(scene.shapes, wanted));
}

}  // namespace

BoundaryScene::BoundaryScene(const PathGraph& g, const Scene& s, const SceneTangents& t, const BoundaryOptions& o)
    : graph(g),
      scene(s),
      tangents(t),
      options(o),
      reader(g),
      motions(s, t),
      all_edges(tree_of(s, {})),
      moving_edges(tree_of(s, moving_shapes(s, t))),
      attached(attached_of(s, o.attachment)) {
    find_speeds();
    if (attached.reach == 0) return;
    for (std::uint32_t i = 0; i < all_edges.n_edges(); ++i)
        if (all_edges.edge(i).kind == EdgeKind::shared && is_crease(all_edges.set(), all_edges.edge(i)))
            creases.push_back(i);
}

void BoundaryScene::find_speeds() {
    const auto corners = [](const Box3f& box) {
        std::array<Pt, 8> out;
        for (std::size_t i = 0; i < 8; ++i)
            out[i] = {double(i & 1 ? box.hi.x : box.lo.x), double(i & 2 ? box.hi.y : box.lo.y),
                      double(i & 4 ? box.hi.z : box.lo.z)};
        return out;
    };
    const auto raise = [](double& speed, const Vec& v) { speed = std::max(speed, length(v)); };
    std::vector<std::vector<double>> shape_speed(scene.shapes.size(), std::vector<double>(n()));
    surface_speed.assign(n(), 0);
    Box3f all;
    for (std::size_t k = 0; k < scene.shapes.size(); ++k) {
        all.add(scene.shapes[k].bounds());
        for (const Pt& p : corners(scene.shapes[k].bounds()))
            for (const auto& [parameter, v] : tangents.shapes[k]) raise(shape_speed[k][parameter], v.at(p));
        for (const auto& vertex : tangents.vertices[k])
            for (const auto& [parameter, v] : vertex) raise(shape_speed[k][parameter], v);
        for (std::size_t p = 0; p < n(); ++p) surface_speed[p] = std::max(surface_speed[p], shape_speed[k][p]);
    }
    film_speed = surface_speed;
    for (const Pt& p : corners(all)) {
        for (const auto& [parameter, v] : tangents.camera) raise(film_speed[parameter], v.at(p));
        for (const auto& [parameter, relative] : tangents.lens)
            raise(film_speed[parameter], (p - corners(all)[0]) * relative);
    }
    for (std::size_t e = 0; e < scene.emitters.size(); ++e) {
        const Emitter& emitter = scene.emitters[e];
        if (emitter.kind == EmitterKind::area) {
            emitter_speed.push_back(shape_speed[emitter.shape_idx]);
            continue;
        }
        emitter_speed.emplace_back(n());
        for (const auto& [parameter, v] : tangents.emitters[e])
            if (emitter.is_infinite())
                for (const double x : v.linear) emitter_speed[e][parameter] += std::abs(x);
            else
                raise(emitter_speed[e][parameter], v.at(Pt(emitter.position)));
    }
}

void BoundaryScene::shape_velocity(std::uint32_t shape, std::uint32_t primitive, const Pt& p, Velocities out) const {
    std::fill(out.begin(), out.end(), Vec{});
    for (const auto& [k, v] : tangents.shapes[shape]) out[k] = out[k] + v.at(p);
    if (tangents.vertices[shape].empty()) return;
    const Mesh& mesh = scene.shapes[shape].mesh;
    const std::uint32_t* i = &mesh.indices[3 * std::size_t(primitive)];
    const Point2<double> b = motions.barycentric_of(shape, primitive, p);
    const double weight[3] = {1 - b.x - b.y, b.x, b.y};
    for (int corner = 0; corner < 3; ++corner)
        for (const auto& [k, v] : tangents.vertices[shape][i[corner]]) out[k] = out[k] + v * weight[corner];
}

void BoundaryScene::edge_velocity(const EdgeSet& set, const Edge& edge, double s, Velocities out) const {
    std::fill(out.begin(), out.end(), Vec{});
    for (const auto& [k, v] : tangents.shapes[edge.shape_idx]) out[k] = out[k] + v.at(edge.point(s));
    const auto& vertices = tangents.vertices[edge.shape_idx];
    if (vertices.empty()) return;
    const Mesh& mesh = scene.shapes[edge.shape_idx].mesh;
    // All copies of a position move alike, so those of one face suffice.
    const std::uint32_t* i = &mesh.indices[3 * std::size_t(set.faces_of(edge)[0])];
    for (int corner = 0; corner < 3; ++corner) {
        const Point3f& p = mesh.positions[i[corner]];
        const double weight = p == edge.a ? 1 - s : p == edge.b ? s : 0;
        if (weight == 0) continue;
        for (const auto& [k, v] : vertices[i[corner]]) out[k] = out[k] + v * weight;
    }
}

void BoundaryScene::film_velocity(const SurfacePoint& at, const Pt& from, const Vec& d, Velocities out) const {
    const Pt p(at.p);
    shape_velocity(at.shape_idx, at.primitive_idx, p, out);
    const double r = dot(p - from, d), cosine = dot(Vec(at.ng), d);
    std::vector<Vec> ray(out.size());
    for (const auto& [k, v] : tangents.camera) {
        const Vec turned = v.turned(d);
        ray[k] = ray[k] + v.at(from) + (turned - d * dot(d, turned)) * r;
    }
    if (!tangents.lens.empty()) {
        const auto& m = scene.sensor.world_from_camera;
        const Vec axis = normalize(Vec{m[2], m[6], m[10]});
        const Vec across = d - axis * dot(d, axis);
        for (const auto& [k, relative] : tangents.lens) {
            const Vec change = across * relative;
            ray[k] = ray[k] + (change - d * dot(d, change)) * r;
        }
    }
    for (std::size_t k = 0; k < out.size(); ++k) out[k] = ray[k] + d * (dot(Vec(at.ng), out[k] - ray[k]) / cosine);
}

void BoundaryScene::far_velocity(std::uint32_t shape, std::uint32_t primitive, std::uint32_t material, const Vec& ng,
                                 const Pt& p, const Pt& from, ConstVelocities v_from, ConstVelocities turn,
                                 Velocities out) const {
    shape_velocity(shape, primitive, p, out);
    const Vec d = p - from;
    const double r = length(d), share = has_delta_lobe(scene.materials[material].model.kind) ? 1 : attached.share(r);
    if (share == 0) return;
    const Vec u = d / r;
    const double cosine = dot(ng, u);
    for (std::size_t k = 0; k < out.size(); ++k) {
        const Vec ray = v_from[k] + cross(turn[k], d);
        out[k] = out[k] + (ray + u * (dot(ng, out[k] - ray) / cosine) - out[k]) * share;
    }
}

void BoundaryScene::emitter_velocity(std::size_t emitter, const Pt& y, Velocities out) const {
    const Emitter& e = scene.emitters[emitter];
    if (e.kind == EmitterKind::area) {
        shape_velocity(e.shape_idx, 0, y, out);
        return;
    }
    std::fill(out.begin(), out.end(), Vec{});
    for (const auto& [k, v] : tangents.emitters[emitter])
        out[k] = e.is_infinite() ? v.turned(Vec(y)) - Vec(y) * dot(Vec(y), v.turned(Vec(y))) : v.at(y);
}

bool BoundaryScene::emitter_moves(std::size_t emitter) const {
    const Emitter& e = scene.emitters[emitter];
    return e.kind == EmitterKind::area ? tangents.moves(e.shape_idx) : !tangents.emitters[emitter].empty();
}

std::vector<Round> BoundaryScene::rounds_from(const Pt& eye, bool ends_move) const {
    std::vector<Round> rounds;
    for (std::uint32_t s = 0; s < scene.shapes.size(); ++s) {
        const Shape& shape = scene.shapes[s];
        if (shape.kind == ShapeKind::mesh || !(ends_move || tangents.moves(s))) continue;
        const Pt center(shape.round.center);
        if (shape.kind == ShapeKind::disk) {
            rounds.push_back({center, Vec(shape.round.u_axis), Vec(shape.round.v_axis), s, center});
            continue;
        }
        const Vec to_eye = eye - center;
        const double distance = length(to_eye), radius = shape.round.radius;
        if (!(distance > radius * (1 + 1e-6))) continue;
        const Vec axis = to_eye / distance;
        const double along = radius * radius / distance, across = radius * std::sqrt(1 - sqr(radius / distance));
        const Frame<double> frame{Normal3<double>(axis)};
        rounds.push_back({center + axis * along, frame.s * across, frame.t * across, s, center});
    }
    return rounds;
}

std::vector<Round> BoundaryScene::rounds_along(const Vec& direction, bool ends_move) const {
    std::vector<Round> rounds;
    for (std::uint32_t s = 0; s < scene.shapes.size(); ++s) {
        const Shape& shape = scene.shapes[s];
        if (shape.kind == ShapeKind::mesh || !(ends_move || tangents.moves(s))) continue;
        const Pt center(shape.round.center);
        const Frame<double> frame{Normal3<double>(direction)};
        const double radius = shape.round.radius;
        if (shape.kind == ShapeKind::disk)
            rounds.push_back({center, Vec(shape.round.u_axis), Vec(shape.round.v_axis), s, center});
        else
            rounds.push_back({center, frame.s * radius, frame.t * radius, s, center});
    }
    return rounds;
}

BoundaryScene::Sides BoundaryScene::sides_of(const EdgeSet& set, const Edge& edge, const Pt& p, const Vec& view,
                                             const Vec& out) const {
    const Mesh& mesh = scene.shapes[edge.shape_idx].mesh;
    const Vec t = normalize(Pt(edge.b) - Pt(edge.a)), level = view - t * dot(view, t);
    double nearest[2] = {INFINITY, INFINITY};
    Sides sides;
    for (const std::uint32_t face : set.faces_of(edge)) {
        const std::uint32_t* i = &mesh.indices[3 * std::size_t(face)];
        for (int corner = 0; corner < 3; ++corner) {
            const Point3f& q = mesh.positions[i[corner]];
            if (q == edge.a || q == edge.b) continue;
            // The face rises from the edge towards this corner: across the view, and along it.
            const Vec w = Pt(q) - p;
            const double across = dot(out, w) / length(out);
            if (across == 0) continue;
            const int side = across > 0 ? 1 : 0;
            const double depth = dot(level, w) / std::abs(across);
            if (!(depth < nearest[side])) continue;
            nearest[side] = depth;
            Hit& hit = side ? sides.back : sides.front;
            // A little inside of the face: its edge may touch another surface, whose light it would miss.
            constexpr double least = 1e-4, most = 1e-2;
            const double inside = std::clamp(2 * clearance(p, length(w)) / std::abs(across), least, most);
            const Point2<double> b = motions.barycentric_of(edge.shape_idx, face, p + w * inside);
            hit.shape_idx = edge.shape_idx;
            hit.primitive_idx = face;
            hit.u = float(b.x), hit.v = float(b.y);
        }
    }
    return sides;
}

bool BoundaryScene::is_crease(const EdgeSet& set, const Edge& edge) const {
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

double BoundaryScene::clearance(const Pt& x, double distance) const {
    constexpr double angle = 2e-5, rounding = 4e-6;
    return std::max(angle * distance, rounding * std::max({std::abs(x.x), std::abs(x.y), std::abs(x.z)}));
}

namespace {

/// Appends rows in the order of `order`.
template <class T>
std::vector<T> reordered(const std::vector<T>& values, const std::vector<std::size_t>& order, std::size_t width = 1) {
    std::vector<T> out;
    out.reserve(values.size());
    for (const std::size_t i : order)
        out.insert(out.end(), values.begin() + std::ptrdiff_t(i * width),
                   values.begin() + std::ptrdiff_t((i + 1) * width));
    return out;
}

void set_rows(std::vector<BoundaryRows>& parts, std::size_t n_parameters, Derivative& out) {
    BoundaryRows all;
    for (BoundaryRows& part : parts) {
        all.pixel.insert(all.pixel.end(), part.pixel.begin(), part.pixel.end());
        all.opl.insert(all.opl.end(), part.opl.begin(), part.opl.end());
        all.camera_opl.insert(all.camera_opl.end(), part.camera_opl.begin(), part.camera_opl.end());
        all.dL.insert(all.dL.end(), part.dL.begin(), part.dL.end());
        all.family.insert(all.family.end(), part.family.begin(), part.family.end());
        all.sample.insert(all.sample.end(), part.sample.begin(), part.sample.end());
        part = {};
    }
    std::vector<std::size_t> order(all.pixel.size());
    std::iota(order.begin(), order.end(), std::size_t(0));
    std::stable_sort(order.begin(), order.end(), [&](std::size_t a, std::size_t b) {
        return std::tuple(all.pixel[a], all.family[a], all.sample[a]) <
               std::tuple(all.pixel[b], all.family[b], all.sample[b]);
    });
    out.boundary.pixel = reordered(all.pixel, order);
    out.boundary.opl = reordered(all.opl, order);
    out.boundary.camera_opl = reordered(all.camera_opl, order);
    out.boundary.dL = reordered(all.dL, order, 3 * n_parameters);
    out.boundary.family = reordered(all.family, order);
    out.boundary.sample = reordered(all.sample, order);
}

/// Sum over all rows of the squares of their derivatives: the variance of their pixels, but for the square of the mean.
double second_moment(const std::vector<BoundaryRows>& rows) {
    double sum = 0;
    for (const BoundaryRows& part : rows) sum += part.square;
    return sum;
}

/// The boundary families that a derivative needs, and how many samples each takes.
class Allotment {
  public:
    using Rows = std::vector<BoundaryRows>;
    using Samples = std::span<std::uint64_t>;

    Allotment(const BoundaryScene& s, const Parts& parts, app::Report& report)
        : s_(s), report_(report), silent_(report.name()), n_paths_(double(s.graph.n_paths())) {
        silent_.set_quiet(true);
        pilot_share_ = std::min(1.0, std::clamp(0.02 * n_paths_, 16384.0, 65536.0) / n_paths_);
        for (const Emitter& e : s.scene.emitters)
            environment_ |= parts.direct && (e.kind == EmitterKind::constant || e.kind == EmitterKind::envmap);
        if (parts.direct) choose_direct();
        if (parts.primary)
            families_.push_back({[this](double n, Rows& rows, Samples samples, app::Report& to) {
                                     return add_primary(s_, count(n), rows, samples, to);
                                 },
                                 pilot_share_ * n_paths_, INFINITY});
        if (any_area_)
            families_.push_back({[this](double share, Rows& rows, Samples samples, app::Report& to) {
                                     return add_vertex_light(s_, share, by_vertex_, true, rows, samples, to);
                                 },
                                 pilot_share_, 1});
        if (any_light_points_)
            families_.push_back({[this](double n, Rows& rows, Samples samples, app::Report& to) {
                                     return add_edge_light(s_, count(n), by_light_, rows, samples, to);
                                 },
                                 0.05 * pilot_share_ * n_paths_, INFINITY});
        if (any_delta_ && (s.graph.tracing.max_depth < 0 || s.graph.tracing.max_depth >= 3))
            families_.push_back({[this](double share, Rows& rows, Samples samples, app::Report& to) {
                                     return add_joined_light(s_, share, delta_, rows, samples, to);
                                 },
                                 pilot_share_ / 4, 1});
        if (parts.indirect || environment_)
            families_.push_back(
                {[this, surfaces = parts.indirect](double share, Rows& rows, Samples samples, app::Report& to) {
                     return add_indirect(s_, share, surfaces, environment_, rows, samples, to);
                 },
                 pilot_share_ / 16, 1});
    }

    /// Samples all families within the budget: in proportion to sqrt(variance / cost) of a pilot of each.
    std::uint64_t sample(Rows& rows, Samples samples) {
        double total = 0;
        for (Family& family : families_) {
            Rows tried;
            std::vector<std::uint64_t> n_tried(n_boundary_families);
            const Effort effort = family.run(family.pilot, tried, n_tried, silent_);
            rays_ += effort.rays;
            family.variance = second_moment(tried) * family.pilot;
            family.cost = std::max(effort.cost() / family.pilot, 1e-9);
            total += std::sqrt(family.variance * family.cost);
        }
        // Tracing a path and binning it costs about as much as this many rays.
        // One that ends on an emitter has neither vertex nor light edge.
        const double path_cost =
            1.5 * std::max(1.0, double(s_.graph.n_vertices() + s_.graph.n_light_edges()) / std::max(n_paths_, 1.0));
        const double budget = s_.options.effort * n_paths_ * path_cost;
        for (const Family& family : families_) {
            const double wanted = total > 0 ? budget / total * std::sqrt(family.variance / family.cost) : 0;
            // A pilot that finds nothing may have been too small.
            const double n = std::min(std::max(few_digits(wanted), family.pilot), family.most);
            rays_ += family.run(n, rows, samples, report_).rays;
        }
        return rays_;
    }

  private:
    struct Family {
        std::function<Effort(double, Rows&, Samples, app::Report&)> run;
        double pilot, most;             // number of samples, or share of the paths
        double variance = 0, cost = 0;  // of one, or of all paths
    };

    /// Rounds to 12 binary digits: with the number of threads sums of squares differ in their last.
    static double few_digits(double x) {
        int exponent = 0;
        const double mantissa = std::frexp(x, &exponent);
        return std::ldexp(std::round(std::ldexp(mantissa, 12)), exponent - 12);
    }
    static std::uint64_t count(double n) { return std::uint64_t(std::max(1.0, std::ceil(n))); }

    /// Chooses, by emitter, whether light points are the cheaper way for first hits: by variance times cost of a few
    /// samples of each. Lights without area have no other.
    void choose_direct() {
        const std::size_t n_emitters = s_.scene.emitters.size();
        by_light_.assign(n_emitters, 0);
        by_vertex_.assign(n_emitters, 0);
        delta_.assign(n_emitters, 0);
        constexpr std::size_t most = 16;  // pilots; further emitters follow the majority
        std::size_t n_pilots = 0, n_chosen = 0;
        for (std::size_t e = 0; e < n_emitters; ++e) {
            const Emitter& emitter = s_.scene.emitters[e];
            if (emitter.kind == EmitterKind::area) {
                if (s_.options.direct == Direct::automatic)
                    by_light_[e] = n_pilots++ < most ? prefers_light_points(e) : char(2 * n_chosen > most);
                else
                    by_light_[e] = s_.options.direct == Direct::lights;
                n_chosen += std::size_t(by_light_[e]);
                by_vertex_[e] = !by_light_[e];
                any_area_ = true;
            } else {
                by_light_[e] = delta_[e] = emitter.is_delta();
                any_delta_ |= emitter.is_delta();
            }
            any_light_points_ |= by_light_[e] != 0;
        }
    }

    char prefers_light_points(std::size_t e) {
        std::vector<char> only(s_.scene.emitters.size());
        only[e] = 1;
        Rows by_vertex, by_light;
        std::vector<std::uint64_t> n_tried(n_boundary_families);
        const Effort vertices = add_vertex_light(s_, pilot_share_, only, false, by_vertex, n_tried, silent_),
                     lights =
                         add_edge_light(s_, count(0.05 * pilot_share_ * n_paths_), only, by_light, n_tried, silent_);
        rays_ += vertices.rays + lights.rays;
        const double vertex_work = second_moment(by_vertex) * vertices.cost(),
                     light_work = second_moment(by_light) * lights.cost();
        // Few vertices that find an edge are no measure of the variance, which rare ones make.
        constexpr std::size_t fewest = 100;
        std::uint64_t n_found = 0;
        for (const BoundaryRows& part : by_vertex) n_found += part.n_rows;
        return light_work > 0 && (n_found < fewest || light_work < vertex_work);
    }

    const BoundaryScene& s_;
    app::Report& report_;
    app::Report silent_;
    double n_paths_, pilot_share_ = 1;
    bool environment_ = false, any_area_ = false, any_light_points_ = false, any_delta_ = false;
    std::vector<char> by_light_, by_vertex_;  // by emitter, for first hits
    std::vector<char> delta_;                 // by emitter
    std::vector<Family> families_;
    std::uint64_t rays_ = 0;
};

}  // namespace

std::vector<BoundaryRows> sample_boundary(const PathGraph& graph, const Scene& scene, const SceneTangents& tangents,
                                          const Parts& parts, const BoundaryOptions& options, app::Report& report,
                                          std::vector<std::uint64_t>& samples, DeriveCounts& counts) {
    const BoundaryScene s(graph, scene, tangents, options);
    samples.assign(n_boundary_families, 0);
    std::vector<BoundaryRows> rows;
    counts.rays += Allotment(s, parts, report).sample(rows, samples);
    return rows;
}

void differentiate_boundary(const PathGraph& graph, const Scene& scene, const SceneTangents& tangents,
                            const Parts& parts, const BoundaryOptions& options, app::Report& report, Derivative& out,
                            DeriveCounts& counts) {
    if (!parts.primary && !parts.direct && !parts.indirect) return;
    std::vector<std::uint64_t> samples;
    std::vector<BoundaryRows> rows = sample_boundary(graph, scene, tangents, parts, options, report, samples, counts);
    set_rows(rows, tangents.n(), out);
    out.boundary_samples = std::move(samples);
}

}  // namespace loom::derive
