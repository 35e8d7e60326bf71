#include "stages/derive/boundary.h"

#include <algorithm>
#include <map>
#include <numeric>

#include "stages/core/app/report.h"
#include "stages/derive/allotment.h"

namespace loom::derive {

using Vec = Vector3<double>;
using Pt = Point3<double>;

namespace {

std::vector<bool> moving_shapes(const Scene& scene, const SceneTangents& tangents) {
    std::vector<bool> moving;
    for (std::uint32_t s = 0; s < scene.shapes.size(); ++s) moving.push_back(tangents.moves(s));
    return moving;
}

/// Corners of a box.
std::array<Pt, 8> corners(const Box3f& box) {
    std::array<Pt, 8> out;
    for (std::size_t i = 0; i < 8; ++i)
        out[i] = {double(i & 1 ? box.hi.x : box.lo.x), double(i & 2 ? box.hi.y : box.lo.y),
                  double(i & 4 ? box.hi.z : box.lo.z)};
    return out;
}

void raise(double& speed, const Vec& v) {
    speed = std::max(speed, length(v));
}

/// Largest speeds of the shapes, by shape and parameter, m per unit.
std::vector<std::vector<double>> shape_speeds(const Scene& scene, const SceneTangents& tangents) {
    std::vector<std::vector<double>> speed(scene.shapes.size(), std::vector<double>(tangents.n()));
    for (std::size_t k = 0; k < scene.shapes.size(); ++k) {
        for (const Pt& p : corners(scene.shapes[k].bounds()))
            for (const auto& [parameter, v] : tangents.shapes[k]) raise(speed[k][parameter], v.at(p));
        for (const auto& vertex : tangents.vertices[k])
            for (const auto& [parameter, v] : vertex) raise(speed[k][parameter], v);
    }
    return speed;
}

/// in:      of_shapes  their speeds, by parameter
EdgeTree tree_of(const Scene& scene, const std::vector<std::vector<double>>& of_shapes,
                 const std::vector<bool>& wanted) {
    if (!wanted.empty() && std::none_of(wanted.begin(), wanted.end(), [](bool w) { return w; })) return {};
    EdgeSet set = find_edges(scene.shapes, wanted);
    std::vector<float> speeds;
    for (const Edge& edge : set.edges) {
        const std::vector<double>& by_parameter = of_shapes[edge.shape_idx];
        speeds.push_back(float(std::accumulate(by_parameter.begin(), by_parameter.end(), 0.0)));
    }
    return EdgeTree(std::move(set), speeds);
}

}  // namespace

BoundaryScene::BoundaryScene(const PathGraph& g, const Scene& s, const SceneTangents& t, const BoundaryOptions& o)
    : graph(g),
      scene(s),
      tangents(t),
      options(o),
      seed(o.seed),
      reader(g),
      motions(s, t),
      shape_speed(shape_speeds(s, t)),
      all_edges(tree_of(s, shape_speed, {})),
      moving_edges(tree_of(s, shape_speed, moving_shapes(s, t))),
      attached(attached_of(s, o.attachment)),
      joined_beyond(0.02 * double(s.radius)) {
    for (const Material& material : s.materials) narrow.push_back(has_narrow_lobe(material));
    find_speeds();
    find_all_seams();
    find_touched_emitters();
    find_rounds();
    if (attached.any_slides()) find_creases();
}

void BoundaryScene::find_rounds() {
    for (std::size_t k = 0; k < scene.shapes.size(); ++k) {
        const Shape& shape = scene.shapes[k];
        if (shape.kind == ShapeKind::mesh) continue;
        const double radius = shape.kind == ShapeKind::sphere
                                  ? double(shape.round.radius)
                                  : double(std::max(length(shape.round.u_axis), length(shape.round.v_axis))),
                     around = 2 * pi_double * radius;
        const double speed = std::accumulate(shape_speed[k].begin(), shape_speed[k].end(), 0.0);
        round_clusters_.push_back({Pt(shape.round.center), sqr(radius), around, around * speed});
    }
    // Of many, one for all.
    constexpr std::size_t most = 16;
    if (round_clusters_.size() <= most) return;
    EdgeCluster all;
    for (const EdgeCluster& one : round_clusters_) {
        all.center = all.center + (one.center - Pt()) / double(round_clusters_.size());
        all.length += one.length, all.motion += one.motion;
    }
    for (const EdgeCluster& one : round_clusters_) all.half2 = std::max(all.half2, length2(one.center - all.center));
    round_clusters_ = {all};
}

double BoundaryScene::motion_around(const Pt& eye, double end_speed) const {
    double sum = all_edges.motion_around(eye, end_speed);
    for (const EdgeCluster& cluster : round_clusters_) sum += cluster.motion_around(eye, end_speed);
    return sum;
}

void BoundaryScene::find_creases() {
    for (std::uint32_t i = 0; i < all_edges.n_edges(); ++i)
        if (all_edges.edge(i).kind == EdgeKind::shared && is_crease(all_edges.set(), all_edges.edge(i)))
            creases.push_back(i);
    // The order of the tree is one of space.
    const std::size_t per_group = (creases.size() + most_crease_groups - 1) / most_crease_groups;
    for (std::size_t begin = 0; begin < creases.size(); begin += per_group) {
        CreaseGroup group{begin, std::min(begin + per_group, creases.size()), {}, 0};
        for (std::size_t i = begin; i < group.end; ++i) {
            const Edge& edge = all_edges.edge(creases[i]);
            group.box.add(edge.a);
            group.box.add(edge.b);
            group.reach = std::max(group.reach, reach(edge.shape_idx));
        }
        crease_groups.push_back(group);
    }
}

void BoundaryScene::find_speeds() {
    surface_speed.assign(n(), 0);
    Box3f all;
    for (std::size_t k = 0; k < scene.shapes.size(); ++k) {
        all.add(scene.shapes[k].bounds());
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

bool has_narrow_lobe(const Material& m) {
    const BsdfModel& b = m.model;
    const float specular = m.specular_idx >= 0 ? 1 : std::max({b.specular.r, b.specular.g, b.specular.b});
    float peak = 0;  // times pi
    switch (b.kind) {
        case BsdfKind::rough_conductor:
        case BsdfKind::rough_dielectric:
        case BsdfKind::ward:
            peak = specular / (4 * b.alpha_u * b.alpha_v);
            break;
        case BsdfKind::rough_plastic:
            peak = specular * sqr((b.eta() - 1) / (b.eta() + 1)) / (4 * sqr(b.alpha_u));
            break;
        case BsdfKind::phong:
            peak = specular * (b.exponent + 2) / 2;
            break;
        default:
            return false;
    }
    return peak > 1 || m.alpha_u_idx >= 0 || m.alpha_v_idx >= 0 || m.exponent_idx >= 0;
}

bool cuts_emitter(const Scene& scene, const Seam& seam) {
    return std::any_of(seam.faces.begin(), seam.faces.end(),
                       [&](const Seam::Face& face) { return scene.shapes[face.shape_idx].emitter_idx >= 0; });
}

SeamQuery moving_pairs(const Scene& scene, const SceneTangents& tangents) {
    SeamQuery query;
    std::map<std::vector<double>, std::uint32_t> groups;  // by motion
    for (std::uint32_t k = 0; k < scene.shapes.size(); ++k) {
        if (!tangents.vertices[k].empty()) {
            query.group.push_back(SeamQuery::deforms);
            continue;
        }
        std::vector<double> motion;
        for (const auto& [parameter, v] : tangents.shapes[k]) {
            motion.push_back(parameter);
            motion.insert(motion.end(), v.linear.begin(), v.linear.end());
            for (int c = 0; c < 3; ++c) motion.push_back(v.offset[c]);
        }
        query.group.push_back(groups.emplace(std::move(motion), std::uint32_t(groups.size())).first->second);
    }
    return query;
}

void BoundaryScene::find_all_seams() {
    if (!(tangents.any_shape_moves() || tangents.camera_moves())) return;
    SeamQuery query = moving_pairs(scene, tangents);
    const bool deeper = graph.tracing.max_depth < 0 || graph.tracing.max_depth >= 3;
    query.resting = tangents.camera_moves() || (deeper && attached.any_slides());
    SeamSet found = find_seams(scene.shapes, query);
    seams = std::move(found.seams);
    all_seams = found.complete;
    const auto moves = [&](const Seam& seam) {
        const std::uint32_t a = query.group[seam.faces[0].shape_idx], b = query.group[seam.faces[1].shape_idx];
        return a != b || a == SeamQuery::deforms;
    };
    n_moving_seams = std::size_t(std::stable_partition(seams.begin(), seams.end(), moves) - seams.begin());
    emitter_seams = std::any_of(seams.begin(), seams.begin() + std::ptrdiff_t(n_moving_seams),
                                [&](const Seam& seam) { return cuts_emitter(scene, seam); });
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

void BoundaryScene::seam_velocity(const Seam& seam, const Pt& p, Velocities out) const {
    std::vector<Vec> other(out.size());
    shape_velocity(seam.faces[0].shape_idx, seam.faces[0].triangle_idx, p, out);
    shape_velocity(seam.faces[1].shape_idx, seam.faces[1].triangle_idx, p, other);
    for (std::size_t k = 0; k < out.size(); ++k) out[k] = seam.velocity(out[k], other[k]);
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
    const double r = length(d), share = Attached::share_of(reach(shape, material), r);
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

BoundaryScene::Sides BoundaryScene::sides_of(const Seam& seam, const Pt& p, const Vec& view, const Vec& out) const {
    Sides sides;
    for (int i = 0; i < 2; ++i) {
        const Seam::Face& face = seam.faces[std::size_t(i)];
        const Vec w = seam.along_face(i, view);
        const TriangleRecord& triangle = scene.shapes[face.shape_idx].triangles[face.triangle_idx];
        // A little off the line: at it the point may be below the other surface.
        const double inside = 2 * clearance(p, std::max(length(Vec(triangle.e1)), length(Vec(triangle.e2))));
        const Point2<double> b = motions.barycentric_of(face.shape_idx, face.triangle_idx, p + w * inside);
        Hit& hit = dot(out, w) > 0 ? sides.back : sides.front;
        hit.shape_idx = face.shape_idx;
        hit.primitive_idx = face.triangle_idx;
        hit.u = float(b.x), hit.v = float(b.y);
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

Pt BoundaryScene::front_of_round(std::uint32_t shape_idx, const Pt& p, const Vec& view) const {
    const Shape& shape = scene.shapes[shape_idx];
    if (shape.kind != ShapeKind::sphere) return p;
    constexpr double cosine = 1e-3;  // between normal and view: more than rounding
    const Pt center(shape.round.center);
    return center + normalize(normalize(p - center) - view * cosine) * double(shape.round.radius);
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

}  // namespace

std::vector<BoundaryRows> sample_boundary(BoundaryScene& s, const Parts& parts, app::Report& report,
                                          std::vector<std::uint64_t>& samples, DeriveCounts& counts) {
    if (!s.all_seams)
        report.warn("biased: the search for lines where meshes cut each other ended early; {} were found",
                    s.seams.size());
    samples.assign(n_boundary_families, 0);
    std::vector<BoundaryRows> rows;
    counts.rays += sample_families(s, parts, rows, samples, report);
    return rows;
}

void differentiate_boundary(BoundaryScene& s, const Parts& parts, app::Report& report, Derivative& out,
                            DeriveCounts& counts) {
    std::vector<std::uint64_t> samples;
    std::vector<BoundaryRows> rows = sample_boundary(s, parts, report, samples, counts);
    set_rows(rows, s.n(), out);
    out.boundary_samples = std::move(samples);
}

}  // namespace loom::derive
