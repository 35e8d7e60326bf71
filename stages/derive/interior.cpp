#include "stages/derive/interior.h"

#include <fmt/format.h>

#include <array>
#include <cmath>

#include "stages/core/graph/own_samples.h"
#include "stages/core/scattering/gradient.h"
#include "stages/core/scene/delta_light.h"
#include "stages/core/scene/nlos.h"
#include "stages/derive/path_source.h"

namespace loom::derive {
namespace {

using Vec = Vector3<double>;
using Pt = Point3<double>;

/// A colour per parameter.
template <int n>
struct ColourTangent {
    std::array<Tangent<n>, 3> c{};

    ColourTangent& operator+=(const ColourTangent& o) {
        for (int i = 0; i < 3; ++i) c[i] += o.c[i];
        return *this;
    }
    void scale(const Rgb<double>& by) {
        for (int i = 0; i < 3; ++i)
            for (double& x : c[i].d) x *= by[i];
    }
    ColourTangent& add(const Rgb<double>& by, const Tangent<n>& t) {
        for (int i = 0; i < 3; ++i) c[i].add(by[i], t);
        return *this;
    }
    /// Adds by[channel] o[channel].
    ColourTangent& add(const Rgb<double>& by, const ColourTangent& o) {
        for (int i = 0; i < 3; ++i) c[i].add(by[i], o.c[i]);
        return *this;
    }
    bool is_zero() const { return c[0].is_zero() && c[1].is_zero() && c[2].is_zero(); }
};

/// One walk along a path with n parameters.
template <int n>
class Walk {
  public:
    explicit Walk(const PathSource& source) : s_(source), g_(source.graph) {}

    using Numbers = Tangent<n>;
    using Vectors = VectorTangent<n>;
    using Colours = ColourTangent<n>;

    /// on_edge(k, L, dL, dopl), on_seen(path, Le, dLe, dopl), on_vertex(j, at, beta, opl, motion)
    template <class OnEdge, class OnSeen, class OnVertex>
    void path(std::size_t path, std::size_t& edge, OnEdge&& on_edge, OnSeen&& on_seen, OnVertex&& on_vertex) {
        const auto [begin, end] = vertices_of(g_, path);
        path_ = path;
        start_at_camera(path, begin, end);
        if (begin == end) {
            see_environment(path, on_seen);
            return;
        }
        const auto& edges = g_.light_edges.vertex;
        for (std::size_t j = begin; j < end; ++j) {
            const ShadingPoint at = s_.reader.vertex(j);
            Arrival here = arrive(j, at);
            if (j == begin) see(path, at, here, on_seen);
            on_vertex(j, at, here.beta, here.opl, here.motion);
            for (; edge < edges.size() && edges[edge] == j; ++edge) light(j, edge, at, here, on_edge);
            if (j + 1 < end) leave(j, at, here);
        }
    }

  private:
    /// Where a segment starts, and the factor of the scattering there, whose direction may still change with the end.
    struct Start {
        Pt p;
        Vectors v;
        bool by_ray = true;  // the ray's direction determines the end of the segment
        Vec w;               // unit direction of the ray
        Vectors dw;
        bool scattered = false;
        Rgb<double> factor{1};               // f cos / pdf
        Colours dfactor;                     // without the change of the outgoing segment's direction
        std::array<Rgb<double>, 3> by_wi{};  // gradient of the factor by the local direction
        Frame<double> frame;
        Vec wi_local;
        Vectors ns;
        Numbers twist;
        Vectors turn;         // angular velocity of the frame
        Rgb<double> beta{1};  // before the factor
        Colours dbeta;
        double opl = 0;
        Numbers dopl;
    };
    /// State at the end of a segment.
    struct Arrival {
        SurfacePlace place;
        PointMotion<n> motion;
        Vec u;               // unit, along the segment
        Vectors du;          // change of u
        Vectors wo;          // change of wo in the frame
        bool rests = false;  // nothing up to here depends on a parameter
        Rgb<double> beta;
        Colours dbeta;
        double opl = 0;
        Numbers dopl;
        std::uint32_t material_idx = 0;
        // The material's tangents at this point, textures under a sliding point included; by parameter.
        Effects<MaterialTangent> material;
    };

