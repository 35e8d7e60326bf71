#include "stages/derive/reverse.h"

#include <tbb/enumerable_thread_specific.h>

#include <algorithm>
#include <cmath>

#include "stages/core/app/report.h"
#include "stages/core/compute/parallel.h"
#include "stages/core/graph/own_samples.h"
#include "stages/core/scattering/gradient.h"
#include "stages/core/scene/delta_light.h"
#include "stages/derive/path_source.h"

namespace loom::derive {

using Vec = Vector3<double>;
using Pt = Point3<double>;

AffineGradient& AffineGradient::operator+=(const AffineGradient& o) {
    for (std::size_t i = 0; i < linear.size(); ++i) linear[i] += o.linear[i];
    offset = offset + o.offset;
    return *this;
}

double AffineGradient::along(const AffineVelocity& v) const {
    double sum = dot(offset, v.offset);
    for (std::size_t i = 0; i < linear.size(); ++i) sum += linear[i] * v.linear[i];
    return sum;
}

GradientSums::GradientSums(const Scene& scene)
    : shapes(scene.shapes.size()),
      normals(scene.shapes.size()),
      materials(scene.materials.size()),
      emitters(scene.emitters.size()),
      radiance(scene.emitters.size()) {}

void GradientSums::add_dense(const GradientSums& o) {
    const auto add = [](auto& to, const auto& from) {
        for (std::size_t i = 0; i < to.size(); ++i) to[i] += from[i];
    };
    add(shapes, o.shapes);
    add(normals, o.normals);
    add(materials, o.materials);
    add(emitters, o.emitters);
    add(radiance, o.radiance);
    camera += o.camera;
    lens += o.lens;
    loss += o.loss;
}

namespace {

/// Sum of the products of their members.
double along(const MaterialTangent& gradient, const MaterialTangent& t) {
    std::array<double, n_material_numbers> g{};
    std::size_t i = 0;
    MaterialTangent::each(gradient, [&](double x) { g[i++] = x; });
    double sum = 0;
    i = 0;
    MaterialTangent::each(t, [&](double x) { sum += g[i++] * x; });
    return sum;
}

double along(const Rgb<double>& gradient, const Rgb<double>& rate) {
    return gradient.r * rate.r + gradient.g * rate.g + gradient.b * rate.b;
}

}  // namespace

std::vector<double> GradientSums::by_parameter(const SceneTangents& t) const {
    std::vector<double> sum(t.n());
    const auto add = [&](const auto& effects, auto&& contract) {
        for (const auto& [p, effect] : effects) sum[p] += contract(effect);
    };
    for (std::size_t s = 0; s < shapes.size(); ++s) {
        add(t.shapes[s], [&](const AffineVelocity& v) { return shapes[s].along(v); });
        add(t.shading_normals[s], [&](const AffineVelocity& v) { return normals[s].along(v); });
    }
    for (std::size_t m = 0; m < materials.size(); ++m)
        add(t.materials[m], [&](const MaterialTangent& v) { return derive::along(materials[m], v); });
    for (std::size_t e = 0; e < emitters.size(); ++e) {
        add(t.emitters[e], [&](const AffineVelocity& v) { return emitters[e].along(v); });
        add(t.radiance[e], [&](const Rgb<double>& v) { return derive::along(radiance[e], v); });
    }
    add(t.camera, [&](const AffineVelocity& v) { return camera.along(v); });
    add(t.lens, [&](double v) { return lens * v; });
    return sum;
}

namespace {

/// A part of MaterialTangent that one dual number covers: a channel of a colour changes that channel alone.
struct MaterialPart {
    Rgb<double> MaterialTangent::*colour = nullptr;
    double MaterialTangent::*number = nullptr;
};
constexpr std::array<MaterialPart, 10> material_parts{{
    {&MaterialTangent::diffuse, nullptr},
    {&MaterialTangent::specular, nullptr},
    {&MaterialTangent::transmittance, nullptr},
    {&MaterialTangent::eta_c, nullptr},
    {&MaterialTangent::k_c, nullptr},
    {nullptr, &MaterialTangent::alpha_u},
    {nullptr, &MaterialTangent::alpha_v},
    {nullptr, &MaterialTangent::eta},
    {nullptr, &MaterialTangent::opacity},
    {nullptr, &MaterialTangent::exponent},
}};
using PartMask = std::uint16_t;  // bit: index into material_parts
constexpr PartMask diffuse_part = 1;

/// The parts that a tangent changes.
PartMask parts_of(const MaterialTangent& t) {
    PartMask mask = 0;
    for (std::size_t i = 0; i < material_parts.size(); ++i) {
        const MaterialPart& part = material_parts[i];
        if (part.colour ? !(t.*part.colour == Rgb<double>{}) : t.*part.number != 0) mask |= PartMask(1u << i);
    }
    return mask;
}

PartMask textured_parts(const Material& m) {
    MaterialTangent t;
    const auto colour = [](int texture) { return Rgb<double>(texture >= 0 ? 1 : 0); };
    const auto number = [](int texture) { return texture >= 0 ? 1.0 : 0.0; };
    t.diffuse = colour(m.diffuse_idx), t.specular = colour(m.specular_idx);
    t.transmittance = colour(m.transmittance_idx);
    t.eta_c = colour(m.eta_c_idx), t.k_c = colour(m.k_c_idx);
    t.alpha_u = number(m.alpha_u_idx), t.alpha_v = number(m.alpha_v_idx);
    t.opacity = number(m.opacity_idx), t.exponent = number(m.exponent_idx);
    return parts_of(t);
}

Vec orthogonal(const Vec& v, const Vec& unit) {
    return v - unit * dot(v, unit);
}
Vec axis(int k) {
    Vec v;
    v[k] = 1;
    return v;
}

/// Gradients by the changes of a direction in a frame, of the frame's normal, and of its turn.
struct FrameGradient {
    Vec world, ns;
    double twist = 0;
};

/// Transpose of Walk::local_change().
FrameGradient of_local_change(const Frame<double>& f, const Vec& l, const Vec& d) {
    return {f.to_world(d), f.s * (l.x * d.z - l.z * d.x) + f.t * (l.y * d.z - l.z * d.y), d.x * l.y - d.y * l.x};
}
/// Transpose of the change of a ray along a local direction that turns with its frame, Walk::set_ray(); world: by the
/// change of the local direction.
FrameGradient of_ray(const Frame<double>& f, const Vec& l, const Vec& world) {
    const Vec d = f.to_local(world);
    return {d, f.s * (l.z * d.x - l.x * d.z) + f.t * (l.z * d.y - l.y * d.z), l.x * d.y - l.y * d.x};
}

}  // namespace

struct ReverseWalker::Impl {
    Impl(const PathGraph& graph, const Scene& scene, const SceneTangents& tangents, const WantedParts& w,
         const Adjoint& a)
        : source(graph, scene, tangents),
          g(graph),
          wanted(w),
          adjoint(a),
          lengths(graph, a.timing()),
          whole_length(a.timing().camera_segment),
          inv_n(1 / double(graph.tracing.samples_per_pixel)),
          moves(tangents.geometry()) {
        for (std::size_t s = 0; s < scene.shapes.size(); ++s) turns = turns || !tangents.shading_normals[s].empty();
        for (std::size_t m = 0; m < scene.materials.size(); ++m) {
            PartMask mask = 0;
            for (const auto& [p, t] : tangents.materials[m]) mask |= parts_of(t);
            if (!wanted.image_of.empty() && wanted.image_of[m] >= 0) mask |= 1, source.add_material(m);
            parts.push_back(mask);
            sliding_parts.push_back(moves ? textured_parts(scene.materials[m]) : PartMask(0));
        }
    }

