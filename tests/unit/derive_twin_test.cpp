// Derivatives of stored paths against a slow twin: the light of the path with its vertices moved, in double precision
// and step by step as the rules of attachment say, differenced over the parameter.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "stages/core/graph/time_of_flight.h"
#include "stages/core/scattering/bsdf_model.h"
#include "stages/core/scene/delta_light.h"
#include "stages/core/scene/nlos.h"
#include "stages/derive/interior.h"
#include "stages/derive/surface_motion.h"
#include "tests/unit/derive_scenes.h"

namespace loom::derive {
namespace {

using testing::add_parameter;
using testing::any_motion;
using Vec = Vector3<double>;
using Pt = Point3<double>;
using D = Dual<1, double>;
using Colour = Rgb<double>;

Vec values_of(const Vector3<D>& v) {
    return {v.x.value, v.y.value, v.z.value};
}
Vector3<D> constants(const Vec& v) {
    return {D(v.x), D(v.y), D(v.z)};
}

/// x + theta v(x), and what it does to normals and areas.
struct Affine {
    AffineVelocity v;
    double theta = 0;

    Pt point(const Pt& x) const { return x + v.at(x) * theta; }
    Vec vector(const Vec& d) const { return d + v.turned(d) * theta; }
    std::array<Vec, 3> columns() const { return {vector({1, 0, 0}), vector({0, 1, 0}), vector({0, 0, 1})}; }
    double det() const {
        const auto [x, y, z] = columns();
        return loom::dot(x, cross(y, z));
    }
    /// Inverse transpose times n, not normalised.
    Vec covector(const Vec& n) const {
        const auto [x, y, z] = columns();
        return (cross(y, z) * n.x + cross(z, x) * n.y + cross(x, y) * n.z) / det();
    }
    Vec normal(const Vec& n) const { return normalize(covector(n)); }
    Vec inverse(const Vec& d) const {
        const auto [x, y, z] = columns();
        return Vec{loom::dot(d, cross(y, z)), loom::dot(d, cross(z, x)), loom::dot(d, cross(x, y))} / det();
    }
    Pt inverse(const Pt& p) const { return Pt(inverse(Vec(p) - v.offset * theta)); }
};

class Twin {
  public:
    Twin(const PathGraph& g, const Scene& s, const SceneTangents& t)
        : g_(g), s_(s), t_(t), reader_(g), motions_(s, t) {}

    struct Light {
        Colour L;
        double opl = 0;
    };
    struct Path {
        std::vector<Light> edges;
        Light seen;
    };

    /// Whether the surface of a vertex has a delta lobe, so that rays to it keep their directions.
    bool has_delta(std::size_t j) const {
        const BsdfKind kind = reader_.model(g_.vertices.material[j]).kind;
        return kind == BsdfKind::conductor || kind == BsdfKind::dielectric || kind == BsdfKind::thin_dielectric ||
               kind == BsdfKind::plastic;
    }

    /// The light of a path with one parameter moved by theta.
    Path at(std::size_t path, std::uint32_t parameter, double theta) {
        p_ = parameter, theta_ = theta;
        const auto [begin, end] = vertices_of(g_, path);
        Path out;
        Segment from = camera(path, begin, end);
        out.seen.L = Colour(rgb(g_.paths.Le, path));
        if (begin == end) return out;
        std::size_t edge = first_light_edge(g_, begin);
        for (std::size_t j = begin; j < end; ++j) {
            const Vertex x = arrive(from, j);
            if (j == begin) {
                out.seen.opl = x.opl;
                const int e = s_.shapes[g_.vertices.shape[j]].emitter_idx;
                if (e >= 0) out.seen.L *= growth_of_radiance(std::size_t(e));
            }
            for (; edge < g_.n_light_edges() && g_.light_edges.vertex[edge] == j; ++edge)
                out.edges.push_back(light(from, x, edge));
            if (j + 1 < end) from = leave(from, x);
        }
        return out;
    }

  private:
    /// A segment that has started.
    struct Segment {
        Pt o;
        bool by_ray = true;
        Vec d;  // of the ray
        Colour beta{1};
        double opl = 0;
        // Scattering at its start, unless the camera is there or its factor is in beta.
        bool scatters = false;
        Bsdf<D> bsdf;
        Frame<double> frame;
        Vec wo_local;
        double weight = 1;
        Pt o_now;  // where it starts at theta = 0
    };
    struct Place {
        Pt x, x_now;
        Vec ng, ng_now;
        Vec ns, s;
        double area = 1;
    };
    struct Vertex : Place {
        std::size_t j = 0;
        Colour beta;
        double opl = 0;
        Bsdf<D> bsdf;
        Frame<double> frame;
        Vec wo_local;
        ShadingPoint now;
    };