    void start_at_camera(std::size_t path, std::size_t begin, std::size_t end) {
        Start& a = a_;
        a = Start{};
        a.p = camera_origin<double>(g_, path);
        if (s_.scene.nlos) a.by_ray = s_.scene.nlos->relay_wall == NlosCapture::no_wall;
        if (begin < end)
            a.w = normalize(position<double>(g_, begin) - a.p);
        else
            a.w = {0, 0, 1};
        for (const auto& [p, v] : s_.tangents.camera) {
            const int k = int(p);
            a.v.add(k, v.at(a.p));
            const Vec turned = v.turned(a.w);
            a.dw.add(k, turned - a.w * loom::dot(a.w, turned));
        }
        if (!s_.tangents.lens.empty()) {
            const auto& m = s_.scene.sensor.world_from_camera;
            const Vec axis = normalize(Vec{m[2], m[6], m[10]});
            // A wider field of view scales what is perpendicular to the axis.
            const double along = loom::dot(a.w, axis);
            const Vec across = a.w - axis * along;
            for (const auto& [p, relative] : s_.tangents.lens) {
                const Vec change = across * relative;
                a.dw.add(int(p), change - a.w * loom::dot(a.w, change));
            }
        }
    }

    /// Moves a point along its surface towards the one that the ray reaches.
    /// in:      motion  of the material point
    /// out:     motion  of the sliding point: normals and the growth of its area included
    void slide(const Start& a, const Vec& d, double r, const SurfacePlace& place, PointMotion<n>& motion,
               Arrival* arrival) const {
        const double share = a.by_ray ? 1 : s_.attached.share(r);
        if (share == 0) return;
        const bool varies = s_.motions.varies(place.shape_idx);
        const Vec u = d / r;
        const double cosine = loom::dot(place.ng, u);
        for (int p = 0; p < n; ++p) {
            const Vec ray = a.by_ray ? a.v(p) + a.dw(p) * r : a.v(p) + cross(a.turn(p), d), material = motion.p(p);
            if (ray == material) continue;
            const Vec slip = ray + u * (loom::dot(place.ng, material - ray) / cosine) - material;
            const Vec along = slip * share;
            motion.p.add(p, along);
            if (!a.by_ray)
                motion.area.d[p] +=
                    share * s_.motions.slip_growth(place, std::uint32_t(p), d, material - ray, a.turn(p)) +
                    s_.attached.slope(r) * loom::dot(u, slip);
            if (!varies || along == Vec{}) continue;
            const auto normals = s_.motions.normals_along(place, along);
            motion.ng.add(p, normals.ng);
            motion.ns.add(p, normals.ns);
            if (arrival) {
                const MaterialTangent t = s_.motions.texture_along(place, arrival->material_idx, along);
                if (!t.is_zero()) add_material(arrival->material, std::uint32_t(p), t);
            }
        }
    }
    static void add_material(Effects<MaterialTangent>& effects, std::uint32_t p, const MaterialTangent& t) {
        for (auto& [q, known] : effects)
            if (q == p) {
                known += t;
                return;
            }
        effects.push_back({p, t});
    }

    /// Change of a local direction at a vertex from that of the world direction and of the frame.
    static Vectors local_change(const Frame<double>& frame, const Vec& local, const Vectors& world, const Vectors& ns,
                                const Numbers& twist) {
        Vectors d;
        for (int p = 0; p < n; ++p) {
            const Vec w = frame.to_local(world(p)), m = ns(p);
            const double s = loom::dot(m, frame.s), t = loom::dot(m, frame.t);
            d.add(p, {w.x + twist.d[p] * local.y - local.z * s, w.y - twist.d[p] * local.x - local.z * t,
                      w.z + s * local.x + t * local.y});
        }
        return d;
    }

    /// d log(cos / r^2) of a segment's end, the growth of its area included.
    static Numbers geometry_change(const Vec& u, double r, const Vectors& ddot, const Vec& normal,
                                   const Vectors& dnormal, const Numbers& area) {
        Numbers sum;
        const double cosine = loom::dot(normal, u);
        for (int p = 0; p < n; ++p) {
            const Vec d = ddot(p);
            sum.d[p] =
                (loom::dot(dnormal(p), u) + loom::dot(normal, d) / r) / cosine - 3 * loom::dot(u, d) / r + area.d[p];
        }
        return sum;
    }

    /// Change of the unit direction u of a segment of length r whose ends move apart by ddot.
    static Vectors direction_change(const Vec& u, double r, const Vectors& ddot) {
        Vectors du;
        for (int p = 0; p < n; ++p) {
            const Vec d = ddot(p);
            du.add(p, (d - u * loom::dot(u, d)) / r);
        }
        return du;
    }