    /// Values of Walk::Start that the transpose needs.
    struct Start {
        Pt p;
        bool by_ray = true;
        Vec w;
        bool scattered = false;
        Rgb<double> factor{1};
        std::array<Rgb<double>, 3> by_wi{};
        Frame<double> frame;
        Rgb<double> beta{1};  // before the factor
    };
    /// Gradients by the changes of a Start.
    struct StartGradient {
        Vec v, dw, ns;
        double twist = 0, dopl = 0;
        Rgb<double> dfactor, dbeta;

        StartGradient& operator+=(const StartGradient& o) {
            v = v + o.v, dw = dw + o.dw, ns = ns + o.ns;
            twist += o.twist, dopl += o.dopl;
            dfactor += o.dfactor, dbeta += o.dbeta;
            return *this;
        }
    };
    /// Gradients by the motion of a surface point.
    struct PointGradient {
        Vec p, ng, ns;
        double twist = 0, area = 0;
    };
    /// Gradients by the changes of an arrival.
    struct HereGradient : PointGradient {
        Vec du;
        double dopl = 0;
        Rgb<double> dbeta;
        MaterialTangent material;  // where `parts` says so
    };
    struct Scattering {
        Rgb<double> value;
        std::array<Rgb<double>, 3> by_wo{}, by_wi{};
    };
    /// A vertex as the forward sweep leaves it.
    struct Node {
        std::size_t j = 0;
        ShadingPoint at;
        Frame<double> frame;
        SurfacePlace place;
        std::uint32_t material_idx = 0;
        PartMask parts = 0;
        Vec u;
        double r = 0, opl = 0;
        Rgb<double> beta;
        Start start;  // of the segment that arrives
        Scattering next;
        bool continues = false;
    };

    Scattering scatter(const ShadingPoint& at, const Vec& wi, double scale) const {
        Scattering s;
        const Vector3f world(wi), local = at.frame.to_local(world);
        const double by = scale * (at.perturbed ? double(bump_shadowing(at, world, local.z)) : 1.0);
        if (!(moves || turns)) {
            s.value = Rgb<double>(f_cos_pdf(at.bsdf, at.wo_local, local).f_cos) * Rgb<double>(by);
            return s;
        }
        const DirectionGradient d = f_cos_gradient(at.bsdf, at.wo_local, local);
        s.value = Rgb<double>(d.f_cos) * Rgb<double>(by);
        for (std::size_t k = 0; k < 3; ++k) {
            s.by_wo[k] = Rgb<double>(d.by_wo[k]) * Rgb<double>(by);
            s.by_wi[k] = Rgb<double>(d.by_wi[k]) * Rgb<double>(by);
        }
        return s;
    }
    Scattering scatter_delta(const ShadingPoint& at, Lobe lobe, double scale) const {
        const DeltaGradient d = delta_value_gradient(at.bsdf, at.wo_local, lobe);
        Scattering s;
        s.value = Rgb<double>(d.value) * Rgb<double>(scale);
        for (std::size_t k = 0; k < 3; ++k) s.by_wo[k] = Rgb<double>(d.by_wo[k]) * Rgb<double>(scale);
        return s;
    }

    Start start_at(const Node& node, const Scattering& s) const {
        Start next;
        next.p = node.place.p;
        next.by_ray = false;
        next.scattered = true;
        next.factor = s.value;
        next.by_wi = s.by_wi;
        next.frame = node.frame;
        next.beta = node.beta;
        return next;
    }

