#include "stages/derive/interior.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <variant>

#include "stages/core/graph/own_samples.h"
#include "stages/core/scattering/gradient.h"
#include "stages/core/scene/delta_light.h"
#include "stages/core/scene/nlos.h"
#include "stages/derive/path_source.h"

namespace loom::derive {

std::size_t next_path_edge(const PathGraph& graph, std::size_t path, std::size_t edge) {
    const auto& of = graph.light_edges.vertex;
    while (edge < of.size() && of[edge] < graph.paths.first_vertex[path + 1]) ++edge;
    return edge;
}

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
    Walk(const PathSource& source, const WholeLightOptions& whole)
        : s_(source), g_(source.graph), whole_(source.scene, whole), has_whole_(whole.on()) {
        camera_.still = !s_.tangents.camera_moves();
        camera_.rests = camera_.still;
        for (const auto& [p, v] : s_.tangents.camera)
            camera_translates_ &= std::all_of(v.linear.begin(), v.linear.end(), [](double x) { return x == 0; });
        camera_.beta = Rgb<double>(1);
    }
    Walk(const Walk&) = delete;

    using Numbers = Tangent<n>;
    using Vectors = VectorTangent<n>;
    using Colours = ColourTangent<n>;

    /// on_edge(k, L, dL, dopl), on_seen(path, Le, dLe, dopl), on_vertex(j, at, beta, opl, motion),
    /// on_point(k, length of the last segment, L, dL, dopl): points of the light of edge k, in place of the edge
    /// in:      to_end  whether to go on after the last light edge
    template <bool to_end, class OnEdge, class OnSeen, class OnVertex, class OnPoint>
    void path(std::size_t path, std::size_t& edge, OnEdge&& on_edge, OnSeen&& on_seen, OnVertex&& on_vertex,
              OnPoint&& on_point) {
        const auto [begin, end] = vertices_of(g_, path);
        path_ = path;
        start_at_camera(path, begin, end);
        if (begin == end) {
            see_environment(path, on_seen);
            return;
        }
        const auto& edges = g_.light_edges.vertex;
        for (std::size_t j = begin; j < end; ++j) {
            Vertex& here = start_.from == &vertices_[0] ? vertices_[1] : vertices_[0];
            const ShadingPoint& at = here.at;
            arrive(j, here);
            if (j == begin) see(path, at, here, on_seen);
            on_vertex(j, at, here.beta, here.opl, here.motion);
            for (; edge < edges.size() && edges[edge] == j; ++edge) {
                const LightEnd end_of_edge = stored_light(j, edge);
                if (j == begin && has_whole_ && end_of_edge.next_event)
                    light_or_points(j, edge, end_of_edge, at, here, on_edge, on_point);
                else
                    light(j, end_of_edge, at, here, [&](const auto&... x) { on_edge(edge, x...); });
            }
            if constexpr (!to_end)
                if (edge == edges.size() || edges[edge] >= end) return;
            if (j + 1 < end) leave(j, at, here);
        }
    }

  private:
    /// A vertex, or the camera. Reused from path to path.
    struct Vertex {
        ShadingPoint at;
        std::size_t stored = GraphReader::no_vertex;  // in the graph
        SurfacePlace place;
        PointMotion<n> motion;
        Vectors turn;        // angular velocity of the frame
        Vectors wo;          // change of wo in the frame; 0 where the BSDF does not depend on wo
        bool still = false;  // place, frame and wo stay with all parameters; their changes are 0
        bool turns = false;  // normals or frame may change; else their changes are 0
        bool rests = false;  // nothing up to here depends on a parameter
        Rgb<double> beta;    // throughput from the camera
        Colours dbeta;
        double opl = 0;  // from the camera
        Numbers dopl;
        std::uint32_t material_idx = 0;
        // The material's tangents at this point, textures under a sliding point included; by parameter.
        std::span<const Of<MaterialTangent>> material;
        Effects<MaterialTangent> textured;  // storage of `material` where a texture changes

        void stay() {
            if (!still) motion = {}, turn = {}, wo = {};
            still = true;
            turns = false;
        }
    };
    /// Where a segment starts, and the factor of the scattering there, whose direction may still change with the end.
    struct Start {
        const Vertex* from = nullptr;
        bool by_ray = true;                  // the ray's direction determines the end of the segment
        bool still = false;                  // the vertex and the ray stay with all parameters
        bool rests = false;                  // nothing up to here depends on a parameter, the factor included
        bool constant = true;                // dfactor is 0
        bool along_normal = true;            // by_wi has a component along the normal alone
        Vectors dw;                          // by_ray: change of the ray's unit direction
        Rgb<double> factor{1};               // f cos / pdf
        Colours dfactor;                     // without the change of the outgoing segment's direction
        std::array<Rgb<double>, 3> by_wi{};  // gradient of the factor by the local direction
    };