    /// The factor of a start towards a changing direction, as value and change.
    void apply_factor(const Start& a, const Vectors& du, const Vec& u, Rgb<double>& beta, Colours& dbeta) const {
        beta = a.beta;
        dbeta = a.dbeta;
        if (!a.scattered) return;
        Colours dfactor = a.dfactor;
        if (!a.by_ray) {
            const Vectors local = local_change(a.frame, a.frame.to_local(u), du, a.ns, a.twist);
            for (int k = 0; k < 3; ++k) dfactor.add(a.by_wi[std::size_t(k)], local[k]);
        }
        dbeta.scale(a.factor);
        dbeta.add(a.beta, dfactor);
        beta = a.beta * a.factor;
    }

    Arrival arrive(std::size_t j, const ShadingPoint& at) const {
        const Start& a = a_;
        Arrival b;
        b.place = s_.place(j, at);
        b.material_idx = g_.vertices.material[j];
        const Vec d = b.place.p - a.p;
        const double r = length(d);
        b.u = d / r;
        s_.motions.add_material(b.place, b.motion);
        for (const auto& [p, t] : s_.tangents.materials[b.material_idx]) b.material.push_back({p, t});
        if (a.by_ray || a.scattered) slide(a, d, r, b.place, b.motion, &b);
        Vectors ddot = b.motion.p;
        ddot.add(-1, a.v);
        b.du = direction_change(b.u, r, ddot);
        apply_factor(a, b.du, b.u, b.beta, b.dbeta);
        if (!a.by_ray && a.scattered)
            b.dbeta.add(b.beta, geometry_change(b.u, r, ddot, b.place.ng, b.motion.ng, b.motion.area));
        add_length(a, g_.vertices.eta, g_.vertices.medium, j, r, b.u, ddot, b.opl, b.dopl);
        Vectors back;
        back.add(-1, b.du);
        b.wo = local_change(in_double(at.frame), Vec(at.wo_local), back, b.motion.ns, b.motion.twist);
        b.rests = b.material.empty() && b.dbeta.is_zero() && b.dopl.is_zero() && b.motion.p.is_zero() &&
                  b.motion.ns.is_zero() && b.motion.twist.is_zero() && b.wo.is_zero();
        return b;
    }

    /// Length of a segment in its medium, after that up to its start.
    void add_length(const Start& a, const Column<float>& etas, const Column<std::uint16_t>& media, std::size_t row,
                    double r, const Vec& u, const Vectors& ddot, double& opl, Numbers& dopl) const {
        const double eta = etas.empty() ? 1.0 : double(etas[row]);
        opl = a.opl + eta * r;
        dopl = a.dopl;
        dopl.add(eta, loom::derive::dot(u, ddot));
        if (media.empty() || media[row] == no_medium) return;
        for (const auto& [p, t] : s_.tangents.materials[media[row]]) dopl.d[p] += t.int_ior * r;
    }

    /// The directly visible emitter at the first hit.
    template <class OnSeen>
    void see(std::size_t path, const ShadingPoint& at, const Arrival& here, OnSeen&& on_seen) const {
        Colours dLe;
        const Shape& shape = s_.scene.shapes[here.place.shape_idx];
        const Spectrum Le = rgb(g_.paths.Le, path);
        if (shape.emitter_idx >= 0) {
            const auto e = std::size_t(shape.emitter_idx);
            // Emission exists on the front alone.
            const bool lit = loom::dot(Vec(at.wo), here.place.ng) > 0 &&
                             !(s_.scene.hides_emitters && s_.scene.emitters[e].kind == EmitterKind::area);
            if (lit) add_emission(e, Rgb<double>(Le), Rgb<double>(1), dLe);
            if (lit && s_.scene.emitters[e].texture_idx >= 0)
                for (int p = 0; p < n; ++p) {
                    PointMotion<n> material;
                    s_.motions.add_material(here.place, material);
                    const Rgb<double> rate = s_.motions.emission_along(here.place, here.motion.p(p) - material.p(p));
                    for (int c = 0; c < 3; ++c) dLe.c[std::size_t(c)].d[p] += rate[c];
                }
        }
        if (!dLe.is_zero() || !here.dopl.is_zero()) on_seen(path, Rgb<double>(Le), dLe, here.dopl);
    }

    template <class OnSeen>
    void see_environment(std::size_t path, OnSeen&& on_seen) const {
        if (s_.scene.environment_idx < 0) return;
        Colours dLe;
        const auto e = std::size_t(s_.scene.environment_idx);
        add_emission(e, Rgb<double>(rgb(g_.paths.Le, path)), Rgb<double>(1), dLe);
        if (!dLe.is_zero()) on_seen(path, Rgb<double>(rgb(g_.paths.Le, path)), dLe, Numbers{});
    }