    /// Walks a path from the camera and stores its vertices.
    void sweep_forward(std::size_t path) {
        const auto [begin, end] = vertices_of(g, path);
        n_nodes = end - begin;
        if (nodes.size() < n_nodes) nodes.resize(n_nodes);
        Start a;
        a.p = camera_origin<double>(g, path);
        if (source.scene.nlos) a.by_ray = source.scene.nlos->relay_wall == NlosCapture::no_wall;
        a.w = normalize(position<double>(g, begin) - a.p);
        double opl = 0;
        for (std::size_t i = 0; i < n_nodes; ++i) {
            Node& node = nodes[i];
            const std::size_t j = begin + i;
            node.j = j;
            node.at = source.reader.vertex(j);
            node.frame = in_double(node.at.frame);
            node.place = source.place(j, node.at);
            node.material_idx = g.vertices.material[j];
            const Vec d = node.place.p - a.p;
            node.r = length(d);
            node.u = d / node.r;
            node.beta = a.scattered ? a.beta * a.factor : a.beta;
            opl += i == 0 ? lengths.from_camera(path) : lengths.to_vertex(j, nodes[i - 1].place.p);
            node.opl = opl;
            node.start = a;
            node.parts = parts[node.material_idx];
            if (a.by_ray) node.parts |= sliding_parts[node.material_idx];
            node.continues = i + 1 < n_nodes;
            if (!node.continues) break;

            // Leave the vertex.
            const Lobe lobe = Lobe(g.vertices.lobe[j]);
            const double inv_pdf = 1 / double(g.vertices.pdf_w[j]);
            if (lobe == Lobe::null) {
                node.next = scatter_delta(node.at, lobe, inv_pdf);
                a.beta = a.beta * node.next.value;
                continue;
            }
            if (is_delta(lobe)) {
                node.next = scatter_delta(node.at, lobe, inv_pdf);
                a = start_at(node, node.next);
                a.by_ray = true;
                a.w = normalize(node.frame.to_world(delta_local(node, lobe)));
                continue;
            }
            const Vec wi(continuation_direction(g, j));
            node.next = scatter(node.at, wi, inv_pdf);
            a = start_at(node, node.next);
            a.by_ray = source.reaches_delta(j);
            if (a.by_ray) a.w = normalize(node.frame.to_world(node.frame.to_local(wi)));
        }
    }

    using Dual4 = Dual<4, double>;
    /// Direction of a delta lobe by wo (0 to 2) and the index of refraction (3).
    static Vector3<Dual4> delta_dual(const Node& node, Lobe lobe) {
        Vector3<Dual4> wo;
        for (int k = 0; k < 3; ++k) wo[k] = Dual4::variable(double(node.at.wo_local[k]), k);
        MaterialTangent index;
        index.eta = 1;
        return delta_direction(with_tangent<4, double>(node.at.bsdf, index, 3), wo, lobe);
    }
    static Vec delta_local(const Node& node, Lobe lobe) {
        const Vector3<Dual4> wi = delta_dual(node, lobe);
        return {wi.x.value, wi.y.value, wi.z.value};
    }

    /// Gradient of what scatter() returns by the material, times a gradient by its value.
    template <class Evaluate>
    void add_material(const Node& node, const Rgb<double>& by_value, MaterialTangent& to, Evaluate&& f) const {
        for (std::size_t i = 0; i < material_parts.size(); ++i) {
            if (!(node.parts >> i & 1)) continue;
            const MaterialPart& part = material_parts[i];
            MaterialTangent unit;
            if (part.colour)
                unit.*part.colour = Rgb<double>(1);
            else
                unit.*part.number = 1;
            const Rgb<Dual<1, double>> value = f(with_tangent<1, double>(node.at.bsdf, unit, 0));
            for (int c = 0; c < 3; ++c) {
                const double change = by_value[c] * value[c].d[0];
                if (part.colour)
                    (to.*part.colour)[c] += change;
                else
                    to.*part.number += change;
            }
        }
    }

    /// Adds a gradient by the change of the local outgoing direction.
    static void add_outgoing(const Node& node, const Vec& by_local, HereGradient& here) {
        const FrameGradient f = of_local_change(node.frame, Vec(node.at.wo_local), by_local);
        here.du = here.du - f.world;
        here.ns = here.ns + f.ns;
        here.twist += f.twist;
    }
    static Vec contracted(const std::array<Rgb<double>, 3>& gradient, const Rgb<double>& by) {
        return {along(gradient[0], by), along(gradient[1], by), along(gradient[2], by)};
    }

    void scatter_back(const Node& node, const Scattering& s, const Vec& wi, double scale, const Rgb<double>& by_value,
                      HereGradient& here) const {
        if (moves || turns) add_outgoing(node, contracted(s.by_wo, by_value), here);
        if (!node.parts) return;
        const Vector3f world(wi), local = node.at.frame.to_local(world);
        const double by = scale * (node.at.perturbed ? double(bump_shadowing(node.at, world, local.z)) : 1.0);
        using D = Dual<1, double>;
        add_material(node, by_value * Rgb<double>(by), here.material, [&](const Bsdf<D>& bsdf) {
            return f_cos_pdf(bsdf, Vector3<D>(node.at.wo_local), Vector3<D>(local)).f_cos;
        });
    }
    void scatter_delta_back(const Node& node, const Scattering& s, Lobe lobe, double scale, const Rgb<double>& by_value,
                            HereGradient& here) const {
        if (moves || turns) add_outgoing(node, contracted(s.by_wo, by_value), here);
        using D = Dual<1, double>;
        add_material(node, by_value * Rgb<double>(scale), here.material,
                     [&](const Bsdf<D>& bsdf) { return delta_value(bsdf, Vector3<D>(node.at.wo_local), lobe); });
    }