    void start_at_camera(std::size_t path, std::size_t begin, std::size_t end) {
        Start& a = start_;
        a.from = &camera_;
        camera_.place.p = camera_origin<double>(g_, path);
        a.by_ray = !s_.scene.nlos || s_.scene.nlos->relay_wall == NlosCapture::no_wall;
        a.still = a.rests = camera_.still;
        a.constant = a.along_normal = true;
        a.factor = Rgb<double>(1);
        a.dfactor = {};
        a.by_wi = {};
        a.dw = {};
        if (camera_.still) return;
        const bool turns = !camera_translates_ || !s_.tangents.lens.empty();
        const Vec w = turns && begin < end ? normalize(position<double>(g_, begin) - camera_.place.p) : Vec{0, 0, 1};
        camera_.motion.p = {};
        for (const auto& [p, v] : s_.tangents.camera) {
            camera_.motion.p.add(int(p), v.at(camera_.place.p));
            if (camera_translates_) continue;
            const Vec turned = v.turned(w);
            a.dw.add(int(p), turned - w * loom::dot(w, turned));
        }
        if (!s_.tangents.lens.empty()) {
            const auto& m = s_.scene.sensor.world_from_camera;
            const Vec axis = normalize(Vec{m[2], m[6], m[10]});
            // A wider field of view scales what is perpendicular to the axis.
            const double along = loom::dot(w, axis);
            const Vec across = w - axis * along;
            for (const auto& [p, relative] : s_.tangents.lens) {
                const Vec change = across * relative;
                a.dw.add(int(p), change - w * loom::dot(w, change));
            }
        }
    }

    /// A segment between two vertices, or a vertex and a light.
    struct Segment {
        Vec d, u;  // u: unit
        double r, inv_r;

        Segment(const Pt& from, const Pt& to) : d(to - from), r(length(d)), inv_r(1 / r) { u = d * inv_r; }
    };