    /// Adds the change of a stored radiance Li with that of its emitter's.
    /// in:      unit  Li of a radiance of 1, where the emitter's is 0
    void add_emission(std::size_t emitter, const Rgb<double>& Li, const Rgb<double>& unit, Colours& dLi) const {
        const Emitter& e = s_.scene.emitters[emitter];
        for (const auto& [p, rate] : s_.tangents.radiance[emitter])
            for (int c = 0; c < 3; ++c) {
                const bool relative = e.kind == EmitterKind::envmap || e.texture_idx >= 0;
                const double now = relative ? 1.0 : double(e.radiance[c]);
                dLi.c[std::size_t(c)].d[p] += rate[c] * (now != 0 ? Li[c] / now : unit[c]);
            }
    }

    /// f cos of a vertex towards a world direction, or its delta lobe, with its changes; times `scale`.
    struct Scattering {
        Rgb<double> value;
        Colours change;                      // by wo, frame for wo, and material
        std::array<Rgb<double>, 3> by_wi{};  // by the local direction
    };
    Scattering scatter(const ShadingPoint& at, const Arrival& here, const Vec& wi, double scale) const {
        Scattering s;
        const Vector3f wi_local = at.frame.to_local(Vector3f(wi));
        const DirectionGradient g = f_cos_gradient(at.bsdf, at.wo_local, wi_local);
        const Rgb<double> shadow(at.perturbed ? double(bump_shadowing(at, Vector3f(wi), wi_local.z)) : 1.0);
        const Rgb<double> by(scale);
        s.value = Rgb<double>(g.f_cos) * by * shadow;
        for (int k = 0; k < 3; ++k) {
            const auto i = std::size_t(k);
            s.change.add(Rgb<double>(g.by_wo[i]) * by * shadow, here.wo[k]);
            s.by_wi[i] = Rgb<double>(g.by_wi[i]) * by * shadow;
        }
        for (const auto& [p, t] : here.material) {
            if (!t.scatters()) continue;
            using D = Dual<1, double>;
            const Bsdf<D> bsdf = with_tangent<1, double>(at.bsdf, t, 0);
            const Rgb<D> f = f_cos_pdf(bsdf, Vector3<D>(at.wo_local), Vector3<D>(wi_local)).f_cos;
            for (int c = 0; c < 3; ++c) s.change.c[std::size_t(c)].d[p] += f[c].d[0] * scale * shadow[c];
        }
        return s;
    }
    Scattering scatter_delta(const ShadingPoint& at, const Arrival& here, Lobe lobe, double scale) const {
        Scattering s;
        const DeltaGradient g = delta_value_gradient(at.bsdf, at.wo_local, lobe);
        s.value = Rgb<double>(g.value) * Rgb<double>(scale);
        for (int k = 0; k < 3; ++k) s.change.add(Rgb<double>(g.by_wo[std::size_t(k)]) * Rgb<double>(scale), here.wo[k]);
        for (const auto& [p, t] : here.material) {
            if (!t.scatters()) continue;
            using D = Dual<1, double>;
            const Rgb<D> f = delta_value(with_tangent<1, double>(at.bsdf, t, 0), Vector3<D>(at.wo_local), lobe);
            for (int c = 0; c < 3; ++c) s.change.c[std::size_t(c)].d[p] += f[c].d[0] * scale;
        }
        return s;
    }
    /// Direction of a delta lobe and its change.
    void delta_ray(const ShadingPoint& at, const Arrival& here, Lobe lobe, Start& next) const {
        using D = Dual<4, double>;
        Vector3<D> wo;
        for (int k = 0; k < 3; ++k) wo[k] = D::variable(double(at.wo_local[k]), k);
        MaterialTangent index;
        index.eta = 1;
        const Vector3<D> wi = delta_direction(with_tangent<4, double>(at.bsdf, index, 3), wo, lobe);
        const Vec wi_local{wi.x.value, wi.y.value, wi.z.value};
        const Vectors& dwo = here.wo;
        Numbers deta;
        for (const auto& [p, t] : here.material) deta.d[p] += t.eta;
        Vectors local;
        for (int k = 0; k < 3; ++k) {
            for (int m = 0; m < 3; ++m) local[k].add(wi[k].d[std::size_t(m)], dwo[m]);
            local[k].add(wi[k].d[3], deta);
        }
        set_ray(in_double(at.frame), wi_local, local, here, next);
    }
    /// A ray along a local direction that changes in the frame and with it.
    static void set_ray(const Frame<double>& frame, const Vec& local, const Vectors& dlocal, const Arrival& here,
                        Start& next) {
        next.by_ray = true;
        next.w = normalize(frame.to_world(local));
        for (int p = 0; p < n; ++p) {
            const Vec m = here.motion.ns(p), d = dlocal(p);
            const double s = loom::dot(m, frame.s), t = loom::dot(m, frame.t), twist = here.motion.twist.d[p];
            // The inverse of local_change().
            const Vec turned{d.x - twist * local.y + local.z * s, d.y + twist * local.x + local.z * t,
                             d.z - s * local.x - t * local.y};
            const Vec world = frame.to_world(turned);
            next.dw.add(p, world - next.w * loom::dot(next.w, world));
        }
    }