    void set_ray_back(const Node& node, const Vec& local, const Vec& w, const Vec& by_dw, Vec& by_local,
                      HereGradient& here) const {
        const FrameGradient f = of_ray(node.frame, local, orthogonal(by_dw, w));
        by_local = f.world;
        here.ns = here.ns + f.ns;
        here.twist += f.twist;
    }
    void delta_ray_back(const Node& node, Lobe lobe, const Vec& by_dw, HereGradient& here) const {
        if (by_dw == Vec{}) return;
        const Vector3<Dual4> wi = delta_dual(node, lobe);
        const Vec local{wi.x.value, wi.y.value, wi.z.value};
        Vec by_local, by_wo;
        set_ray_back(node, local, normalize(node.frame.to_world(local)), by_dw, by_local, here);
        for (int k = 0; k < 3; ++k) {
            for (int m = 0; m < 3; ++m) by_wo[m] += by_local[k] * wi[k].d[std::size_t(m)];
            here.material.eta += by_local[k] * wi[k].d[3];
        }
        add_outgoing(node, by_wo, here);
    }

    /// Transpose of the start of a segment at a vertex, its ray and its scattering left out.
    static void start_back(const StartGradient& a, HereGradient& here) {
        here.p = here.p + a.v;
        here.ns = here.ns + a.ns;
        here.twist += a.twist;
        here.dopl += a.dopl;
        here.dbeta += a.dbeta;
    }
    /// Transpose of a null lobe.
    void pass_straight_back(const Node& node, const Scattering& s, double scale, StartGradient& a,
                            HereGradient& here) const {
        scatter_delta_back(node, s, Lobe::null, scale, node.start.beta * a.dbeta, here);
        a.dbeta = a.dbeta * s.value;
    }

    /// Transpose of Walk::apply_factor().
    /// out:     gradient by the change of the segment's direction
    Vec factor_back(const Start& start, const Vec& u, const Rgb<double>& by_dbeta, StartGradient& a) const {
        if (!start.scattered) {
            a.dbeta += by_dbeta;
            return {};
        }
        const Rgb<double> by_dfactor = start.beta * by_dbeta;
        a.dbeta += start.factor * by_dbeta;
        a.dfactor += by_dfactor;
        if (start.by_ray || !(moves || turns)) return {};
        const FrameGradient f =
            of_local_change(start.frame, start.frame.to_local(u), contracted(start.by_wi, by_dfactor));
        a.ns = a.ns + f.ns;
        a.twist += f.twist;
        return f.world;
    }
    /// Transpose of Walk::geometry_change().
    /// out:     gradient by the change of the segment
    static Vec geometry_back(const Vec& u, double r, const Vec& normal, double by, PointGradient& end) {
        const double cosine = dot(normal, u);
        end.ng = end.ng + u * (by / cosine);
        end.area += by;
        return normal * (by / (r * cosine)) - u * (3 * by / r);
    }

    /// Transpose of the slide of a point that a ray reaches: end.p becomes the gradient by its material motion.
    void slide_back(const Vec& u, double r, const SurfacePlace& place, const HereGradient* here,
                    std::uint32_t material_idx, PointGradient& end, StartGradient& a) const {
        Vec by_slide;
        if (source.motions.varies(place.shape_idx)) {
            const bool textured = here && sliding_parts[material_idx];
            for (int k = 0; k < 3; ++k) {
                const auto normals = source.motions.normals_along(place, axis(k));
                by_slide[k] = dot(normals.ng, end.ng) + dot(normals.ns, end.ns);
                if (textured)
                    by_slide[k] += along(here->material, source.motions.texture_along(place, material_idx, axis(k)));
            }
        }
        const Vec by_moved = end.p + by_slide;
        const Vec by_material = place.ng * (dot(u, by_moved) / dot(place.ng, u));
        const Vec by_ray = by_moved - by_material;
        a.v = a.v + by_ray;
        a.dw = a.dw + by_ray * r;
        end.p = by_material - by_slide;
    }

    /// Adds the gradient by the motion of a material point to the sums.
    void add_motion(const SurfacePlace& at, const PointGradient& end, GradientSums& sums) const {
        const std::uint32_t s = at.shape_idx;
        const SceneTangents& t = source.tangents;
        const auto add_twist = [&](AffineGradient& to) {
            if (end.twist == 0) return;
            to.add_vector(cross(at.ns, at.tangent) * end.twist, at.tangent);
        };
        if (t.moves(s)) {
            AffineGradient& to = sums.shapes[s];
            to.add_point(end.p, at.p);
            to.add_normal(end.ng, at.ng);
            to.add_normal(end.ns, at.ns);
            to.add_area(end.area, at.ng);
            add_twist(to);
        }
        if (!wanted.mesh_of.empty() && wanted.mesh_of[s] >= 0) add_vertices(at, end, sums);
        if (!t.shading_normals[s].empty()) {
            AffineGradient& to = sums.normals[s];
            to.add_normal(end.ns, at.ns);
            add_twist(to);
        }
    }
    /// Transpose of SurfaceMotions::add_vertices().
    void add_vertices(const SurfacePlace& at, const PointGradient& end, GradientSums& sums) const {
        const Mesh& mesh = source.scene.shapes[at.shape_idx].mesh;
        const std::uint32_t* i = &mesh.indices[3 * std::size_t(at.primitive_idx)];
        const Pt p0(mesh.positions[i[0]]), p1(mesh.positions[i[1]]), p2(mesh.positions[i[2]]);
        const Vec e1 = p1 - p0, e2 = p2 - p0, twice = cross(e1, e2);
        const double area = length(twice);
        const Vec normal = twice / area;
        const double side = dot(normal, at.ng) < 0 ? -1 : 1;
        const Point2<double> b = source.motions.barycentric_of(at.shape_idx, at.primitive_idx, at.p);
        const Vec by_normal = mesh.normals.empty() ? end.ng + end.ns : end.ng;
        const Vec by_twice = orthogonal(by_normal, normal) * (side / area) + normal * (end.area / area);
        const double weight[3] = {1 - b.x - b.y, b.x, b.y};
        const Vec by_corner[3] = {cross(e1 - e2, by_twice), cross(e2, by_twice), cross(by_twice, e1)};
        const WantedParts::Mesh& to = wanted.meshes[std::size_t(wanted.mesh_of[at.shape_idx])];
        for (int corner = 0; corner < 3; ++corner) {
            const Vec by = end.p * weight[corner] + by_corner[corner];
            sums.vertices.push_back({to.first + to.same[i[corner]], {by.x, by.y, by.z}});
        }
    }