    template <class E>
    const E* effect(const Effects<E>& effects) const {
        for (const auto& [p, e] : effects)
            if (p == p_) return &e;
        return nullptr;
    }
    Affine affine(const Effects<AffineVelocity>& effects) const {
        const AffineVelocity* v = effect(effects);
        return {v ? *v : AffineVelocity{}, theta_};
    }

    Segment camera(std::size_t path, std::size_t begin, std::size_t end) const {
        const Affine a = affine(t_.camera);
        Segment s;
        const Pt o = camera_origin<double>(g_, path);
        s.o = a.point(o), s.o_now = o;
        if (begin == end) return s;
        s.by_ray = !s_.nlos || s_.nlos->relay_wall == NlosCapture::no_wall;
        Vec d = normalize(position<double>(g_, begin) - o);
        if (const double* lens = effect(t_.lens)) {
            const auto& m = s_.sensor.world_from_camera;
            const Vec axis = normalize(Vec{m[2], m[6], m[10]});
            const double along = loom::dot(d, axis);
            d = axis * along + (d - axis * along) * (1 + theta_ * *lens);
        }
        s.d = normalize(a.vector(d));
        return s;
    }

    /// Moves a point of a shape; on a ray it slides along it.
    Place place(std::uint32_t shape_idx, std::uint32_t primitive, const Pt& p, const Vec& ng, const Vec& ns,
                const Vec& tangent, const Segment& from, Pt& source) const {
        const Shape& shape = s_.shapes[shape_idx];
        const Affine a = affine(t_.shapes[shape_idx]);
        Place out;
        out.x_now = p, out.ng_now = ng;
        const bool of_mesh = shape.kind == ShapeKind::mesh;
        std::array<Pt, 3> now, moved;
        std::array<Vec, 3> normals;
        Vec b{1, 0, 0};
        if (of_mesh && !g_.vertices.primitive.empty()) {
            const std::uint32_t* i = &shape.mesh.indices[3 * std::size_t(primitive)];
            for (std::size_t c = 0; c < 3; ++c) {
                now[c] = Pt(shape.mesh.positions[i[c]]);
                moved[c] = a.point(now[c]);
                if (!t_.vertices[shape_idx].empty())
                    if (const Vec* v = effect(t_.vertices[shape_idx][i[c]])) moved[c] = moved[c] + *v * theta_;
                if (!shape.mesh.normals.empty()) normals[c] = Vec(shape.mesh.normals[i[c]]);
            }
            b = weights(now, p);
        }
        const auto blend = [](const std::array<Pt, 3>& c, const Vec& w) {
            return Vec(c[0]) * w.x + Vec(c[1]) * w.y + Vec(c[2]) * w.z;
        };
        const auto face = [](const std::array<Pt, 3>& c) { return cross(c[1] - c[0], c[2] - c[0]); };
        const bool alone = !t_.vertices[shape_idx].empty();
        out.x = alone ? p + (blend(moved, b) - blend(now, b)) : a.point(p);
        if (alone) {
            const Vec n = normalize(face(moved)), n0 = normalize(face(now));
            out.ng = normalize(ng + (n - n0) * (loom::dot(n0, ng) < 0 ? -1.0 : 1.0));
            out.area = length(face(moved)) / length(face(now));
        } else {
            out.ng = a.normal(ng);
            out.area = std::abs(a.det()) * length(a.covector(ng));
        }
        source = p;
        if (from.by_ray) {
            if (shape.kind == ShapeKind::sphere) {
                // In the sphere's own space, through the point as it is stored.
                const Pt o = a.inverse(from.o), c(shape.round.center);
                const Vec d = a.inverse(from.d), oc = o - c;
                const double r2 = length2(p - c), A = length2(d), B = loom::dot(oc, d), C = length2(oc) - r2;
                const double root = std::sqrt(std::max(B * B - A * C, 0.0));
                const double t1 = (-B - root) / A, t2 = (-B + root) / A;
                const double t = length2(o + d * t1 - p) < length2(o + d * t2 - p) ? t1 : t2;
                source = o + d * t;
                out.x = from.o + from.d * t;
                const double sign = loom::dot(ng, p - c) < 0 ? -1 : 1;
                out.ng = a.normal(normalize(source - c) * sign);
            } else {
                const double t = loom::dot(out.ng, out.x - from.o) / loom::dot(out.ng, from.d);
                out.x = from.o + from.d * t;
                if (alone)
                    source = p + (blend(now, weights(moved, out.x)) -
                                  blend(now, weights(moved, p + (blend(moved, b) - blend(now, b)))));
                else
                    source = a.inverse(out.x);
            }
        }
        // The shading normal at the point of the shape that is there.
        Vec n = ns;
        if (shape.kind == ShapeKind::sphere) {
            const Pt c(shape.round.center);
            n = ns + (normalize(source - c) - normalize(p - c)) * (loom::dot(ns, p - c) < 0 ? -1.0 : 1.0);
        } else if (of_mesh && !shape.mesh.normals.empty() && !g_.vertices.primitive.empty()) {
            const auto smooth = [&](const Pt& q) {
                const Vec w = weights(now, q);
                return normalize(normals[0] * w.x + normals[1] * w.y + normals[2] * w.z);
            };
            const Vec n0 = smooth(p);
            n = ns + (smooth(source) - n0) * (loom::dot(n0, ns) < 0 ? -1.0 : 1.0);
        }
        const Affine turn = affine(t_.shading_normals[shape_idx]);
        const bool follows_face = alone && shape.mesh.normals.empty();
        out.ns = turn.normal(follows_face ? ns + (out.ng - ng) * (loom::dot(ng, ns) < 0 ? -1.0 : 1.0) : a.normal(n));
        const Vec s = turn.vector(a.vector(tangent));
        out.s = normalize(s - out.ns * loom::dot(out.ns, s));
        return out;
    }
    static Vec weights(const std::array<Pt, 3>& c, const Pt& p) {
        const Vec e1 = c[1] - c[0], e2 = c[2] - c[0], d = p - c[0], n = cross(e1, e2);
        const double u = loom::dot(cross(d, e2), n) / length2(n), v = loom::dot(cross(e1, d), n) / length2(n);
        return {1 - u - v, u, v};
    }