    void leave(std::size_t j, const ShadingPoint& at, const Arrival& here) {
        const Lobe lobe = Lobe(g_.vertices.lobe[j]);
        const double inv_pdf = 1 / double(g_.vertices.pdf_w[j]);
        if (lobe == Lobe::null) {
            pass_straight(scatter_delta(at, here, lobe, inv_pdf), a_);
            return;
        }
        if (is_delta(lobe)) {
            a_ = start_at(at, here, scatter_delta(at, here, lobe, inv_pdf));
            delta_ray(at, here, lobe, a_);
            return;
        }
        const Vec wi(continuation_direction(g_, j));
        a_ = start_at(at, here, scatter(at, here, wi, inv_pdf));
        a_.by_ray = s_.reaches_delta(j);
        if (a_.by_ray) set_ray(a_.frame, a_.frame.to_local(wi), {}, here, a_);
    }

    /// A null lobe: the segment runs through, only its weight counts.
    static void pass_straight(const Scattering& s, Start& a) {
        a.dbeta.scale(s.value);
        a.dbeta.add(a.beta, s.change);
        a.beta = a.beta * s.value;
    }

    /// A segment that starts at a vertex, towards a material point.
    static Start start_at(const ShadingPoint& at, const Arrival& here, const Scattering& s) {
        Start next;
        next.p = here.place.p;
        next.v = here.motion.p;
        next.by_ray = false;
        next.scattered = true;
        next.factor = s.value;
        next.dfactor = s.change;
        next.by_wi = s.by_wi;
        next.beta = here.beta;
        next.dbeta = here.dbeta;
        next.opl = here.opl;
        next.dopl = here.dopl;
        next.frame = in_double(at.frame);
        next.ns = here.motion.ns;
        next.twist = here.motion.twist;
        for (int p = 0; p < n; ++p)
            next.turn.add(p, cross(Vec(at.frame.n), here.motion.ns(p)) + Vec(at.frame.n) * here.motion.twist.d[p]);
        return next;
    }

    template <class OnEdge>
    void light(std::size_t j, std::size_t k, const ShadingPoint& at, const Arrival& here, OnEdge&& on_edge) const {
        const auto& e = g_.light_edges;
        const std::size_t emitter = e.emitter[k];
        if (here.rests && !s_.light_changes(emitter)) return;
        const Lobe lobe = Lobe(g_.vertices.lobe[j]);
        const bool next_event = LightTechnique(e.technique[k]) == LightTechnique::next_event;
        const bool by_delta = !next_event && is_delta(lobe);
        const double weight = double(mis_weight(next_event, e.pdf_nee_w[k], e.pdf_bsdf_w[k], Heuristic::power)) /
                              double(next_event ? e.pdf_nee_w[k] : g_.vertices.pdf_w[j]);
        const Rgb<double> Li(rgb(e.Li, k));
        Colours dLi;
        const float* y = e.y.data() + 4 * k;
        const bool at_infinity = y[3] == 0;

        // Set up the segment to the light and its changes.
        const Vec wi = at_infinity ? Vec{y[0], y[1], y[2]} : normalize(Pt{y[0], y[1], y[2]} - here.place.p);
        const Scattering s = by_delta ? scatter_delta(at, here, lobe, weight) : scatter(at, here, wi, weight);
        Start a;
        if (by_delta && lobe == Lobe::null) {
            a = a_;
            pass_straight(s, a);
        } else {
            a = start_at(at, here, s);
            a.by_ray = by_delta;
            if (by_delta) delta_ray(at, here, lobe, a);
        }

        Vectors du;
        Numbers geometry, dopl = a.dopl;
        if (at_infinity) {
            // The direction turns with its emitter.
            const Vectors turn = emitter_turn(emitter, wi);
            if (a.by_ray)
                add_environment_change(wi, a.dw, turn, dLi);
            else
                du = turn;
            dopl = {};
        } else {
            const Pt light{y[0], y[1], y[2]};
            const Vec d = light - a.p;
            const double r = length(d);
            const Vec u = d / r;
            PointMotion<n> motion;
            const SurfacePlace place = s_.place_of_light(k, emitter, light);
            const bool of_area = s_.scene.emitters[emitter].kind == EmitterKind::area;
            if (of_area)
                s_.motions.add_material(place, motion);
            else
                for (const auto& [p, v] : s_.tangents.emitters[emitter]) motion.p.add(int(p), v.at(light));
            if (a.by_ray && of_area) slide(a, d, r, place, motion, nullptr);
            Vectors ddot = motion.p;
            ddot.add(-1, a.v);
            du = direction_change(u, r, ddot);
            if (of_area && !a.by_ray) geometry = geometry_change(u, r, ddot, place.ng, motion.ng, motion.area);
            double opl;
            add_length(a, e.eta, e.medium, k, r, u, ddot, opl, dopl);
            if (!of_area) change_delta_light(k, emitter, here, dLi);
        }
        add_emission(emitter, Li, s_.unit_emission(emitter, here.place.p), dLi);

        Rgb<double> beta;
        Colours dbeta;
        apply_factor(a, du, wi, beta, dbeta);
        dbeta.add(beta, geometry);
        dbeta.scale(Li);
        dbeta.add(beta, dLi);
        if (!dbeta.is_zero() || !dopl.is_zero()) on_edge(k, beta * Li, dbeta, dopl);
    }

