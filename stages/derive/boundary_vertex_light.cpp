// Family 1: from a stored vertex, the edges in front of an emitter, clipped to its outline.
//   sum over visible silhouettes of beta f_cos(omega) Le(y -> x_S) swept / r_B^2 dl_B

#include <tbb/enumerable_thread_specific.h>

#include <algorithm>

#include "stages/core/sampling/streams.h"
#include "stages/core/scene/scene.h"
#include "stages/derive/boundary.h"
#include "stages/derive/interior.h"
#include "stages/derive/outline.h"

namespace loom::derive {
namespace {

using Vec = Vector3<double>;
using Pt = Point3<double>;

/// A part of an area light that is convex and flat, or a sphere.
struct LightPiece {
    std::array<Point3f, 4> corners;
    int n_corners = 0;  // 0: a sphere
    Normal3f n;         // of the emitting side
    std::uint32_t primitive_idx = 0;
    double pmf = 1;
};

LightPiece choose_piece(const Scene& scene, const Emitter& e, float& u) {
    const Shape& shape = scene.shapes[e.shape_idx];
    LightPiece piece;
    if (shape.kind == ShapeKind::sphere) return piece;
    if (shape.kind == ShapeKind::disk) {
        // A square around it; points beyond the rim emit nothing.
        piece.corners = corners_of_flat_light(shape);
        piece.n_corners = 4;
        piece.n = shape.flip_normals ? -shape.round.disk_normal() : shape.round.disk_normal();
        return piece;
    }
    const Mesh& mesh = shape.mesh;
    if (e.parallelogram) {
        piece.corners = corners_of_flat_light(shape);
        piece.n_corners = 4;
        piece.n = e.normals[0];
        return piece;
    }
    piece.primitive_idx = std::uint32_t(e.triangles.sample(u));
    piece.pmf = double(e.triangles.pmf(piece.primitive_idx));
    const std::uint32_t* i = &mesh.indices[3 * std::size_t(piece.primitive_idx)];
    piece.corners = {mesh.positions[i[0]], mesh.positions[i[1]], mesh.positions[i[2]], {}};
    piece.n_corners = 3;
    piece.n = e.normals[piece.primitive_idx];
    if (!mesh.normals.empty()) {
        const Vector3f ns = Vector3f(mesh.normals[i[0]]) + Vector3f(mesh.normals[i[1]]) + Vector3f(mesh.normals[i[2]]);
        if ((dot(ns, piece.n) < 0) != shape.flip_normals) piece.n = -piece.n;
    }
    return piece;
}

class Sampling {
  public:
    /// in:      sampled_at  by emitter: the vertices (reached_by) that sample it
    Sampling(const BoundaryScene& s, const std::vector<char>& sampled_at)
        : s_(s),
          sampled_at_(sampled_at),
          v_light_(s.n()),
          rates_(s.n()),
          outline_(s),
          walker_(s.graph, s.scene, s.tangents, s.attached) {
        for (const char reached : sampled_at) wanted_ |= reached;
    }

    std::uint64_t n_rays = 0, n_samples = 0, n_walked = 0, n_scanned = 0;
    std::uint64_t n_listed() const { return outline_.n_found(); }

    void sample_path(std::size_t path, double share, BoundaryRows& rows) {
        const std::uint64_t seed = streams::family(s_.seed, 1);
        if (!find_wanted(path)) return;
        const std::size_t first = s_.graph.paths.first_vertex[path];
        walker_.walk_vertices(path, [&](const VertexState& x) {
            ++n_walked;
            const char reached = reached_[x.vertex - first];
            if (!(reached & wanted_)) return;
            const Sampler sampler(SamplerKind::independent, seed, x.vertex, 0);
            ++n_samples;
            sample_vertex(x, path, share, reached, sampler, rows);
        });
    }

  private:
    /// Finds what the vertices of a path are reached by; 0 where no emitter was sampled. Returns whether any is wanted.
    bool find_wanted(std::size_t path) {
        const auto& vertices = s_.graph.vertices;
        reached_.clear();
        char next = reached_by::camera, any = 0;
        Pt before;
        std::size_t material = 0;  // there
        for (std::size_t j = s_.graph.paths.first_vertex[path]; j < s_.graph.paths.first_vertex[path + 1]; ++j) {
            ++n_scanned;
            const Pt p = position<double>(s_.graph, j);
            char here = next;
            if (here == reached_by::joined && !s_.joins(length(p - before), material, vertices.material[j]))
                here = reached_by::unjoined;
            const Lobe lobe = Lobe(vertices.lobe[j]);
            if (lobe != Lobe::null)
                next = is_delta(lobe) ? reached_by::delta : reached_by::joined, before = p,
                material = vertices.material[j];
            else if (here == reached_by::camera)
                next = reached_by::delta;
            reached_.push_back(vertices.flags[j] & vertex_flag::attempted_nee ? here : char(0));
            any |= reached_.back();
        }
        return any & wanted_;
    }