    void set_bsdf(Vertex& x, std::uint32_t material, const SurfacePlace& at, const Pt& source) const {
        x.bsdf = Bsdf<D>(x.now.bsdf);
        MaterialTangent change;
        if (const MaterialTangent* t = effect(t_.materials[material])) change += *t * theta_;
        if (s_.materials[material].textured()) change += motions_.texture_along(at, material, source - at.p);
        for (int c = 0; c < 3; ++c) {
            x.bsdf.diffuse[c].value += change.diffuse[c];
            x.bsdf.specular[c].value += change.specular[c];
            x.bsdf.transmittance[c].value += change.transmittance[c];
            x.bsdf.eta_c[c].value += change.eta_c[c];
            x.bsdf.k_c[c].value += change.k_c[c];
        }
        x.bsdf.alpha_u.value += change.alpha_u;
        x.bsdf.alpha_v.value += change.alpha_v;
        x.bsdf.eta.value += change.eta;
        x.bsdf.opacity.value += change.opacity;
        x.bsdf.exponent.value += change.exponent;
    }

    double index(const Column<float>& etas, const Column<std::uint16_t>& media, std::size_t row) const {
        double eta = etas.empty() ? 1.0 : double(etas[row]);
        if (!media.empty() && media[row] != no_medium)
            if (const MaterialTangent* t = effect(t_.materials[media[row]])) eta += theta_ * t->int_ior;
        return eta;
    }

    static Colour f_cos(const Bsdf<D>& bsdf, const Vec& wo, const Vec& wi) {
        const Rgb<D> f = f_cos_pdf(bsdf, constants(wo), constants(wi)).f_cos;
        return {f[0].value, f[1].value, f[2].value};
    }
    static Colour delta(const Vertex& x, Lobe lobe) {
        const Rgb<D> f = delta_value(x.bsdf, constants(x.wo_local), lobe);
        return {f[0].value, f[1].value, f[2].value};
    }
    static double geometry(const Vec& n, const Vec& d) { return std::abs(loom::dot(n, d)) / std::pow(length(d), 3); }

    /// Throughput of a segment that ends at a point.
    Colour end_factor(const Segment& from, const Place& x) const {
        Colour beta = from.beta;
        const Vec d = x.x - from.o;
        if (from.scatters) {
            const Vec u = from.frame.to_local(normalize(d));
            beta *= f_cos(from.bsdf, from.wo_local, u) * Colour(from.weight);
            beta *= Colour(geometry(x.ng, d) / geometry(x.ng_now, x.x_now - from.o_now) * x.area);
        }
        return beta;
    }