    /// Turn of a direction with an emitter at infinity.
    Vectors emitter_turn(std::size_t emitter, const Vec& w) const {
        Vectors turn;
        for (const auto& [p, v] : s_.tangents.emitters[emitter]) {
            const Vec turned = v.turned(w);
            turn.add(int(p), turned - w * loom::dot(w, turned));
        }
        return turn;
    }

    /// Adds the change of an environment map's radiance along w, whose direction changes by dw, while the map turns.
    void add_environment_change(const Vec& w, const Vectors& dw, const Vectors& turn, Colours& dLi) const {
        if (s_.scene.environment_idx < 0 ||
            s_.scene.emitters[std::size_t(s_.scene.environment_idx)].kind != EmitterKind::envmap)
            return;
        constexpr double step = 1e-3;  // rad; a difference, as the map is bilinear
        for (int p = 0; p < n; ++p) {
            const Vec d = dw(p) - turn(p);
            const double size = length(d);
            if (size == 0) continue;
            const Vec by = d * (step / size);
            const Spectrum above = environment(s_.scene, Vector3f(normalize(w + by))),
                           below = environment(s_.scene, Vector3f(normalize(w - by)));
            for (int c = 0; c < 3; ++c)
                dLi.c[std::size_t(c)].d[p] += (double(above[c]) - double(below[c])) * (size / (2 * step));
        }
    }

    /// Adds the change of the light of a point, spot or projector with the distance to it and the place in its beam, or
    /// of a laser spot with the direction in which it reflects.
    void change_delta_light(std::size_t k, std::size_t emitter, const Arrival& here, Colours& dLi) const {
        const Emitter& e = s_.scene.emitters[emitter];
        if (s_.scene.nlos && s_.scene.nlos->laser_sampling) {
            change_laser_spot(k, here, dLi);
            return;
        }
        using D = Dual<3, double>;
        const EmitterPose<D> pose = s_.scene.nlos ? EmitterPose<D>(e, s_.laser_point(path_).beam) : EmitterPose<D>(e);
        Point3<D> from;
        for (int i = 0; i < 3; ++i) from[i] = D::variable(here.place.p[i], i);
        const LightSampleOf<D> light = delta_light(s_.scene, e, pose, from);
        // The light moves: the point moves the other way in its frame.
        Vectors relative = here.motion.p;
        for (const auto& [p, v] : s_.tangents.emitters[emitter]) relative.add(int(p), -v.at(here.place.p));
        for (int c = 0; c < 3; ++c)
            for (int i = 0; i < 3; ++i) dLi.c[std::size_t(c)].add(light.Li[c].d[std::size_t(i)], relative[i]);
    }