    /// Moves a point along its surface towards the one that the ray reaches.
    /// in:      motion  of the material point
    /// out:     motion  of the sliding point: normals and the growth of its area included
    void slide(const Start& a, const Segment& to, const SurfacePlace& place, PointMotion<n>& motion,
               Vertex* arrival) const {
        const double share = a.by_ray ? 1 : s_.attached.share(place.shape_idx, to.r);
        if (share == 0) return;
        const Vertex& from = *a.from;
        const bool varies = s_.shape_varies[place.shape_idx];
        const double inv_cosine = 1 / loom::dot(place.ng, to.u),
                     slope = a.by_ray ? 0 : s_.attached.slope(place.shape_idx, to.r);
        Numbers tilt;
        if (!a.by_ray) s_.motions.add_tilt(place, to.d, tilt);
        for (int p = 0; p < n; ++p) {
            Vec ray = from.motion.p(p);
            if (a.by_ray)
                ray = ray + a.dw(p) * to.r;
            else if (from.turns)
                ray = ray + cross(from.turn(p), to.d);
            const Vec change = motion.p(p) - ray;
            if (change == Vec{}) continue;
            const Vec slip = to.u * (loom::dot(place.ng, change) * inv_cosine) - change;
            const Vec along = slip * share;
            motion.p.add(p, along);
            if (!a.by_ray)
                motion.area.d[p] +=
                    share * s_.motions.slip_growth(place, motion.area.d[p], tilt.d[p], to.d, change, from.turn(p)) +
                    slope * loom::dot(to.u, slip);
            if (!varies || along == Vec{}) continue;
            const auto normals = s_.motions.normals_along(place, along);
            motion.ng.add(p, normals.ng);
            motion.ns.add(p, normals.ns);
            if (arrival) {
                const MaterialTangent t = s_.motions.texture_along(place, arrival->material_idx, along);
                if (!t.is_zero()) add_material(*arrival, std::uint32_t(p), t);
            }
        }
    }
    static void add_material(Vertex& at, std::uint32_t p, const MaterialTangent& t) {
        if (at.textured.empty()) at.textured.assign(at.material.begin(), at.material.end());
        const auto known = std::find_if(at.textured.begin(), at.textured.end(),
                                        [p](const auto& effect) { return effect.parameter_idx == p; });
        if (known == at.textured.end())
            at.textured.push_back({p, t});
        else
            known->effect += t;
        at.material = at.textured;
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
    /// in:      ddot   how the ends move apart
    ///          along  its share along the segment
    ///          end    null: it keeps its normal and its area
    static Numbers geometry_change(const Segment& to, const Vectors& ddot, const Numbers& along, const Vec& normal,
                                   const PointMotion<n>* end) {
        Numbers sum;
        const double inv_cosine = 1 / loom::dot(normal, to.u);
        for (int p = 0; p < n; ++p)
            sum.d[p] = loom::dot(normal, ddot(p)) * to.inv_r * inv_cosine - 3 * along.d[p] * to.inv_r;
        if (end)
            for (int p = 0; p < n; ++p) sum.d[p] += loom::dot(end->ng(p), to.u) * inv_cosine + end->area.d[p];
        return sum;
    }

    /// Change of the unit direction of a segment whose ends move apart by ddot.
    static Vectors direction_change(const Segment& to, const Vectors& ddot, const Numbers& along) {
        Vectors du;
        for (int p = 0; p < n; ++p) du.add(p, (ddot(p) - to.u * along.d[p]) * to.inv_r);
        return du;
    }

    /// The factor of a start towards a changing direction, as value and change.
    /// in:      du  null: the direction and the frame stay
    void apply_factor(const Start& a, const Vectors* du, const Vec& u, Rgb<double>& beta, Colours& dbeta) const {
        const Vertex& from = *a.from;
        beta = from.beta * a.factor;
        if (a.rests && !du) {
            dbeta = {};
            return;
        }
        dbeta = from.dbeta;
        dbeta.scale(a.factor);
        if (!du || a.by_ray || a.from == &camera_) {
            if (!a.constant) dbeta.add(from.beta, a.dfactor);
            return;
        }
        Colours dfactor = a.dfactor;
        if (a.along_normal) {
            const Vec normal(from.at.frame.n);
            Numbers local;
            for (int p = 0; p < n; ++p) local.d[p] = loom::dot(normal, (*du)(p));
            if (from.turns) {
                // Not u - n (n . u): the stored normal has the length 1 in single precision alone.
                const Vec s(from.at.frame.s), t(from.at.frame.t), across = s * loom::dot(s, u) + t * loom::dot(t, u);
                for (int p = 0; p < n; ++p) local.d[p] += loom::dot(across, from.motion.ns(p));
            }
            dfactor.add(a.by_wi[2], local);
        } else {
            const Frame<double> frame = in_double(from.at.frame);
            const Vectors local = local_change(frame, frame.to_local(u), *du, from.motion.ns, from.motion.twist);
            for (int k = 0; k < 3; ++k) dfactor.add(a.by_wi[std::size_t(k)], local[k]);
        }
        dbeta.add(from.beta, dfactor);
    }

    void arrive(std::size_t j, Vertex& b) const {
        const Start& a = start_;
        const Vertex& from = *a.from;
        const ShadingPoint& at = b.at;
        s_.reader.read_vertex(j, b.at, b.stored);
        b.stored = j;
        b.place = s_.place(j, at);
        b.material_idx = g_.vertices.material[j];
        b.textured.clear();
        b.material = s_.tangents.materials[b.material_idx];
        const Segment to(from.place.p, b.place.p);
        b.opl = from.opl + (g_.vertices.eta.empty() ? 1.0 : double(g_.vertices.eta[j])) * to.r;
        b.dopl = from.dopl;
        if (a.still && !s_.shape_matters[b.place.shape_idx]) {
            b.stay();
            apply_factor(a, nullptr, to.u, b.beta, b.dbeta);
            b.rests = a.rests && b.material.empty();
        } else {
            b.still = b.rests = false;
            b.motion = {};
            s_.motions.add_material(b.place, b.motion);
            if (a.by_ray || from_surface(a)) slide(a, to, b.place, b.motion, &b);
            Vectors ddot = b.motion.p;
            ddot.add(-1, from.motion.p);
            const Numbers along = loom::derive::dot(to.u, ddot);
            const Vectors du = direction_change(to, ddot, along);
            apply_factor(a, &du, to.u, b.beta, b.dbeta);
            if (!a.by_ray && from_surface(a))
                b.dbeta.add(b.beta, geometry_change(to, ddot, along, b.place.ng, &b.motion));
            b.dopl.add(g_.vertices.eta.empty() ? 1.0 : double(g_.vertices.eta[j]), along);
            if (s_.depends_on_wo[b.material_idx]) {
                Vectors back;
                back.add(-1, du);
                b.wo = local_change(in_double(at.frame), Vec(at.wo_local), back, b.motion.ns, b.motion.twist);
            } else {
                b.wo = {};
            }
            const std::uint32_t shape = b.place.shape_idx;
            const bool turned = b.turns;
            b.turns = !s_.motions.only_translates(shape) || s_.shape_varies[shape];
            if (turned && !b.turns) b.turn = {};
            const Vec normal(at.frame.n);
            for (int p = 0; b.turns && p < n; ++p) {
                const Vec turn = cross(normal, b.motion.ns(p)) + normal * b.motion.twist.d[p];
                b.turn.x.d[p] = turn.x, b.turn.y.d[p] = turn.y, b.turn.z.d[p] = turn.z;
            }
        }
        if (s_.media_matter && add_medium(g_.vertices.medium[j], to.r, b.dopl)) b.rests = false;
    }
    /// Whether a segment starts at a vertex, not at the camera.
    bool from_surface(const Start& a) const { return a.from != &camera_; }

    /// Adds the change of a segment's length with the index of its medium.
    /// out:     whether there is one
    bool add_medium(std::uint16_t medium, double r, Numbers& dopl) const {
        if (medium == no_medium) return false;
        for (const auto& [p, t] : s_.tangents.materials[medium]) dopl.d[p] += t.int_ior * r;
        return !s_.tangents.materials[medium].empty();
    }

    /// The directly visible emitter at the first hit.
    template <class OnSeen>
    void see(std::size_t path, const ShadingPoint& at, const Vertex& here, OnSeen&& on_seen) const {
        if (here.rests && s_.scene.shapes[here.place.shape_idx].emitter_idx < 0) return;
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

    /// Starts a segment at a vertex with f cos towards a world direction, times `scale`.
    /// in:      direction_stays  the direction stays if the vertex does
    void scatter(const ShadingPoint& at, const Vertex& here, const Vec& wi, double scale, bool direction_stays,
                 Start& s) const {
        start_at(here, s);
        s.along_normal = !s_.depends_on_wo[here.material_idx];
        s.constant = (here.still || s.along_normal) && here.material.empty();
        s.rests = here.rests && s.constant;
        s.dfactor = {};
        if (s.along_normal && !at.perturbed && here.material.empty()) {
            const DiffuseGradient g = diffuse_gradient(at.bsdf, at.wo_local.z, dot(Vector3f(wi), at.frame.n));
            s.factor = Rgb<double>(g.f_cos) * Rgb<double>(scale);
            s.by_wi[2] = Rgb<double>(g.by_wi_z) * Rgb<double>(scale);
            return;
        }
        const Vector3f wi_local = at.frame.to_local(Vector3f(wi));
        const Rgb<double> by(at.perturbed ? scale * double(bump_shadowing(at, Vector3f(wi), wi_local.z)) : scale);
        if (s.constant && here.still && direction_stays) {
            s.factor = Rgb<double>(f_cos_pdf(at.bsdf, at.wo_local, wi_local).f_cos) * by;
            return;
        }
        const DirectionGradient g = f_cos_gradient(at.bsdf, at.wo_local, wi_local);
        s.factor = Rgb<double>(g.f_cos) * by;
        s.by_wi[2] = Rgb<double>(g.by_wi[2]) * by;
        if (!s.along_normal) {
            for (std::size_t k = 0; k < 2; ++k) s.by_wi[k] = Rgb<double>(g.by_wi[k]) * by;
            for (int k = 0; k < 3; ++k) s.dfactor.add(Rgb<double>(g.by_wo[std::size_t(k)]) * by, here.wo[k]);
        }
        for (const auto& [p, t] : here.material) {
            if (!t.scatters()) continue;
            using D = Dual<1, double>;
            const Bsdf<D> bsdf = with_tangent<1, double>(at.bsdf, t, 0);
            const Rgb<D> f = f_cos_pdf(bsdf, Vector3<D>(at.wo_local), Vector3<D>(wi_local)).f_cos;
            for (int c = 0; c < 3; ++c) s.dfactor.c[std::size_t(c)].d[p] += f[c].d[0] * by[c];
        }
    }
    /// A delta lobe of a vertex with its changes, times `scale`.
    struct DeltaScattering {
        Rgb<double> value;
        Colours change;  // by wo, frame for wo, and material
        bool constant;
    };
    DeltaScattering scatter_delta(const ShadingPoint& at, const Vertex& here, Lobe lobe, double scale) const {
        DeltaScattering s;
        const DeltaGradient g = delta_value_gradient(at.bsdf, at.wo_local, lobe);
        s.value = Rgb<double>(g.value) * Rgb<double>(scale);
        s.constant = here.still && here.material.empty();
        if (s.constant) return s;
        for (int k = 0; k < 3; ++k) s.change.add(Rgb<double>(g.by_wo[std::size_t(k)]) * Rgb<double>(scale), here.wo[k]);
        for (const auto& [p, t] : here.material) {
            if (!t.scatters()) continue;
            using D = Dual<1, double>;
            const Rgb<D> f = delta_value(with_tangent<1, double>(at.bsdf, t, 0), Vector3<D>(at.wo_local), lobe);
            for (int c = 0; c < 3; ++c) s.change.c[std::size_t(c)].d[p] += f[c].d[0] * scale;
        }
        return s;
    }
    /// Starts a segment at a vertex along a delta lobe.
    void start_delta(const ShadingPoint& at, const Vertex& here, Lobe lobe, double scale, Start& s) const {
        start_at(here, s);
        const DeltaScattering delta = scatter_delta(at, here, lobe, scale);
        s.factor = delta.value;
        s.dfactor = delta.change;
        s.constant = delta.constant;
        s.rests = here.rests && s.constant;
        delta_ray(at, here, lobe, s);
    }
    /// Sets the change of the direction of a delta lobe.
    void delta_ray(const ShadingPoint& at, const Vertex& here, Lobe lobe, Start& next) const {
        next.by_ray = true;
        next.dw = {};
        next.still = here.still && here.material.empty();
        if (next.still) return;
        using D = Dual<4, double>;
        Vector3<D> wo;
        for (int k = 0; k < 3; ++k) wo[k] = D::variable(double(at.wo_local[k]), k);
        MaterialTangent index;
        index.eta = 1;
        const Vector3<D> wi = delta_direction(with_tangent<4, double>(at.bsdf, index, 3), wo, lobe);
        const Vec wi_local{wi.x.value, wi.y.value, wi.z.value};
        Numbers deta;
        for (const auto& [p, t] : here.material) deta.d[p] += t.eta;
        Vectors local;
        for (int k = 0; k < 3; ++k) {
            for (int m = 0; m < 3; ++m) local[k].add(wi[k].d[std::size_t(m)], here.wo[m]);
            local[k].add(wi[k].d[3], deta);
        }
        set_ray(in_double(at.frame), wi_local, local, here, next);
    }
    /// Sets a ray along a local direction that changes in the frame and with it.
    static void set_ray(const Frame<double>& frame, const Vec& local, const Vectors& dlocal, const Vertex& here,
                        Start& next) {
        next.by_ray = true;
        next.dw = {};
        if (next.still) return;
        const Vec ray = normalize(frame.to_world(local));
        for (int p = 0; p < n; ++p) {
            const Vec m = here.motion.ns(p), d = dlocal(p);
            const double s = loom::dot(m, frame.s), t = loom::dot(m, frame.t), twist = here.motion.twist.d[p];
            // The inverse of local_change().
            const Vec turned{d.x - twist * local.y + local.z * s, d.y + twist * local.x + local.z * t,
                             d.z - s * local.x - t * local.y};
            const Vec world = frame.to_world(turned);
            next.dw.add(p, world - ray * loom::dot(ray, world));
        }
    }

    void leave(std::size_t j, const ShadingPoint& at, const Vertex& here) {
        const auto& v = g_.vertices;
        const Lobe lobe = Lobe(v.lobe[j]);
        const double inv_pdf = 1 / double(v.pdf_w[j]);
        if (lobe == Lobe::null) {
            pass_straight(scatter_delta(at, here, lobe, inv_pdf), start_);
            return;
        }
        if (is_delta(lobe)) {
            start_delta(at, here, lobe, inv_pdf, start_);
            return;
        }
        const Vec wi(continuation_direction(g_, j));
        // Behind a null vertex the segment goes on, to an end that may move.
        const bool end_stays = !s_.shape_matters[v.shape[j + 1]] && Lobe(v.lobe[j + 1]) != Lobe::null;
        scatter(at, here, wi, inv_pdf, end_stays, start_);
        if (!s_.reaches_delta(j)) return;
        const Frame<double> frame = in_double(at.frame);
        set_ray(frame, frame.to_local(wi), {}, here, start_);
    }

    /// A null lobe: the segment runs through, only its weight counts.
    static void pass_straight(const DeltaScattering& s, Start& a) {
        a.dfactor.scale(s.value);
        a.dfactor.add(a.factor, s.change);
        for (Rgb<double>& by : a.by_wi) by = by * s.value;
        a.factor = a.factor * s.value;
        a.constant = a.constant && s.constant;
        a.rests = a.rests && s.constant;
    }

    /// A segment that starts at a vertex, towards a material point; its factor is not set.
    static void start_at(const Vertex& here, Start& next) {
        next.from = &here;
        next.by_ray = false;
        next.still = here.still;
        next.along_normal = true;
        next.by_wi = {};
    }

    /// Where light comes from that a vertex scatters.
    struct LightEnd {
        std::size_t emitter = 0;
        bool next_event = false, at_infinity = false;
        double weight = 0;  // MIS weight / density
        Rgb<double> Li;
        Pt y;  // or the direction towards it
        Vec normal;
        double eta = 1;
        std::uint16_t medium = no_medium;
    };
    /// Keeps the normal of the edge before where it is the same.
    const Vec& normal_of_light(std::size_t k) {
        if (normal_edge_ == no_edge || !same_vector(g_.light_edges.n, k, normal_edge_)) normal_ = s_.normal_of_light(k);
        normal_edge_ = k;
        return normal_;
    }
    LightEnd stored_light(std::size_t j, std::size_t k) {
        const auto& e = g_.light_edges;
        LightEnd end;
        end.emitter = e.emitter[k];
        end.next_event = LightTechnique(e.technique[k]) == LightTechnique::next_event;
        end.weight = double(mis_weight(end.next_event, e.pdf_nee_w[k], e.pdf_bsdf_w[k], Heuristic::power)) /
                     double(end.next_event ? e.pdf_nee_w[k] : g_.vertices.pdf_w[j]);
        end.Li = Rgb<double>(rgb(e.Li, k));
        const float* y = e.y.data() + 4 * k;
        end.at_infinity = y[3] == 0;
        end.y = Pt{y[0], y[1], y[2]};
        end.normal = normal_of_light(k);
        if (!e.eta.empty()) end.eta = double(e.eta[k]);
        if (s_.media_matter) end.medium = e.medium[k];
        return end;
    }

    /// light() of a stored edge, or of points all over its light where that is seen wholly and lengths change.
    template <class OnEdge, class OnPoint>
    void light_or_points(std::size_t j, std::size_t k, const LightEnd& end, const ShadingPoint& at, const Vertex& here,
                         OnEdge&& on_edge, OnPoint&& on_point) {
        std::span<const WholeLightPoint> points;
        light(j, end, at, here, [&](const Rgb<double>& L, const Colours& dL, const Numbers& dopl) {
            if (!dopl.is_zero())
                points = whole_.points(j, here.place.shape_idx, at, end.emitter, g_.light_edges.pdf_bsdf_w[k],
                                       Vector3f(normalize(end.y - here.place.p)));
            if (points.empty()) on_edge(k, L, dL, dopl);
        });
        LightEnd of_point = end;
        for (const WholeLightPoint& point : points) {
            of_point.weight = point.weight;
            of_point.Li = point.Li;
            of_point.y = point.y;
            of_point.normal = Vec(point.n);
            light(j, of_point, at, here,
                  [&](const auto&... x) { on_point(k, of_point.eta * length(point.y - here.place.p), x...); });
        }
    }

    /// on_light(L, dL, dopl) unless both derivatives are 0
    template <class OnLight>
    void light(std::size_t j, const LightEnd& end, const ShadingPoint& at, const Vertex& here, OnLight&& on_light) {
        const std::size_t emitter = end.emitter;
        if (here.rests && !s_.light_changes(emitter)) return;
        const Lobe lobe = Lobe(g_.vertices.lobe[j]);
        const bool by_delta = !end.next_event && is_delta(lobe);
        const double weight = end.weight;
        const Rgb<double>& Li = end.Li;
        const bool at_infinity = end.at_infinity;
        const bool light_stays = !s_.emitter_matters[emitter];

        // Set up the segment to the light and its changes.
        const Pt light = at_infinity ? here.place.p + Vec(end.y) : end.y;
        Segment to(here.place.p, light);
        const Vec wi = at_infinity ? Vec(end.y) : to.u;
        Start& a = to_light_;
        if (!by_delta) {
            scatter(at, here, wi, weight, light_stays, a);
        } else if (lobe == Lobe::null) {
            a = start_;
            pass_straight(scatter_delta(at, here, lobe, weight), a);
            to = Segment(a.from->place.p, light);
        } else {
            start_delta(at, here, lobe, weight, a);
        }

        const bool stays = a.still && light_stays;
        const bool of_area = s_.scene.emitters[emitter].kind == EmitterKind::area;
        Rgb<double> beta;
        Colours dbeta;
        Numbers dopl;
        if (at_infinity) {
            // The direction turns with its emitter.
            const Vectors du = emitter_turn(emitter, wi);
            apply_factor(a, stays ? nullptr : &du, wi, beta, dbeta);
        } else {
            dopl = a.from->dopl;
            if (stays)
                apply_factor(a, nullptr, wi, beta, dbeta);
            else
                move_light(a, to, end, wi, beta, dbeta, dopl);
            if (s_.media_matter) add_medium(end.medium, to.r, dopl);
        }
        dbeta.scale(Li);
        if ((at_infinity && a.by_ray) || !of_area || !s_.tangents.radiance[emitter].empty()) {
            Colours dLi;
            if (at_infinity && a.by_ray) add_environment_change(wi, a.dw, emitter_turn(emitter, wi), dLi);
            if (!at_infinity && !of_area && (!stays || s_.scene.nlos)) change_delta_light(end, here, dLi);
            if (!s_.tangents.radiance[emitter].empty())
                add_emission(emitter, Li, s_.unit_emission(emitter, here.place.p), dLi);
            dbeta.add(beta, dLi);
        }
        if (!dbeta.is_zero() || !dopl.is_zero()) on_light(beta * Li, dbeta, dopl);
    }

    /// Throughput up to a light at a finite distance, with changes of both ends of the segment to it.
    /// in:      dopl  derivative of the length up to the segment; out: with the segment's
    void move_light(const Start& a, const Segment& to, const LightEnd& light, const Vec& wi, Rgb<double>& beta,
                    Colours& dbeta, Numbers& dopl) const {
        const Emitter& source = s_.scene.emitters[light.emitter];
        const bool of_area = source.kind == EmitterKind::area;
        const bool translates = of_area && !a.by_ray && s_.motions.only_translates(source.shape_idx);
        Vectors ddot;
        ddot.add(-1, a.from->motion.p);
        const auto apply = [&](const PointMotion<n>* end, const Vec& normal) {
            const Numbers along = loom::derive::dot(to.u, ddot);
            const Vectors du = direction_change(to, ddot, along);
            apply_factor(a, &du, wi, beta, dbeta);
            if (of_area && !a.by_ray) dbeta.add(beta, geometry_change(to, ddot, along, normal, end));
            dopl.add(light.eta, along);
        };
        if (translates) {
            for (const auto& [p, v] : s_.tangents.shapes[source.shape_idx]) ddot.add(int(p), v.offset);
            apply(nullptr, light.normal);
        } else if (of_area) {
            PointMotion<n> motion;
            const SurfacePlace place = s_.place_of_light(light.emitter, light.y, light.normal);
            s_.motions.add_material(place, motion);
            if (a.by_ray) slide(a, to, place, motion, nullptr);
            ddot.add(1, motion.p);
            apply(&motion, place.ng);
        } else {
            for (const auto& [p, v] : s_.tangents.emitters[light.emitter]) ddot.add(int(p), v.at(light.y));
            apply(nullptr, {});
        }
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
    void change_delta_light(const LightEnd& end, const Vertex& here, Colours& dLi) const {
        const Emitter& e = s_.scene.emitters[end.emitter];
        if (s_.scene.nlos && s_.scene.nlos->laser_sampling) {
            change_laser_spot(end, here, dLi);
            return;
        }
        using D = Dual<3, double>;
        const EmitterPose<D> pose = s_.scene.nlos ? EmitterPose<D>(e, s_.laser_point(path_).beam) : EmitterPose<D>(e);
        Point3<D> from;
        for (int i = 0; i < 3; ++i) from[i] = D::variable(here.place.p[i], i);
        const LightSampleOf<D> light = delta_light(s_.scene, e, pose, from);
        // The light moves: the point moves the other way in its frame.
        Vectors relative = here.motion.p;
        for (const auto& [p, v] : s_.tangents.emitters[end.emitter]) relative.add(int(p), -v.at(here.place.p));
        for (int c = 0; c < 3; ++c)
            for (int i = 0; i < 3; ++i) dLi.c[std::size_t(c)].add(light.Li[c].d[std::size_t(i)], relative[i]);
    }

    ///   Li = f_l cos_l E / r^2 A: the lit surface scatters the laser's light towards the vertex
    void change_laser_spot(const LightEnd& end, const Vertex& here, Colours& dLi) const {
        const Pt spot = end.y;
        const Normal3f normal(end.normal);
        const Vec n_spot = end.normal, d = here.place.p - spot;
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
        const Rgb<double>& Li = end.Li;
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
    Vertex camera_, vertices_[2];
    Start start_, to_light_;
    static constexpr std::size_t no_edge = ~std::size_t{0};
    std::size_t path_ = 0, normal_edge_ = no_edge;
    Vec normal_;  // of the light of normal_edge_
    WholeLights whole_;
    bool has_whole_, camera_translates_ = true;
};

constexpr auto nothing = [](const auto&...) {};

}  // namespace

struct InteriorWalker::Impl {
    PathSource source;
    template <int... n>
    using OneOf = std::variant<std::unique_ptr<Walk<n>>...>;
    OneOf<1, 2, 3, 4, 8, 16, max_parameters> walk;
    mutable std::vector<float> dL, dopl;
    mutable std::vector<Vec> velocity, turn;

    Impl(const PathGraph& graph, const Scene& scene, const SceneTangents& tangents, const Attached& attached,
         const WholeLightOptions& whole)
        : source(graph, scene, tangents, attached),
          dL(3 * tangents.n()),
          dopl(tangents.n()),
          velocity(tangents.n()),
          turn(tangents.n()) {
        const std::size_t n = tangents.n();
        if (n <= 1)
            walk = std::make_unique<Walk<1>>(source, whole);
        else if (n <= 2)
            walk = std::make_unique<Walk<2>>(source, whole);
        else if (n <= 3)
            walk = std::make_unique<Walk<3>>(source, whole);
        else if (n <= 4)
            walk = std::make_unique<Walk<4>>(source, whole);
        else if (n <= 8)
            walk = std::make_unique<Walk<8>>(source, whole);
        else if (n <= 16)
            walk = std::make_unique<Walk<16>>(source, whole);
        else
            walk = std::make_unique<Walk<max_parameters>>(source, whole);
    }

    /// Calls f(Walk<n>) with the smallest n that holds all parameters.
    template <class F>
    void with_walk(F&& f) const {
        std::visit([&](const auto& chosen) { f(*chosen); }, walk);
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
                               const Attached& attached, const WholeLightOptions& whole)
    : impl_(std::make_unique<Impl>(graph, scene, tangents, attached, whole)) {}
InteriorWalker::~InteriorWalker() = default;
InteriorWalker::InteriorWalker(InteriorWalker&&) noexcept = default;

bool InteriorWalker::touches(std::size_t path) const {
    return impl_->source.touches(path);
}

void InteriorWalker::walk(std::size_t path, std::size_t& edge, const OnRow& on_edge, const OnRow& on_seen) const {
    impl_->with_walk([&](auto&& walk) {
        walk.template path<false>(
            path, edge,
            [&](std::size_t k, const Rgb<double>&, const auto& change, const auto& length) {
                on_edge(impl_->row(k, change, length));
            },
            [&](std::size_t p, const Rgb<double>&, const auto& change, const auto& length) {
                on_seen(impl_->row(p, change, length));
            },
            nothing, nothing);
    });
}

void InteriorWalker::walk_all(std::size_t begin, std::size_t end, std::span<const std::uint8_t> touched,
                              RowWriter& edges, RowWriter& seen, PointWriter* points) const {
    const PathGraph& g = impl_->source.graph;
    const std::size_t n = impl_->source.tangents.n();
    std::size_t edge = first_light_edge(g, g.paths.first_vertex[begin]);
    const auto to = [n](RowWriter& rows) {
        return [n, &rows](std::size_t of, const Rgb<double>&, const auto& change, const auto& length) {
            *rows.row++ = std::uint32_t(of);
            for (std::size_t p = 0; p < n; ++p) {
                for (std::size_t c = 0; c < 3; ++c) *rows.dL++ = float(change.c[c].d[p]);
                *rows.dopl++ = float(length.d[p]);
            }
            ++rows.n;
        };
    };
    const auto to_points = [n, points](std::size_t edge, double to_light, const Rgb<double>& L, const auto& change,
                                       const auto& length) {
        *points->to_light++ = float(to_light);
        for (int c = 0; c < 3; ++c) *points->L++ = float(L[c]);
        RowWriter& rows = points->rows;
        *rows.row++ = std::uint32_t(edge);
        for (std::size_t p = 0; p < n; ++p) {
            for (std::size_t c = 0; c < 3; ++c) *rows.dL++ = float(change.c[c].d[p]);
            *rows.dopl++ = float(length.d[p]);
        }
        ++rows.n;
    };
    impl_->with_walk([&](auto& walk) {
        for (std::size_t path = begin; path < end; ++path)
            if (touched[path])
                walk.template path<false>(path, edge, to(edges), to(seen), nothing, to_points);
            else
                edge = next_path_edge(g, path, edge);
    });
}

void InteriorWalker::walk_exactly(std::size_t path, std::size_t& edge, const OnExactRow& on_edge,
                                  const OnExactRow& on_seen) const {
    const std::size_t n = impl_->source.tangents.n();
    std::vector<Rgb<double>> dL(n);
    const auto pass = [&](const OnExactRow& to, double to_light) {
        return [&, to_light](std::size_t of, const Rgb<double>& L, const auto& change, const auto& length) {
            for (std::size_t p = 0; p < n; ++p)
                for (int c = 0; c < 3; ++c) dL[p][c] = change.c[std::size_t(c)].d[p];
            to({of, L, dL, std::span(length.d).first(n), to_light});
        };
    };
    impl_->with_walk([&](auto&& walk) {
        walk.template path<false>(
            path, edge, pass(on_edge, -1), pass(on_seen, -1), nothing,
            [&](std::size_t of, double to_light, const auto&... x) { pass(on_edge, to_light)(of, x...); });
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
        walk.template path<true>(
            path, edge, no_row, no_row,
            [&](std::size_t j, const ShadingPoint& at, const Rgb<double>& beta, double opl, const auto& motion) {
                const Vec n(at.frame.n);
                for (std::size_t p = 0; p < impl_->velocity.size(); ++p) {
                    impl_->velocity[p] = motion.p(int(p));
                    impl_->turn[p] = cross(n, motion.ns(int(p))) + n * motion.twist.d[p];
                }
                if (j == g.paths.first_vertex[path]) camera_opl = opl;
                on_vertex({j, &at, beta, opl, camera_opl, impl_->velocity, impl_->turn});
            },
            nothing);
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
    if ((attached.any_slides() || scene.features.delta_lobes) &&
        (tangents.any_shape_moves() || tangents.camera_moves()))
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