    Vertex arrive(const Segment& from, std::size_t j) const {
        Vertex x;
        x.j = j;
        x.now = reader_.vertex(j);
        SurfacePlace at{g_.vertices.shape[j],    g_.vertices.primitive.empty() ? 0 : g_.vertices.primitive[j],
                        position<double>(g_, j), Vec(x.now.ng),
                        Vec(x.now.frame.n),      Vec(x.now.frame.s)};
        Pt source;
        static_cast<Place&>(x) = place(at.shape_idx, at.primitive_idx, at.p, at.ng, at.ns, at.tangent, from, source);
        const Vec t = cross(x.ns, x.s) * (loom::dot(cross(at.ns, at.tangent), Vec(x.now.frame.t)) < 0 ? -1.0 : 1.0);
        x.frame = {x.s, t, Normal3<double>(x.ns)};
        const Vec d = x.x - from.o;
        x.wo_local = x.frame.to_local(-normalize(d));
        set_bsdf(x, g_.vertices.material[j], at, source);
        x.beta = end_factor(from, x);
        x.opl = from.opl + index(g_.vertices.eta, g_.vertices.medium, j) * length(d);
        return x;
    }

    Segment starting_at(const Vertex& x) const {
        Segment s;
        s.o = x.x, s.o_now = x.x_now;
        s.by_ray = false;
        s.beta = x.beta;
        s.opl = x.opl;
        return s;
    }
    Segment along_delta(const Vertex& x, Lobe lobe, double weight) const {
        Segment s = starting_at(x);
        s.beta *= delta(x, lobe) * Colour(weight);
        s.by_ray = true;
        s.d = normalize(x.frame.to_world(values_of(delta_direction(x.bsdf, constants(x.wo_local), lobe))));
        return s;
    }
    Segment scattered(const Vertex& x, double weight) const {
        Segment s = starting_at(x);
        s.scatters = true;
        s.bsdf = x.bsdf, s.frame = x.frame, s.wo_local = x.wo_local;
        s.weight = weight;
        return s;
    }

    Segment leave(const Segment& from, const Vertex& x) const {
        const Lobe lobe = Lobe(g_.vertices.lobe[x.j]);
        const double weight = 1 / double(g_.vertices.pdf_w[x.j]);
        if (lobe == Lobe::null) {
            Segment s = from;
            s.beta *= delta(x, lobe) * Colour(weight);
            return s;
        }
        if (is_delta(lobe)) return along_delta(x, lobe, weight);
        std::size_t next = x.j + 1;
        while (Lobe(g_.vertices.lobe[next]) == Lobe::null && (g_.vertices.flags[next] & vertex_flag::continued)) ++next;
        if (!has_delta(next)) return scattered(x, weight);
        // The sampled direction stays in the frame.
        const Vec wi = Vec(x.now.frame.to_local(continuation_direction(g_, x.j)));
        Segment s = starting_at(x);
        s.beta *= f_cos(x.bsdf, x.wo_local, wi) * Colour(weight);
        s.by_ray = true;
        s.d = normalize(x.frame.to_world(wi));
        return s;
    }

    Colour growth_of_radiance(std::size_t emitter) const {
        Colour growth(1);
        const Emitter& e = s_.emitters[emitter];
        if (const Colour* rate = effect(t_.radiance[emitter]))
            for (int c = 0; c < 3; ++c)
                growth[c] += theta_ * (*rate)[c] /
                             (e.kind == EmitterKind::envmap || e.texture_idx >= 0 ? 1.0 : double(e.radiance[c]));
        return growth;
    }