    ///   Li = f_l cos_l E / r^2 A: the lit surface scatters the laser's light towards the vertex
    void change_laser_spot(std::size_t k, const Arrival& here, Colours& dLi) const {
        const auto& e = g_.light_edges;
        const Pt spot{e.y[4 * k], e.y[4 * k + 1], e.y[4 * k + 2]};
        const Normal3f normal = unit_vector<Normal3f>(e.n, k);
        const Vec n_spot(normal), d = here.place.p - spot;
        const double r = length(d);
        const Vec u = d / r;
        const std::uint32_t material = s_.lit_material(path_);
        ShadingPoint lit;
        lit.frame = Framef(normal);
        lit.bsdf = Bsdf<float>(s_.scene.materials[material].model);
        lit.wo_local = lit.frame.to_local(Vector3f(u));
        const Vector3f to_laser = lit.frame.to_local(Vector3f(normalize(Pt(s_.scene.emitters[0].position) - spot)));
        const DirectionGradient f = f_cos_gradient(lit.bsdf, lit.wo_local, to_laser);
        const double cosine = loom::dot(n_spot, u);
        const Rgb<double> Li(rgb(e.Li, k));
        const auto add = [&](int p, int c, double change_of_f) {
            if (f.f_cos[c] > 0) dLi.c[std::size_t(c)].d[p] += Li[c] * change_of_f / double(f.f_cos[c]);
        };
        for (int p = 0; p < n; ++p) {
            const Vec v = here.motion.p(p);
            if (v == Vec{}) continue;
            const double relative = loom::dot(n_spot, v) / (r * cosine) - 3 * loom::dot(u, v) / r;
            const Vec turn = in_double(lit.frame).to_local((v - u * loom::dot(u, v)) / r);
            for (int c = 0; c < 3; ++c) {
                dLi.c[std::size_t(c)].d[p] += Li[c] * relative;
                double change = 0;
                for (int i = 0; i < 3; ++i) change += double(f.by_wo[std::size_t(i)][c]) * turn[i];
                add(p, c, change);
            }
        }
        for (const auto& [p, t] : s_.tangents.materials[material]) {
            if (!t.scatters()) continue;
            using D = Dual<1, double>;
            const Rgb<D> value =
                f_cos_pdf(with_tangent<1, double>(lit.bsdf, t, 0), Vector3<D>(lit.wo_local), Vector3<D>(to_laser))
                    .f_cos;
            for (int c = 0; c < 3; ++c) add(int(p), c, value[c].d[0]);
        }
    }

    const PathSource& s_;
    const PathGraph& g_;
    Start a_;
    std::size_t path_ = 0;
};

}  // namespace

struct InteriorWalker::Impl {
    PathSource source;
    mutable std::vector<float> dL, dopl;
    mutable std::vector<Vec> velocity, turn;

    Impl(const PathGraph& graph, const Scene& scene, const SceneTangents& tangents, const Attached& attached)
        : source(graph, scene, tangents, attached),
          dL(3 * tangents.n()),
          dopl(tangents.n()),
          velocity(tangents.n()),
          turn(tangents.n()) {}

    /// Calls f(Walk<n>) with the smallest n that holds all parameters.
    template <class F>
    void with_walk(F&& f) const {
        const std::size_t n = source.tangents.n();
        if (n <= 1)
            f(Walk<1>(source));
        else if (n <= 4)
            f(Walk<4>(source));
        else if (n <= 16)
            f(Walk<16>(source));
        else
            f(Walk<max_parameters>(source));
    }