    void add_length(const Column<float>& etas, const Column<std::uint16_t>& media, std::size_t row, double r,
                    const Vec& u, double by_dopl, Vec& by_segment, GradientSums& sums) const {
        by_segment = by_segment + u * (by_dopl * (etas.empty() ? 1.0 : double(etas[row])));
        if (!media.empty() && media[row] != no_medium) sums.materials[media[row]].int_ior += by_dopl * r;
    }

    /// Transpose of the arrival at a vertex.
    void arrive_back(const Node& node, HereGradient& here, StartGradient& a, GradientSums& sums) const {
        const Start& start = node.start;
        a.dopl += here.dopl;
        Vec by_segment;
        // Lengths from the first hit leave out the segment before it, for all vertices behind it.
        const double by_dopl = whole_length || &node != nodes.data() ? here.dopl : here.dopl - a.dopl;
        add_length(g.vertices.eta, g.vertices.medium, node.j, node.r, node.u, by_dopl, by_segment, sums);
        if (moves && !start.by_ray && start.scattered)
            by_segment = by_segment + geometry_back(node.u, node.r, node.place.ng, along(node.beta, here.dbeta), here);
        here.du = here.du + factor_back(start, node.u, here.dbeta, a);
        if (moves) {
            by_segment = by_segment + orthogonal(here.du, node.u) / node.r;
            here.p = here.p + by_segment;
            a.v = a.v - by_segment;
            if (start.by_ray) slide_back(node.u, node.r, node.place, &here, node.material_idx, here, a);
        }
        if (moves || turns) add_motion(node.place, here, sums);
        if (source.material_matters[node.material_idx]) {
            sums.materials[node.material_idx] += here.material;
            if (!wanted.image_of.empty() && wanted.image_of[node.material_idx] >= 0)
                add_texels(node, here.material.diffuse, sums);
        }
    }
    void add_texels(const Node& node, const Rgb<double>& by_diffuse, GradientSums& sums) const {
        const Material& m = source.scene.materials[node.material_idx];
        const WantedParts::Image& to = wanted.images[std::size_t(wanted.image_of[node.material_idx])];
        const Texture::Texels texels =
            source.scene.textures[std::size_t(m.diffuse_idx)].texels(source.motions.uv_of(node.place));
        for (std::size_t i = 0; i < texels.weight.size(); ++i) {
            const double by = double(texels.weight[i]) * double(m.reflectance_scale);
            if (by != 0)
                sums.texels.push_back(
                    {to.first + texels.pixel[i], {by * by_diffuse.r, by * by_diffuse.g, by * by_diffuse.b}});
        }
    }

    /// Transpose of the directly visible emitter at the first hit.
    bool see_back(std::size_t path, const Node& node, HereGradient& here, GradientSums& sums) const {
        const Rgb<double> Le(rgb(g.paths.Le, path));
        const Shape& shape = source.scene.shapes[node.place.shape_idx];
        const bool black = Le == Rgb<double>{};
        if (black && shape.emitter_idx < 0) return false;
        LightWeight a;
        if (!adjoint.at(path % g.n_pixels(), node.opl, a)) return false;
        const Rgb<double> by_dLe = a.value * Rgb<double>(inv_n);
        sums.loss += along(Le, by_dLe);
        here.dopl += along(Le, a.slope) * inv_n;
        if (shape.emitter_idx < 0) return true;
        const auto e = std::size_t(shape.emitter_idx);
        const Emitter& emitter = source.scene.emitters[e];
        const bool lit = dot(Vec(node.at.wo), node.place.ng) > 0 &&
                         !(source.scene.hides_emitters && emitter.kind == EmitterKind::area);
        if (!lit) return true;
        add_emission(e, Le, Rgb<double>(1), by_dLe, sums);
        if (moves && emitter.texture_idx >= 0) {
            Vec by_slide;
            for (int k = 0; k < 3; ++k) by_slide[k] = along(source.motions.emission_along(node.place, axis(k)), by_dLe);
            here.p = here.p + by_slide;
            PointGradient material;
            material.p = -by_slide;
            add_motion(node.place, material, sums);
        }
        return true;
    }

    void add_emission(std::size_t emitter, const Rgb<double>& Li, const Rgb<double>& unit, const Rgb<double>& by,
                      GradientSums& sums) const {
        if (source.tangents.radiance[emitter].empty()) return;
        const Emitter& e = source.scene.emitters[emitter];
        const bool relative = e.kind == EmitterKind::envmap || e.texture_idx >= 0;
        for (int c = 0; c < 3; ++c) {
            const double now = relative ? 1.0 : double(e.radiance[c]);
            sums.radiance[emitter][c] += by[c] * (now != 0 ? Li[c] / now : unit[c]);
        }
    }