    void sample_vertex(const VertexState& x, std::size_t path, double share, char reached, const Sampler& sampler,
                       BoundaryRows& rows) {
        const Scene& scene = s_.scene;
        float u_emitter = sampler.pair(0).x;
        const std::size_t emitter_idx = scene.emitter_pmf.sample(u_emitter);
        const Emitter& e = scene.emitters[emitter_idx];
        if (e.kind != EmitterKind::area || !(sampled_at_[emitter_idx] & reached)) return;
        const LightPiece piece = choose_piece(scene, e, u_emitter);
        const ShadingPoint& at = *x.at;
        if (piece.n_corners > 0 && !(dot(piece.n, at.p - piece.corners[0]) > 0)) return;

        // List the silhouettes in front of the light.
        const bool moves =
            std::any_of(x.velocity.begin(), x.velocity.end(), [](const Vec& v) { return !(v == Vec{}); });
        const EdgeTree& tree = s_.edges(moves || s_.emitter_moves(emitter_idx));
        const RayEnd from{at.p, transmits(at) ? Normal3f{} : facing(at.ng, at.wo), hit_error(x.vertex)};
        const Shape& light = scene.shapes[e.shape_idx];
        const Shaft shaft = piece.n_corners > 0
                                ? Shaft::to_polygon(from, std::span(piece.corners).first(std::size_t(piece.n_corners)),
                                                    s_.touched_emitters[emitter_idx] != 0)
                                : Shaft::to_sphere(from, light.round.center, light.round.radius);
        const bool all = &tree == &s_.all_edges;
        const Pt x_s(at.p);
        if (!outline_.collect(shaft, x_s, false, x.velocity, s_.emitter_speed[emitter_idx], tree, all, 1,
                              sampler.pair(2).x))
            return;
        OutlinePoint b;
        if (!outline_.sample(sampler.pair(1), b)) return;
        Pt y;
        if (!light_point(piece, light, x_s, b.omega, y)) return;
        // Edges of others may lie on the light; its own move as it does.
        const double r = length(y - x_s);
        const bool on_light = s_.lies_on(b.p, e.shape_idx, piece.primitive_idx);
        if (on_light ? b.shape_idx == e.shape_idx : !(r > b.r)) return;

        // Rate at which light appears beside the edge.
        s_.shape_velocity(e.shape_idx, piece.primitive_idx, y, v_light_);
        bool any = false;
        for (std::size_t p = 0; p < s_.n(); ++p) {
            rates_[p] = swept(
                b.out, relative_velocity(std::min(b.r / r, 1.0), outline_.velocity()[p], x.velocity[p], v_light_[p]));
            any |= rates_[p] != 0;
        }
        if (!any) return;
        const Vector3f wi(b.omega);
        const Spectrum f_cos = f_cos_pdf(at, wi).f_cos;
        if (is_black(f_cos)) return;
        const Spectrum Le = emission(e, light, piece, y, -wi);
        if (is_black(Le)) return;

        // Pass the edge on its outer side.
        const Vec beside = b.omega + b.out * (s_.clearance(b.p, b.r) / (length(b.out) * b.r));
        Pt y_beside;
        if (!light_point(piece, light, x_s, normalize(beside), y_beside)) y_beside = y;
        const RayEnd end{Point3f(y_beside), normal_at(piece, light, y_beside), light.hit_error};
        ++n_rays;
        if (scene.occluded(spawn_segment(RayEnd{at.p, at.ng, hit_error(x.vertex)}, end))) return;

        const double density = b.density * piece.pmf * double(scene.emitter_pmf.pmf(emitter_idx)) * share *
                               double(s_.graph.tracing.samples_per_pixel);
        const Rgb<double> value =
            x.beta * Rgb<double>(f_cos) * Rgb<double>(Le) * Rgb<double>(1 / (b.r * b.r * density));
        rows.add(path % s_.graph.n_pixels(), x.opl + index_towards(arriving_index(s_.graph, x.vertex), at, wi) * r,
                 x.camera_opl, value, rates_, BoundaryFamily::vertex_light, path);
    }