    template <int n>
    InteriorRow row(std::size_t of, const ColourTangent<n>& change, const Tangent<n>& length) const {
        for (std::size_t p = 0; p < dopl.size(); ++p) {
            for (std::size_t c = 0; c < 3; ++c) dL[3 * p + c] = float(change.c[c].d[p]);
            dopl[p] = float(length.d[p]);
        }
        return {std::uint32_t(of), dL, dopl};
    }
};

InteriorWalker::InteriorWalker(const PathGraph& graph, const Scene& scene, const SceneTangents& tangents,
                               const Attached& attached)
    : impl_(std::make_unique<Impl>(graph, scene, tangents, attached)) {}
InteriorWalker::~InteriorWalker() = default;
InteriorWalker::InteriorWalker(InteriorWalker&&) noexcept = default;

bool InteriorWalker::touches(std::size_t path) const {
    return impl_->source.touches(path);
}

void InteriorWalker::walk(std::size_t path, std::size_t& edge, const OnRow& on_edge, const OnRow& on_seen) const {
    impl_->with_walk([&](auto&& walk) {
        walk.path(
            path, edge,
            [&](std::size_t k, const Rgb<double>&, const auto& change, const auto& length) {
                on_edge(impl_->row(k, change, length));
            },
            [&](std::size_t p, const Rgb<double>&, const auto& change, const auto& length) {
                on_seen(impl_->row(p, change, length));
            },
            [](std::size_t, const ShadingPoint&, const Rgb<double>&, double, const auto&) {});
    });
}

void InteriorWalker::walk_exactly(std::size_t path, std::size_t& edge, const OnExactRow& on_edge,
                                  const OnExactRow& on_seen) const {
    const std::size_t n = impl_->source.tangents.n();
    std::vector<Rgb<double>> dL(n);
    const auto pass = [&](const OnExactRow& to) {
        return [&](std::size_t of, const Rgb<double>& L, const auto& change, const auto& length) {
            for (std::size_t p = 0; p < n; ++p)
                for (int c = 0; c < 3; ++c) dL[p][c] = change.c[std::size_t(c)].d[p];
            to({of, L, dL, std::span(length.d).first(n)});
        };
    };
    impl_->with_walk([&](auto&& walk) {
        walk.path(path, edge, pass(on_edge), pass(on_seen),
                  [](std::size_t, const ShadingPoint&, const Rgb<double>&, double, const auto&) {});
    });
}

void InteriorWalker::walk_vertices(std::size_t path, const OnVertex& on_vertex) const {
    const PathGraph& g = impl_->source.graph;
    if (!touches(path)) {
        // Everything rests.
        const GraphReader& reader = impl_->source.reader;
        std::fill(impl_->velocity.begin(), impl_->velocity.end(), Vec{});
        std::fill(impl_->turn.begin(), impl_->turn.end(), Vec{});
        const auto [begin, end] = vertices_of(g, path);
        Pt from = camera_origin<double>(g, path);
        Rgb<double> beta(1);
        double opl = 0, camera_opl = 0;
        for (std::size_t j = begin; j < end; ++j) {
            const ShadingPoint at = reader.vertex(j);
            const Pt p = position<double>(g, j);
            opl += (g.vertices.eta.empty() ? 1.0 : double(g.vertices.eta[j])) * length(p - from);
            from = p;
            if (j == begin) camera_opl = opl;
            on_vertex({j, &at, beta, opl, camera_opl, impl_->velocity, impl_->turn});
            if (j + 1 < end) beta *= Rgb<double>(own_continuation(reader, at, j, continuation_direction(g, j)));
        }
        return;
    }
    std::size_t edge = g.n_light_edges();
    double camera_opl = 0;
    const auto no_row = [](std::size_t, const Rgb<double>&, const auto&, const auto&) {};
    impl_->with_walk([&](auto&& walk) {
        walk.path(path, edge, no_row, no_row,
                  [&](std::size_t j, const ShadingPoint& at, const Rgb<double>& beta, double opl, const auto& motion) {
                      const Vec n(at.frame.n);
                      for (std::size_t p = 0; p < impl_->velocity.size(); ++p) {
                          impl_->velocity[p] = motion.p(int(p));
                          impl_->turn[p] = cross(n, motion.ns(int(p))) + n * motion.twist.d[p];
                      }
                      if (j == g.paths.first_vertex[path]) camera_opl = opl;
                      on_vertex({j, &at, beta, opl, camera_opl, impl_->velocity, impl_->turn});
                  });
    });
}

std::string missing_columns(const PathGraph& graph, const Scene& scene, const SceneTangents& tangents,
                            const Attached& attached) {
    const SurfaceMotions motions(scene, tangents);
    bool primitives = false, media = false;
    for (std::uint32_t s = 0; s < scene.shapes.size(); ++s)
        primitives |=
            !tangents.vertices[s].empty() || (scene.shapes[s].kind == ShapeKind::mesh &&
                                              (tangents.camera_moves() || tangents.moves(s)) && motions.varies(s));
    // Behind mirrors and glass all vertices slide when one of them moves.
    if ((attached.reach > 0 || scene.features.delta_lobes) && (tangents.any_shape_moves() || tangents.camera_moves()))
        for (std::uint32_t s = 0; s < scene.shapes.size(); ++s)
            primitives |= scene.shapes[s].kind == ShapeKind::mesh && motions.varies(s);
    for (const auto& effects : tangents.materials)
        for (const auto& [p, t] : effects) media |= t.int_ior != 0;
    std::string missing;
    if (primitives && graph.vertices.primitive.empty()) missing = "--primitives";
    if (media && scene.features.dielectric && graph.vertices.medium.empty())
        missing += std::string(missing.empty() ? "" : " ") + "--media";
    return missing;
}

}  // namespace loom::derive
