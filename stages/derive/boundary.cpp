#include "stages/derive/boundary.h"

#include <algorithm>
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
      moving_edges(tree_of(s, moving_shapes(s, t))) {}

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

/// Returns by emitter whether light points (family 2) are the cheaper way for first hits, by variance times cost of a
/// few samples of each. Costs are counts of rays and look-ups, so that the choice does not depend on the machine.
std::vector<char> choose_light_points(const BoundaryScene& s, app::Report& report) {
    constexpr double n_vertices = 32768, n_lights = 2048;
    const std::size_t n_emitters = s.scene.emitters.size();
    std::vector<char> light_points(n_emitters);
    const double share = std::min(1.0, n_vertices / double(s.graph.n_paths()));
    constexpr std::size_t most = 16;  // pilots; further emitters follow the majority
    std::size_t n_pilots = 0, n_chosen = 0;
    app::Report silent(report.name());
    silent.set_quiet(true);
    for (std::size_t e = 0; e < n_emitters; ++e) {
        if (s.scene.emitters[e].kind != EmitterKind::area) continue;
        if (++n_pilots > most) {
            light_points[e] = 2 * n_chosen > most;
            continue;
        }
        std::vector<char> only(n_emitters);
        only[e] = 1;
        std::vector<BoundaryRows> by_vertex, by_light;
        std::vector<std::uint64_t> n_by_vertex(n_boundary_families), n_by_light(n_boundary_families);
        const double vertex_rays = double(add_vertex_light(s, share, only, false, by_vertex, n_by_vertex, silent)),
                     light_rays =
                         double(add_edge_light(s, std::uint64_t(n_lights), only, by_light, n_by_light, silent));
        const double vertex_cost = vertex_rays + double(n_by_vertex[1]), light_cost = light_rays + 2 * n_lights;
        const double vertex_work = second_moment(by_vertex) * vertex_cost,
                     light_work = second_moment(by_light) * light_cost;
        // Nothing found by vertices may mean too few of them.
        light_points[e] = vertex_work == 0 ? light_work > 0 : light_work > 0 && light_work < vertex_work;
        n_chosen += std::size_t(light_points[e]);
    }
    return light_points;
}

}  // namespace

std::vector<BoundaryRows> sample_boundary(const PathGraph& graph, const Scene& scene, const SceneTangents& tangents,
                                          const Parts& parts, const BoundaryOptions& options, app::Report& report,
                                          std::vector<std::uint64_t>& samples, DeriveCounts& counts) {
    const BoundaryScene s(graph, scene, tangents, options);
    samples.assign(n_boundary_families, 0);
    std::vector<BoundaryRows> rows;
    const double n_paths = double(graph.n_paths());
    const auto count = [&](double share) {
        return std::uint64_t(std::max(1.0, std::ceil(share * options.effort * n_paths)));
    };
    if (parts.primary) counts.rays += add_primary(s, count(0.1), rows, samples, report);
    bool environment = false;
    if (parts.direct) {
        std::vector<char> by_light = choose_light_points(s, report), by_vertex(by_light.size());
        bool any_light = false, any_area = false;
        std::string said;
        for (std::size_t e = 0; e < by_light.size(); ++e) {
            const Emitter& emitter = scene.emitters[e];
            environment |= emitter.kind == EmitterKind::constant || emitter.kind == EmitterKind::envmap;
            by_light[e] |= char(emitter.is_delta());
            by_vertex[e] = emitter.kind == EmitterKind::area && !by_light[e];
            any_light |= by_light[e] != 0;
            any_area |= emitter.kind == EmitterKind::area;
        }
        if (any_area)
            counts.rays += add_vertex_light(s, std::min(options.effort, 1.0), by_vertex, true, rows, samples, report);
        if (any_light) counts.rays += add_edge_light(s, count(0.05), by_light, rows, samples, report);
    }
    if (parts.indirect || environment)
        counts.rays += add_indirect(s, 0.1 * options.effort, parts.indirect, environment, rows, samples, report);
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