    /// Transpose of light edge k of a vertex.
    /// in:      arriving  gradient by the segment that arrives at the vertex, for light behind a null lobe
    /// out:     whether it contributes
    bool light_back(std::size_t k, std::size_t pixel, const Node& node, HereGradient& here, StartGradient& arriving,
                    GradientSums& sums) const {
        const auto& e = g.light_edges;
        const float* y = e.y.data() + 4 * k;
        if (y[3] == 0) return false;
        LightWeight weight_of_light;
        if (!adjoint.at(pixel, node.opl + lengths.to_light(k, node.place.p), weight_of_light)) return false;

        const std::size_t emitter = e.emitter[k];
        const Lobe lobe = Lobe(g.vertices.lobe[node.j]);
        const bool next_event = LightTechnique(e.technique[k]) == LightTechnique::next_event;
        const bool by_delta = !next_event && is_delta(lobe);
        const double weight = double(mis_weight(next_event, e.pdf_nee_w[k], e.pdf_bsdf_w[k], Heuristic::power)) /
                              double(next_event ? e.pdf_nee_w[k] : g.vertices.pdf_w[node.j]);
        const Rgb<double> Li(rgb(e.Li, k));
        const Pt light{y[0], y[1], y[2]};
        const Vec wi = normalize(light - node.place.p);
        const Scattering s = by_delta ? scatter_delta(node.at, lobe, weight) : scatter(node.at, wi, weight);
        const bool straight = by_delta && lobe == Lobe::null;
        Start start;
        if (straight) {
            start = node.start;
            start.beta = start.beta * s.value;
        } else {
            start = start_at(node, s);
            start.by_ray = by_delta;
        }
        const Rgb<double> beta = start.scattered ? start.beta * start.factor : start.beta;

        // Start from the light.
        const Rgb<double> by_dL = weight_of_light.value * Rgb<double>(inv_n), L = beta * Li;
        const Rgb<double> by_dbeta = Li * by_dL, by_dLi = beta * by_dL;
        sums.loss += along(L, by_dL);
        add_emission(emitter, Li, source.unit_emission(emitter, node.place.p), by_dLi, sums);
        StartGradient a;
        a.dopl = along(L, weight_of_light.slope) * inv_n;
        Vec by_du = factor_back(start, wi, by_dbeta, a);

        // Move the ends of the segment.
        const Vec d = light - start.p;
        const double r = length(d);
        const Vec u = d / r;
        const bool of_area = source.scene.emitters[emitter].kind == EmitterKind::area;
        Vec by_segment;
        add_length(e.eta, e.medium, k, r, u, a.dopl, by_segment, sums);
        if (moves) {
            SurfacePlace place = source.place_of_light(emitter, light, source.normal_of_light(k));
            PointGradient end;
            if (of_area && !start.by_ray)
                by_segment = by_segment + geometry_back(u, r, place.ng, along(beta, by_dbeta), end);
            by_segment = by_segment + orthogonal(by_du, u) / r;
            end.p = by_segment;
            a.v = a.v - by_segment;
            if (of_area) {
                if (start.by_ray) slide_back(u, r, place, nullptr, 0, end, a);
                add_motion(place, end, sums);
            } else {
                if (!source.tangents.emitters[emitter].empty()) sums.emitters[emitter].add_point(end.p, light);
                delta_light_back(k, emitter, node, by_dLi, here, sums);
            }
        } else if (!of_area) {
            delta_light_back(k, emitter, node, by_dLi, here, sums);
        }

        // Leave the vertex towards the light.
        if (straight) {
            pass_straight_back(node, s, weight, a, here);
            arriving += a;
            return true;
        }
        start_back(a, here);
        if (by_delta) {
            delta_ray_back(node, lobe, a.dw, here);
            scatter_delta_back(node, s, lobe, weight, a.dfactor, here);
        } else {
            scatter_back(node, s, wi, weight, a.dfactor, here);
        }
        return true;
    }

    void delta_light_back(std::size_t k, std::size_t emitter, const Node& node, const Rgb<double>& by_dLi,
                          HereGradient& here, GradientSums& sums) const {
        if (source.scene.nlos && source.scene.nlos->laser_sampling) {
            laser_spot_back(k, node, by_dLi, here, sums);
            return;
        }
        if (!moves) return;
        using D = Dual<3, double>;
        const Emitter& e = source.scene.emitters[emitter];
        const EmitterPose<D> pose(e);
        Point3<D> from;
        for (int i = 0; i < 3; ++i) from[i] = D::variable(node.place.p[i], i);
        const LightSampleOf<D> light = delta_light(source.scene, e, pose, from);
        Vec by_relative;
        for (int i = 0; i < 3; ++i)
            for (int c = 0; c < 3; ++c) by_relative[i] += by_dLi[c] * light.Li[c].d[std::size_t(i)];
        here.p = here.p + by_relative;
        if (!source.tangents.emitters[emitter].empty()) sums.emitters[emitter].add_point(-by_relative, node.place.p);
    }
    void laser_spot_back(std::size_t k, const Node& node, const Rgb<double>& by_dLi, HereGradient& here,
                         GradientSums& sums) const {
        const auto& e = g.light_edges;
        const Pt spot{e.y[4 * k], e.y[4 * k + 1], e.y[4 * k + 2]};
        const Normal3f normal = unit_vector<Normal3f>(e.n, k);
        const Vec n_spot(normal), d = node.place.p - spot;
        const double r = length(d);
        const Vec u = d / r;
        const auto& first = g.paths.first_vertex;
        const std::size_t path =
            std::size_t(std::upper_bound(first.begin(), first.end(), std::uint64_t(e.vertex[k])) - first.begin()) - 1;
        const std::uint32_t material = source.lit_material(path);
        Node lit;
        lit.at.frame = Framef(normal);
        lit.at.bsdf = Bsdf<float>(source.scene.materials[material].model);
        lit.at.wo_local = lit.at.frame.to_local(Vector3f(u));
        lit.parts = parts[material];
        const Vector3f to_laser =
            lit.at.frame.to_local(Vector3f(normalize(Pt(source.scene.emitters[0].position) - spot)));
        const DirectionGradient f = f_cos_gradient(lit.at.bsdf, lit.at.wo_local, to_laser);
        const Rgb<double> Li(rgb(e.Li, k));
        Rgb<double> by_f;
        for (int c = 0; c < 3; ++c)
            if (f.f_cos[c] > 0) by_f[c] = by_dLi[c] * Li[c] / double(f.f_cos[c]);
        if (moves) {
            const double by_relative = along(by_dLi, Li), cosine = dot(n_spot, u);
            Vec by_turn;
            for (int i = 0; i < 3; ++i) by_turn[i] = along(Rgb<double>(f.by_wo[std::size_t(i)]), by_f);
            here.p = here.p + n_spot * (by_relative / (r * cosine)) - u * (3 * by_relative / r) +
                     orthogonal(in_double(lit.at.frame).to_world(by_turn), u) / r;
        }
        using D = Dual<1, double>;
        add_material(lit, by_f, sums.materials[material], [&](const Bsdf<D>& bsdf) {
            return f_cos_pdf(bsdf, Vector3<D>(lit.at.wo_local), Vector3<D>(to_laser)).f_cos;
        });
    }