    Light light(const Segment& before, const Vertex& x, std::size_t k) const {
        const auto& e = g_.light_edges;
        const std::size_t emitter = e.emitter[k];
        const Emitter& of = s_.emitters[emitter];
        const Lobe lobe = Lobe(g_.vertices.lobe[x.j]);
        const bool next_event = LightTechnique(e.technique[k]) == LightTechnique::next_event;
        const double weight = double(mis_weight(next_event, e.pdf_nee_w[k], e.pdf_bsdf_w[k], Heuristic::power)) /
                              double(next_event ? e.pdf_nee_w[k] : g_.vertices.pdf_w[x.j]);
        Segment from;
        if (next_event || !is_delta(lobe)) {
            from = scattered(x, weight);
        } else if (lobe == Lobe::null) {
            from = before;
            from.beta *= delta(x, lobe) * Colour(weight);
        } else {
            from = along_delta(x, lobe, weight);
        }
        Colour Li = Colour(rgb(e.Li, k)) * growth_of_radiance(emitter);
        const Vec y{e.y[4 * k], e.y[4 * k + 1], e.y[4 * k + 2]};
        Light out;
        if (e.y[4 * k + 3] == 0) {
            out.opl = INFINITY;
            const Affine a = affine(t_.emitters[emitter]);
            out.L = from.beta;
            if (!from.by_ray)
                out.L *=
                    f_cos(from.bsdf, from.wo_local, from.frame.to_local(normalize(a.vector(y)))) * Colour(from.weight);
            out.L *= Li;
            return out;
        }
        Place light;
        if (of.kind == EmitterKind::area) {
            const Vec n(unit_vector<Normal3f>(e.n, k));
            const Vec s = Frame<double>(Normal3<double>(n)).s;
            Pt source;
            light = place(of.shape_idx, 0, Pt(y), n, n, s, from, source);
        } else {
            light.x_now = Pt(y), light.x = affine(t_.emitters[emitter]).point(light.x_now);
            light.ng = light.ng_now = {};
            Li *= change_of_delta_light(x, k, of, emitter);
        }
        out.opl = from.opl + index(e.eta, e.medium, k) * length(light.x - from.o);
        if (of.kind == EmitterKind::area) {
            out.L = end_factor(from, light) * Li;
        } else {
            out.L = from.beta * f_cos(from.bsdf, from.wo_local, from.frame.to_local(normalize(light.x - from.o))) *
                    Colour(from.weight) * Li;
        }
        return out;
    }

    /// Light of an emitter without area at a vertex, over that at theta = 0.
    Colour change_of_delta_light(const Vertex& x, std::size_t k, const Emitter& e, std::size_t emitter) const {
        if (s_.nlos && s_.nlos->laser_sampling) return change_of_laser_spot(x, k);
        const auto at = [&](const Affine& a, const Pt& p) {
            EmitterPose<D> pose(e);
            pose.position = Point3<D>(constants(Vec(a.point(Pt(e.position)))));
            // The axis follows; the others stay square to it.
            const Vec n = normalize(a.vector(Vec(e.frame.n)));
            Vec s = a.vector(Vec(e.frame.s));
            s = normalize(s - n * loom::dot(n, s));
            const Vec t =
                cross(n, s) * (loom::dot(cross(Vec(e.frame.n), Vec(e.frame.s)), Vec(e.frame.t)) < 0 ? -1. : 1.);
            pose.frame = {constants(s), constants(t), Normal3<D>(constants(n))};
            const Rgb<D> Li = delta_light(s_, e, pose, Point3<D>(constants(Vec(p)))).Li;
            return Colour(Li[0].value, Li[1].value, Li[2].value);
        };
        const Colour now = at({}, x.x_now), moved = at(affine(t_.emitters[emitter]), x.x);
        Colour ratio(1);
        for (int c = 0; c < 3; ++c)
            if (now[c] > 0) ratio[c] = moved[c] / now[c];
        return ratio;
    }
    Colour change_of_laser_spot(const Vertex& x, std::size_t k) const {
        const auto& e = g_.light_edges;
        const Pt spot{e.y[4 * k], e.y[4 * k + 1], e.y[4 * k + 2]};
        const Normal3f n = unit_vector<Normal3f>(e.n, k);
        const std::uint32_t material = s_.shapes[s_.nlos->laser_points[0].hit.shape_idx].material_idx;
        const Frame<double> frame{Normal3<double>(Vec(n))};
        const auto at = [&](const Pt& p, double theta) {
            Bsdf<D> bsdf{Bsdf<float>(s_.materials[material].model)};
            if (const MaterialTangent* t = effect(t_.materials[material]))
                for (int c = 0; c < 3; ++c) bsdf.diffuse[c].value += theta * t->diffuse[c];
            const Vec d = p - spot;
            return f_cos(bsdf, frame.to_local(normalize(d)),
                         frame.to_local(normalize(Pt(s_.emitters[0].position) - spot))) *
                   Colour(geometry(Vec(n), d));
        };
        const Colour now = at(x.x_now, 0), moved = at(x.x, theta_);
        return {moved[0] / now[0], moved[1] / now[1], moved[2] / now[2]};
    }