    static bool transmits(const ShadingPoint& at) {
        return at.bsdf.model->kind == BsdfKind::rough_dielectric || at.bsdf.model->kind == BsdfKind::dielectric;
    }
    float hit_error(std::size_t vertex) const { return s_.scene.shapes[s_.graph.vertices.shape[vertex]].hit_error; }

    static bool light_point(const LightPiece& piece, const Shape& light, const Pt& from, const Vec& d, Pt& y) {
        if (piece.n_corners > 0) {
            const Vec n(piece.n);
            const double t = dot(n, Pt(piece.corners[0]) - from) / dot(n, d);
            if (!(t > 0)) return false;
            y = from + d * t;
            if (light.kind != ShapeKind::disk) return true;
            return length2(y - Pt(light.round.center)) <= length2(Vec(light.round.u_axis));
        }
        const Vec to_center = Pt(light.round.center) - from;
        const double b = dot(to_center, d), c = length2(to_center) - sqr(double(light.round.radius));
        const double root = b * b - c;
        if (!(root > 0)) return false;
        const double near = b - std::sqrt(root), t = near > 0 ? near : b + std::sqrt(root);
        if (!(t > 0)) return false;
        y = from + d * t;
        return true;
    }
    static Normal3f normal_at(const LightPiece& piece, const Shape& light, const Pt& y) {
        return piece.n_corners > 0 ? piece.n : Normal3f(normalize(Vector3f(y - Pt(light.round.center))));
    }
    Spectrum emission(const Emitter& e, const Shape& light, const LightPiece& piece, const Pt& y, const Vector3f& to) {
        SurfacePoint at;
        if (light.kind == ShapeKind::mesh) {
            Hit hit;
            hit.shape_idx = e.shape_idx;
            hit.primitive_idx = piece.primitive_idx;
            if (e.parallelogram) {
                // The second triangle is the other half.
                Point2<double> b = s_.motions.barycentric_of(e.shape_idx, 0, y);
                if (b.x < 0 || b.y < 0 || b.x + b.y > 1) {
                    hit.primitive_idx = 1;
                    b = s_.motions.barycentric_of(e.shape_idx, 1, y);
                }
                hit.u = float(b.x), hit.v = float(b.y);
            } else {
                const Point2<double> b = s_.motions.barycentric_of(e.shape_idx, piece.primitive_idx, y);
                hit.u = float(b.x), hit.v = float(b.y);
            }
            at = s_.scene.surface(Ray{Point3f(y), -to}, hit);
        } else {
            Hit hit;
            hit.shape_idx = e.shape_idx;
            hit.t = 0;
            if (light.kind == ShapeKind::disk) {
                const Vec d = y - Pt(light.round.center), u(light.round.u_axis), v(light.round.v_axis);
                hit.u = float(dot(d, u) / length2(u)), hit.v = float(dot(d, v) / length2(v));
            }
            at = s_.scene.surface(Ray{Point3f(y), -to}, hit);
        }
        return emitted(s_.scene, at, to);
    }

    const BoundaryScene& s_;
    const std::vector<char>& sampled_at_;
    char wanted_ = 0;
    std::vector<char> reached_;  // [vertex of the path]
    std::vector<Vec> v_light_;
    std::vector<double> rates_;
    Outline outline_;
    InteriorWalker walker_;
};

}  // namespace

Effort add_vertex_light(const BoundaryScene& s, double share, const std::vector<char>& sampled_at,
                        std::vector<BoundaryRows>& rows, std::span<std::uint64_t> samples, app::Report& report) {
    tbb::enumerable_thread_specific<Sampling> workers([&] { return Sampling(s, sampled_at); });
    sample_in_chunks(s, s.graph.n_paths(), 4096, "edges in front of emitters", workers, rows, report,
                     [&](Sampling& worker, BoundaryRows& out, std::uint64_t begin, std::uint64_t end) {
                         for_chosen(streams::family(s.seed, 1), share, begin, end,
                                    [&](std::size_t path) { worker.sample_path(path, std::min(share, 1.0), out); });
                     });
    Effort effort;
    std::uint64_t n_walked = 0, n_scanned = 0, n_listed = 0;
    for (const Sampling& worker : workers) {
        effort.rays += worker.n_rays;
        n_walked += worker.n_walked, n_scanned += worker.n_scanned, n_listed += worker.n_listed();
        samples[std::size_t(BoundaryFamily::vertex_light)] += worker.n_samples;
    }
    effort.steps = 3 * n_walked / 2 + n_scanned / 20 + n_listed / 6;
    return effort;
}

}  // namespace loom::derive