    void camera_back(const StartGradient& a, GradientSums& sums) const {
        const SceneTangents& t = source.tangents;
        if (!t.camera_moves()) return;
        const Start& start = nodes[0].start;
        const Vec by_turn = orthogonal(a.dw, start.w);
        sums.camera.add_point(a.v, start.p);
        sums.camera.add_vector(by_turn, start.w);
        const auto& m = source.scene.sensor.world_from_camera;
        const Vec optical = normalize(Vec{m[2], m[6], m[10]});
        sums.lens += dot(by_turn, orthogonal(start.w, optical));
    }

    bool walk(std::size_t path, std::size_t& edge, GradientSums& sums) {
        const auto [begin, end] = vertices_of(g, path);
        const auto& edges = g.light_edges.vertex;
        std::size_t end_edge = edge;
        while (end_edge < edges.size() && edges[end_edge] < end) ++end_edge;
        const std::size_t first_edge = edge;
        edge = end_edge;
        if (begin == end) return false;
        const std::size_t pixel = path % g.n_pixels();
        if (!source.touches(path)) {
            std::size_t next = first_edge;
            walk_in_time(source.reader, lengths, path, next, [&](const Spectrum& L, double opl) {
                LightWeight weight;
                if (adjoint.at(pixel, opl, weight)) sums.loss += along(Rgb<double>(L), weight.value) * inv_n;
            });
            return false;
        }
        sweep_forward(path);

        StartGradient a;  // of the segment that leaves the vertex
        bool live = false;
        for (std::size_t i = n_nodes; i-- > 0;) {
            const Node& node = nodes[i];
            HereGradient here;
            if (live && node.continues) leave_back(node, a, here);
            for (std::size_t k = end_edge; k > first_edge && edges[k - 1] == node.j; --k, end_edge = k)
                live |= light_back(k - 1, pixel, node, here, a, sums);
            if (i == 0) live |= see_back(path, node, here, sums);
            if (live) arrive_back(node, here, a, sums);
        }
        if (live) camera_back(a, sums);
        return true;
    }

    /// Transpose of Walk::leave(); `a` becomes the gradient by the segment that arrives.
    void leave_back(const Node& node, StartGradient& a, HereGradient& here) const {
        const Lobe lobe = Lobe(g.vertices.lobe[node.j]);
        const double inv_pdf = 1 / double(g.vertices.pdf_w[node.j]);
        if (lobe == Lobe::null) {
            pass_straight_back(node, node.next, inv_pdf, a, here);
            return;
        }
        start_back(a, here);
        if (is_delta(lobe)) {
            delta_ray_back(node, lobe, a.dw, here);
            scatter_delta_back(node, node.next, lobe, inv_pdf, a.dfactor, here);
        } else {
            const Vec wi(continuation_direction(g, node.j));
            if (source.reaches_delta(node.j)) {
                const Vec local = node.frame.to_local(wi);
                Vec unused;
                set_ray_back(node, local, normalize(node.frame.to_world(local)), a.dw, unused, here);
            }
            scatter_back(node, node.next, wi, inv_pdf, a.dfactor, here);
        }
        a = {};
    }