    const PathGraph& g_;
    const Scene& s_;
    const SceneTangents& t_;
    GraphReader reader_;
    SurfaceMotions motions_;
    std::uint32_t p_ = 0;
    double theta_ = 0;
};

// Detected mutations: 2 for 3 in the power of r; the area's growth left out; a sign of the twist in local_change() or in
// set_ray(), and none; smooth normals that stay while a point slides; the index's change of length, or of direction, left
// out; delta lights that stay.
/// Compares all rows of all parameters with the twin.
/// out:     rows by parameter whose derivative is not 0
std::vector<std::size_t> compare(const Scene& scene, const SceneTangents& t, std::uint64_t spp, std::uint64_t seed) {
    const PathGraph g =
        testing::trace_graph(scene, testing::path_options(scene, seed), spp, 0, testing::derive_columns);
    EXPECT_EQ(missing_columns(g, scene, t), "");
    const InteriorWalker walker(g, scene, t);
    const GraphReader reader(g);
    const OpticalLengths lengths(g, {});
    Twin twin(g, scene, t);
    std::vector<std::size_t> n_rows(t.n());
    constexpr double h = 1e-5;
    std::size_t edge = 0, walked = 0, n_plain = 0, n_bad = 0;
    // The laser's own segment rests.
    const double to_laser =
        scene.nlos ? double(length(scene.emitters[0].position - scene.nlos->laser_points[0].p)) : 0.0;
    for (std::size_t path = 0; path < g.n_paths() && n_bad < 20; ++path) {
        const std::size_t first = edge;
        // Stored points lie off the directions of delta lobes by rounding, which a chain of them magnifies.
        bool by_delta = false;
        const auto [begin, end] = vertices_of(g, path);
        for (std::size_t j = begin; j < end; ++j) by_delta |= twin.has_delta(j);
        n_plain += std::size_t(!by_delta);
        const double tolerance = by_delta ? 1e-3 : 3e-4;
        std::vector<Twin::Light> now;
        walk_edges_in_time(
            reader, lengths, path, edge, [](const Spectrum&, double) {},
            [&](std::size_t, const Spectrum& L, double opl) {
                now.push_back({Colour(L), opl});
            });
        // Rows by light edge; the last is the directly visible emitter.
        std::vector<std::vector<float>> dL(now.size() + 1, std::vector<float>(3 * t.n())),
            dopl(now.size() + 1, std::vector<float>(t.n()));
        const auto keep = [&](std::size_t i, const InteriorRow& row) {
            dL[i].assign(row.dL.begin(), row.dL.end());
            dopl[i].assign(row.dopl.begin(), row.dopl.end());
        };
        if (walker.touches(path))
            walker.walk(
                path, walked, [&](const InteriorRow& row) { keep(row.row - first, row); },
                [&](const InteriorRow& row) { keep(now.size(), row); });
        walked = edge;
        const Twin::Path value = twin.at(path, 0, 0);
        EXPECT_EQ(value.edges.size(), now.size());
        for (std::size_t i = 0; i < now.size(); ++i) {
            for (int c = 0; c < 3; ++c)
                EXPECT_NEAR(value.edges[i].L[c], now[i].L[c], 1e-3 * now[i].L[c] + 1e-9) << path << " " << i;
            if (std::isfinite(now[i].opl)) {
                EXPECT_NEAR(value.edges[i].opl, now[i].opl - to_laser, 1e-5 * now[i].opl);
            }
        }
        for (std::uint32_t p = 0; p < t.n(); ++p) {
            const Twin::Path above = twin.at(path, p, h), below = twin.at(path, p, -h);
            for (std::size_t i = 0; i <= now.size(); ++i) {
                const Twin::Light &a = i < now.size() ? above.edges[i] : above.seen,
                                  &b = i < now.size() ? below.edges[i] : below.seen,
                                  &v = i < now.size() ? value.edges[i] : value.seen;
                bool any = false;
                const auto check = [&](const char* what, double got, double expected, double scale) {
                    any |= expected != 0;
                    if (std::abs(got - expected) <= tolerance * (std::abs(expected) + scale)) return;
                    ++n_bad;
                    ADD_FAILURE() << t.parameters[p].name << ", path " << path << ", row " << i << ": " << what << " "
                                  << got << ", expected " << expected;
                };
                for (int c = 0; c < 3; ++c)
                    check("dL", dL[i][3 * p + std::size_t(c)], (a.L[c] - b.L[c]) / (2 * h), v.L[c]);
                if (std::isfinite(v.opl)) check("dopl", dopl[i][p], (a.opl - b.opl) / (2 * h), v.opl);
                n_rows[p] += std::size_t(any);
            }
        }
    }
    EXPECT_GT(n_plain, g.n_paths() / 10);
    return n_rows;
}

/// One parameter of each kind: motions of each shape, vertices, normals, the camera, the lens, each number of each
/// material, each emitter.
SceneTangents all_kinds(const Scene& scene) {
    SceneTangents t(scene);
    unsigned seed = 100;
    for (std::uint32_t s = 0; s < scene.shapes.size(); ++s)
        t.shapes[s].push_back({add_parameter(t, "motion of " + scene.shapes[s].id), any_motion(seed++)});
    for (std::uint32_t s = 0; s < scene.shapes.size(); ++s) {
        const Shape& shape = scene.shapes[s];
        if (shape.mesh.normals.empty() && shape.id != "slab") continue;
        t.shading_normals[s].push_back(
            {add_parameter(t, "normals of " + shape.id), testing::rigid_motion({0.3, -0.5, 0.7}, {})});
        const std::uint32_t p = add_parameter(t, "vertices of " + shape.id);
        std::mt19937 random(seed++);
        std::uniform_real_distribution<double> u(-1, 1);
        for (std::size_t i = 0; i < shape.mesh.positions.size(); ++i)
            t.vertices[s].push_back({{p, Vec{u(random), u(random), u(random)}}});
    }
    t.camera.push_back({add_parameter(t, "camera"), testing::rigid_motion({0.2, 0.4, -0.3}, {0.3, -0.2, 0.5})});
    t.lens.push_back({add_parameter(t, "lens"), 0.7});
    for (std::size_t e = 0; e < scene.emitters.size(); ++e) {
        t.radiance[e].push_back({add_parameter(t, "radiance of " + scene.emitters[e].id), {0.5, 1, -0.3}});
        if (scene.emitters[e].kind == EmitterKind::area) continue;
        t.emitters[e].push_back({add_parameter(t, "pose of " + scene.emitters[e].id),
                                 testing::rigid_motion({0.5, -0.2, 0.4}, {-0.3, 0.6, 0.2})});
    }
    return t;
}
SceneTangents all_materials(const Scene& scene) {
    SceneTangents t(scene);
    for (std::uint32_t m = 0; m < scene.materials.size(); ++m) {
        MaterialTangent colours, roughness, index;
        colours.diffuse = {0.3, -0.2, 0.5};
        colours.specular = {0.1, 0.4, -0.2};
        colours.transmittance = {-0.3, 0.2, 0.6};
        colours.opacity = 0.4;
        roughness.alpha_u = 0.3, roughness.alpha_v = -0.2;
        roughness.exponent = 3;
        index.eta = 0.8, index.int_ior = 0.9;
        index.eta_c = {0.2, 0.3, 0.1}, index.k_c = {-0.1, 0.2, 0.3};
        const std::string of = fmt::format(" of {} {}", m, scene.materials[m].id);
        t.materials[m].push_back({add_parameter(t, "colours" + of), colours});
        t.materials[m].push_back({add_parameter(t, "roughness" + of), roughness});
        t.materials[m].push_back({add_parameter(t, "index" + of), index});
    }
    return t;
}

void expect_rows(const SceneTangents& t, const std::vector<std::size_t>& n_rows, const std::string& of) {
    for (std::size_t p = 0; p < t.n(); ++p)
        if (t.parameters[p].name.starts_with(of)) {
            EXPECT_GT(n_rows[p], 10u) << t.parameters[p].name;
        }
}

TEST(DeriveTwin, AreaLights) {
    const auto scene = testing::load_room(testing::area_lights);
    const SceneTangents t = all_kinds(*scene);
    expect_rows(t, compare(*scene, t, 4, 11), "");
}
TEST(DeriveTwin, DeltaLights) {
    const auto scene = testing::load_room(testing::delta_lights);
    const SceneTangents t = all_kinds(*scene);
    expect_rows(t, compare(*scene, t, 4, 12), "");
}
TEST(DeriveTwin, Materials) {
    const auto scene = testing::load_room(testing::area_lights);
    const SceneTangents t = all_materials(*scene);
    const std::vector<std::size_t> n_rows = compare(*scene, t, 4, 13);
    std::size_t n_kinds = 0;
    for (std::size_t p = 0; p < t.n(); ++p) n_kinds += std::size_t(n_rows[p] > 10);
    EXPECT_GE(n_kinds, 14u);
}
TEST(DeriveTwin, NlosCapture) {
    const auto scene = load_scene(LOOM_SOURCE_DIR "/scenes/nlos.xml", {{"res", "6"}});
    SceneTangents t(*scene);
    for (std::uint32_t s = 0; s < scene->shapes.size(); ++s)
        if (s != scene->nlos->relay_wall)
            t.shapes[s].push_back({add_parameter(t, "motion of " + scene->shapes[s].id), any_motion(7 + s)});
    for (std::uint32_t m = 0; m < scene->materials.size(); ++m) {
        MaterialTangent colours;
        colours.diffuse = {0.3, -0.2, 0.5};
        t.materials[m].push_back({add_parameter(t, fmt::format("colours of {}", m)), colours});
    }
    expect_rows(t, compare(*scene, t, 30, 14), "");
}

// The coat of a rough plastic comes from tables, which depend on roughness and index: against other tables.
// Detected mutations: tables without slopes (refused by the formulas).
TEST(DeriveTwin, CoatOfRoughPlastic) {
    const auto scene = testing::load_inline(
        {R"(type="perspective"><float name="fov" value="40"/><transform name="to_world"><lookat origin="0, 0, 3" target="0, 0, 0" up="0, 1, 0"/></transform>)",
         R"(<shape type="rectangle"><bsdf type="roughplastic" id="coat"><string name="distribution" value="ggx"/><float name="alpha" value="0.3"/>
<float name="int_ior" value="1.5"/><rgb name="diffuse_reflectance" value="0.3, 0.5, 0.7"/></bsdf></shape>
<emitter type="point"><point name="position" x="0.5" y="0.3" z="1"/></emitter>)",
         8, 8, 2});
    SceneTangents t(*scene);
    std::uint32_t m = 0;
    while (scene->materials[m].id != "coat") ++m;
    MaterialTangent roughness, index;
    roughness.alpha_u = roughness.alpha_v = index.eta = index.int_ior = 1;
    t.materials[m] = {{add_parameter(t, "roughness"), roughness}, {add_parameter(t, "index"), index}};
    const PathGraph g = testing::trace_graph(*scene, testing::path_options(*scene, 15), 4, 0, testing::derive_columns);
    const GraphReader reader(g);
    const InteriorWalker walker(g, *scene, t);
    const auto value = [&](const ShadingPoint& at, const Vector3f& wi, float alpha, float eta) {
        BsdfModel model = *at.bsdf.model;
        model.coats = nullptr;
        model.alpha_u = model.alpha_v = alpha;
        model.int_ior = eta;
        prepare(model);
        Bsdf<float> bsdf(model);
        bsdf.diffuse = at.bsdf.diffuse, bsdf.specular = at.bsdf.specular;
        return Colour(f_cos_pdf(bsdf, at.wo_local, at.frame.to_local(wi)).f_cos);
    };
    std::size_t edge = 0, n_rows = 0;
    constexpr float h = 4e-3f;
    for (std::size_t path = 0; path < g.n_paths(); ++path)
        walker.walk(
            path, edge,
            [&](const InteriorRow& row) {
                if (++n_rows % 8 != 0) return;
                const std::size_t j = g.light_edges.vertex[row.row];
                const ShadingPoint at = reader.vertex(j);
                const Vector3f wi = reader.light_direction(at.p, row.row);
                const Colour by_alpha = (value(at, wi, 0.3f + h, 1.5f) - value(at, wi, 0.3f - h, 1.5f)) / (2.0 * h),
                             by_eta = (value(at, wi, 0.3f, 1.5f + h) - value(at, wi, 0.3f, 1.5f - h)) / (2.0 * h);
                const Colour Li(rgb(g.light_edges.Li, row.row));
                for (int c = 0; c < 3; ++c) {
                    const double scale = 2e-2 * Li[c] * value(at, wi, 0.3f, 1.5f)[c];
                    EXPECT_NEAR(row.dL[std::size_t(c)], by_alpha[c] * Li[c], scale);
                    EXPECT_NEAR(row.dL[std::size_t(3 + c)], by_eta[c] * Li[c], scale);
                }
            },
            [](const InteriorRow&) {});
    EXPECT_GT(n_rows, 100u);
}

}  // namespace
}  // namespace loom::derive