    PathSource source;
    const PathGraph& g;
    const WantedParts& wanted;
    const Adjoint& adjoint;
    OpticalLengths lengths;
    bool whole_length;
    double inv_n;
    bool moves, turns = false;
    std::vector<PartMask> parts, sliding_parts;  // [material]
    std::vector<Node> nodes;
    std::size_t n_nodes = 0;
};

ReverseWalker::ReverseWalker(const PathGraph& graph, const Scene& scene, const SceneTangents& tangents,
                             const WantedParts& wanted, const Adjoint& adjoint)
    : impl_(std::make_unique<Impl>(graph, scene, tangents, wanted, adjoint)) {}
ReverseWalker::~ReverseWalker() = default;
ReverseWalker::ReverseWalker(ReverseWalker&&) noexcept = default;

bool ReverseWalker::walk(std::size_t path, std::size_t& edge, GradientSums& sums) {
    return impl_->walk(path, edge, sums);
}

std::uint64_t sweep_paths(const PathGraph& graph, const Scene& scene, const SceneTangents& tangents,
                          const WantedParts& wanted, const Adjoint& adjoint, int threads, app::Report& report,
                          GradientSums& sums, std::vector<double>& by_vertex, std::vector<double>& by_texel) {
    // A chunk is a run of pixels, whose weights fit into a cache, for some of their samples.
    const std::uint64_t n_pixels = graph.n_pixels(), n_samples = graph.tracing.samples_per_pixel;
    const std::uint64_t run = std::clamp<std::uint64_t>((256 << 10) / adjoint.bytes_per_pixel(), 1, 256);
    const std::uint64_t depth = std::clamp<std::uint64_t>(4096 / run, 1, n_samples);
    const std::uint64_t n_runs = (n_pixels + run - 1) / run, n_depths = (n_samples + depth - 1) / depth;
    const std::uint64_t n_chunks = n_runs * n_depths;
    constexpr std::uint64_t n_in_flight = 64;

    by_vertex.assign(3 * wanted.n_vertices, 0);
    by_texel.assign(3 * wanted.n_texels, 0);
    app::Progress progress(report, "interior", graph.n_paths());
    tbb::enumerable_thread_specific<ReverseWalker> walkers(
        [&] { return ReverseWalker(graph, scene, tangents, wanted, adjoint); });
    std::vector<GradientSums> parts(std::min(n_in_flight, n_chunks));
    std::vector<std::uint64_t> touched(parts.size());
    std::uint64_t n_touched = 0;
    for (std::uint64_t first = 0; first < n_chunks; first += parts.size()) {
        const std::uint64_t n = std::min<std::uint64_t>(parts.size(), n_chunks - first);
        parallel_chunks(n, 1, threads, [&](std::uint64_t i, std::uint64_t, std::uint64_t) {
            ReverseWalker& walker = walkers.local();
            parts[i] = GradientSums(scene);
            touched[i] = 0;
            const std::uint64_t chunk = first + i, pixel = chunk / n_depths * run;
            const std::uint64_t n_run = std::min(run, n_pixels - pixel);
            const std::uint64_t sample = chunk % n_depths * depth, end = std::min(sample + depth, n_samples);
            for (std::uint64_t s = sample; s < end; ++s) {
                const std::size_t path = s * n_pixels + pixel;
                std::size_t edge = first_light_edge(graph, graph.paths.first_vertex[path]);
                for (std::size_t k = 0; k < n_run; ++k) touched[i] += walker.walk(path + k, edge, parts[i]);
            }
            progress.add(n_run * (end - sample));
        });
        // Join in the order of chunks, so that sums are independent of the threads.
        for (std::uint64_t i = 0; i < n; ++i) {
            sums.add_dense(parts[i]);
            for (const auto& [row, by] : parts[i].vertices)
                for (std::size_t c = 0; c < 3; ++c) by_vertex[3 * row + c] += by[c];
            for (const auto& [row, by] : parts[i].texels)
                for (std::size_t c = 0; c < 3; ++c) by_texel[3 * row + c] += by[c];
            n_touched += touched[i];
            parts[i] = {};
        }
    }
    return n_touched;
}

Gradient gradient_of(const SceneTangents& tangents, const WantedParts& wanted, const GradientSums& sums,
                     std::vector<double> by_vertex, std::vector<double> by_texel) {
    Gradient g;
    g.loss = sums.loss;
    describe_parameters(tangents, g.parameters);
    g.parameters.gradient = sums.by_parameter(tangents);
    const auto append = [](std::vector<double>& to, const AffineGradient& a, bool offset) {
        to.insert(to.end(), a.linear.begin(), a.linear.end());
        if (offset) to.insert(to.end(), {a.offset.x, a.offset.y, a.offset.z});
    };
    std::vector<double> wrench, normals, numbers, emitters, radiance, camera;
    for (const AffineGradient& a : sums.shapes) append(wrench, a, true);
    for (const AffineGradient& a : sums.normals) append(normals, a, false);
    for (const MaterialTangent& m : sums.materials) MaterialTangent::each(m, [&](double x) { numbers.push_back(x); });
    for (const AffineGradient& a : sums.emitters) append(emitters, a, true);
    for (const Rgb<double>& c : sums.radiance) radiance.insert(radiance.end(), {c.r, c.g, c.b});
    append(camera, sums.camera, true);
    g.shapes.wrench = std::move(wrench);
    g.shapes.normals = std::move(normals);
    g.materials.numbers = std::move(numbers);
    g.emitters.wrench = std::move(emitters);
    g.emitters.radiance = std::move(radiance);
    std::copy(camera.begin(), camera.end(), g.camera.wrench.begin());
    g.camera.lens = sums.lens;

    std::vector<std::uint64_t> first;
    for (const WantedParts::Mesh& mesh : wanted.meshes) {
        g.vertices.name.push_back(mesh.name);
        first.push_back(mesh.first);
        // Copies of a position hold what the first of them has gathered.
        for (std::size_t i = 0; i < mesh.same.size(); ++i)
            for (std::size_t c = 0; c < 3; ++c)
                by_vertex[3 * (mesh.first + i) + c] = by_vertex[3 * (mesh.first + mesh.same[i]) + c];
    }
    if (!first.empty()) {
        first.push_back(wanted.n_vertices);
        g.vertices.first = std::move(first);
        g.vertices.gradient = std::move(by_vertex);
    }
    std::vector<std::uint64_t> first_texel;
    std::vector<std::uint32_t> width, height;
    for (const WantedParts::Image& image : wanted.images) {
        g.texels.name.push_back(image.name);
        first_texel.push_back(image.first);
        width.push_back(image.width);
        height.push_back(image.height);
    }
    if (!first_texel.empty()) {
        first_texel.push_back(wanted.n_texels);
        g.texels.first = std::move(first_texel);
        g.texels.width = std::move(width);
        g.texels.height = std::move(height);
        g.texels.gradient = std::move(by_texel);
    }
    return g;
}

}  // namespace loom::derive
