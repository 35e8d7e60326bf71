#include "stages/derive/temporal.h"

#include <tbb/enumerable_thread_specific.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <span>
#include <tuple>
#include <unordered_map>

#include "stages/core/compute/parallel.h"
#include "stages/core/graph/time_of_flight.h"
#include "stages/core/sampling/sampler.h"
#include "stages/core/scene/nlos.h"
#include "stages/derive/interior.h"
#include "stages/derive/surface_motion.h"

namespace loom::derive {
namespace {

using Vec = Vector3<double>;
using Pt = Point3<double>;

/// Points q with n . q > d.
struct HalfSpace {
    Vec n;
    double d;
    bool density_vanishes = false;  // towards the plane, as the cosine does

    HalfSpace() = default;
    HalfSpace(const Vec& normal, const Pt& on_plane, bool vanishes = false)
        : n(normal), d(dot(normal, Vec(on_plane))), density_vanishes(vanishes) {}
    double height(const Pt& q) const { return dot(n, Vec(q)) - d; }
};

/// A flat convex polygon of one shape.
struct Polygon {
    std::array<Pt, 4> corners;
    int n_corners = 3;
    Vec normal;  // unit
    std::uint32_t shape_idx = 0, primitive_idx = 0;
};

/// A neighbour of the sliding vertex.
struct Focus {
    Pt p;
    std::array<HalfSpace, 3> front;  // planes through it, in front of which light passes
    int n_front = 0;

    /// Adds the plane of a surface on whose side x lies; on either side of a surface that has none.
    void add_plane(const Vec& normal, const Pt& x, bool vanishes) {
        const double side = dot(normal, x - p);
        if (side != 0) front[std::size_t(n_front++)] = {side > 0 ? normal : -normal, p, vanishes};
    }
};

/// Proves that nothing is between a focus and a polygon. Keeps what it has proved.
class ClearSight {
  public:
    explicit ClearSight(const Scene& scene) : scene_(scene) {
        for (const Shape& shape : scene.shapes) boxes_.push_back(shape.bounds());
    }

    bool between(const Focus& focus, const Polygon& polygon) {
        Key key{};
        for (int c = 0; c < 3; ++c) key[std::size_t(c)] = focus.p[c];
        std::size_t n = 3;
        for (int i = 0; i < focus.n_front; ++i)
            for (int c = 0; c < 3; ++c) key[n++] = focus.front[std::size_t(i)].n[c];
        key[n] = double(polygon.shape_idx) + double(polygon.primitive_idx) * 0x1p-32;
        const auto found = known_.find(key);
        if (found != known_.end()) return found->second;
        if (known_.size() >= most_known) known_.clear();
        return known_[key] = prove(focus, polygon);
    }

  private:
    using Key = std::array<double, 13>;
    struct Hash {
        std::size_t operator()(const Key& key) const {
            std::uint64_t h = 0;
            for (const double x : key) {
                std::uint64_t bits;
                std::memcpy(&bits, &x, sizeof bits);
                h = mix64(h ^ bits);
            }
            return h;
        }
    };
    static constexpr std::size_t most_known = 1 << 14;
    static constexpr std::size_t most_triangles = 4096;  // of a shape that are tested one by one

    bool prove(const Focus& focus, const Polygon& polygon) {
        // The pyramid from the focus to the polygon, as half-spaces.
        planes_.assign(focus.front.begin(), focus.front.begin() + focus.n_front);
        Pt middle = polygon.corners[0], lo = focus.p, hi = focus.p;
        const int n = polygon.n_corners;
        for (int i = 1; i < n; ++i) middle = middle + (polygon.corners[std::size_t(i)] - middle) / double(i + 1);
        for (int i = 0; i < n; ++i)
            for (int c = 0; c < 3; ++c) {
                lo[c] = std::min(lo[c], polygon.corners[std::size_t(i)][c]);
                hi[c] = std::max(hi[c], polygon.corners[std::size_t(i)][c]);
            }
        const double size = length(hi - lo), height = dot(polygon.normal, focus.p - middle);
        if (!(std::abs(height) > 1e-7 * size)) return false;
        planes_.emplace_back(height > 0 ? polygon.normal : -polygon.normal, middle);
        for (int i = 0; i < n; ++i) {
            const Vec side =
                cross(polygon.corners[std::size_t(i)] - focus.p, polygon.corners[std::size_t((i + 1) % n)] - focus.p);
            const double area = length(side);
            if (!(area > 0)) return false;
            const Vec unit = side / area;
            planes_.emplace_back(dot(unit, middle - focus.p) > 0 ? unit : -unit, focus.p);
        }
        for (int c = 0; c < 3; ++c) {
            Vec axis;
            axis[c] = 1;
            planes_.emplace_back(axis, lo);
            planes_.emplace_back(-axis, hi);
        }
        const double tolerance = 1e-5 * size;
        for (std::size_t s = 0; s < scene_.shapes.size(); ++s)
            if (!is_outside(s, tolerance)) return false;
        return true;
    }

    bool is_outside(std::size_t shape_idx, double tolerance) const {
        const Shape& shape = scene_.shapes[shape_idx];
        const Box3f& box = boxes_[shape_idx];
        const auto is_behind = [&](const HalfSpace& h) {
            if (shape.kind == ShapeKind::sphere)
                return h.height(Pt(shape.round.center)) + double(shape.round.radius) <= tolerance;
            if (shape.kind == ShapeKind::disk)
                return h.height(Pt(shape.round.center)) +
                           std::hypot(dot(h.n, Vec(shape.round.u_axis)), dot(h.n, Vec(shape.round.v_axis))) <=
                       tolerance;
            double farthest = -h.d;
            for (int c = 0; c < 3; ++c) farthest += h.n[c] * double(h.n[c] > 0 ? box.hi[c] : box.lo[c]);
            return farthest <= tolerance;
        };
        if (std::any_of(planes_.begin(), planes_.end(), is_behind)) return true;
        if (shape.kind != ShapeKind::mesh || shape.triangles.size() > most_triangles) return false;
        return std::all_of(shape.triangles.begin(), shape.triangles.end(), [&](const TriangleRecord& t) {
            const Pt a(t.p0), b(t.p0 + t.e1), c(t.p0 + t.e2);
            return std::any_of(planes_.begin(), planes_.end(), [&](const HalfSpace& h) {
                return std::max({h.height(a), h.height(b), h.height(c)}) <= tolerance;
            });
        });
    }

    const Scene& scene_;
    std::vector<Box3f> boxes_;
    std::vector<HalfSpace> planes_;
    std::unordered_map<Key, bool, Hash> known_;
};

/// Part of the line x + s axis, and the kernel on it.
struct Chord {
    double begin = -INFINITY, end = INFINITY;
    bool begin_vanishes = false, end_vanishes = false;

    void clip(const HalfSpace& h, const Pt& x, const Vec& axis) {
        const double height = h.height(x), slope = dot(h.n, axis);
        if (slope > 0) {
            if (const double s = -height / slope; s > begin) begin = s, begin_vanishes = h.density_vanishes;
        } else if (slope < 0) {
            if (const double s = -height / slope; s < end) end = s, end_vanishes = h.density_vanishes;
        }
    }
    /// Kernel at s = 0: uniform, but linear towards ends where the density vanishes.
    double kernel() const {
        const double size = end - begin;
        if (begin_vanishes && end_vanishes) return 6 * -begin * end / (size * size * size);
        if (begin_vanishes) return 2 * -begin / (size * size);
        if (end_vanishes) return 2 * end / (size * size);
        return 1 / size;
    }
};

/// Sum of the distances from a point on a line to one or two foci.
class DistanceSum {
  public:
    DistanceSum(const Pt& x, const Vec& axis, std::span<const Focus> foci) : n_(foci.size() == 1 ? 1 : 2) {
        for (int i = 0; i < n_; ++i) {
            const Vec d = x - foci[std::size_t(i)].p;
            along_[std::size_t(i)] = dot(d, axis);
            square_[std::size_t(i)] = length2(d);
        }
    }
    double at(double s) const {
        double sum = 0;
        for (int i = 0; i < n_; ++i)
            sum += std::sqrt(std::max(s * s + 2 * s * along_[std::size_t(i)] + square_[std::size_t(i)], 0.0));
        return sum;
    }
    /// Returns where the sum is least.
    double lowest() const {
        if (n_ == 1) return -along_[0];
        const double h0 = std::sqrt(std::max(square_[0] - sqr(along_[0]), 0.0)),
                     h1 = std::sqrt(std::max(square_[1] - sqr(along_[1]), 0.0));
        return h0 + h1 > 0 ? -(along_[0] * h1 + along_[1] * h0) / (h0 + h1) : -along_[0];
    }
    /// Returns the two places where the sum is D.
    ///   |p| = (D + (|p|^2 - |q|^2) / D) / 2 = u + v s,   s^2 + 2 s a + r^2 = (u + v s)^2
    /// needs:   D >= the least sum, up to rounding
    std::array<double, 2> roots(double D) const {
        const double v = n_ == 1 ? 0 : (along_[0] - along_[1]) / D;
        const double u = n_ == 1 ? D : 0.5 * (D + (square_[0] - square_[1]) / D);
        const double a = 1 - v * v, b = along_[0] - u * v, c = square_[0] - u * u;
        const double root = std::sqrt(std::max(b * b - a * c, 0.0));
        return {(-b - root) / a, (-b + root) / a};
    }

  private:
    int n_;
    std::array<double, 2> along_{}, square_{};
};

/// A vertex that slides, with the light of its path as a function of its place.
struct Slide {
    Polygon polygon;
    Pt x;
    std::array<Focus, 2> foci;
    int n_foci = 1;
    double eta = 1;       // of the segments to the foci
    double rest_opl = 0;  // of all other segments, m
};

/// Whether a reflection is positive wherever both cosines are, by far.
bool is_broad(const Bsdf<float>& bsdf) {
    switch (bsdf.model->kind) {
        case BsdfKind::diffuse:
        case BsdfKind::rough_diffuse:
            return true;
        case BsdfKind::rough_plastic:
            return !is_black(bsdf.diffuse);
        case BsdfKind::rough_conductor:
            return bsdf.model->distribution == Microfacet::ggx && std::min(bsdf.alpha_u, bsdf.alpha_v) >= 0.3f;
        default:
            return false;
    }
}

/// Sums over a part of the paths of some pixels, by pixel and border.
struct Crossings {
    struct At {
        std::uint32_t pixel, border;
        bool operator<(const At& o) const { return std::tie(pixel, border) < std::tie(o.pixel, o.border); }
        bool operator==(const At& o) const { return pixel == o.pixel && border == o.border; }
    };
    std::vector<At> at;
    std::vector<double> sum, square;  // of the paths' flux   [row, parameter, rgb]
    std::vector<double> exact_energy, widened_energy;
};

class Lines {
  public:
    Lines(const PathGraph& graph, const Scene& scene, const SceneTangents& tangents, const Attached& attached,
          const TemporalBins& bins, const Derivative& derivative)
        : g_(graph),
          scene_(scene),
          tangents_(tangents),
          bins_(bins),
          d_(derivative),
          n_(tangents.n()),
          width_(3 * n_),
          reader_(graph),
          motions_(scene, tangents),
          walker_(graph, scene, tangents, attached),
          sight_(scene),
          of_path_((std::size_t(bins.n) + 1) * width_),
          is_touched_(std::size_t(bins.n) + 1),
          lengths_(graph, Timing{bins.camera_segment, {}}),
          rates_(n_),
          v_(n_) {
        for (const auto& effects : tangents.materials)
            for (const auto& [p, t] : effects) index_changes_ |= t.int_ior != 0;
    }

    /// Sums the samples [begin, end) of n pixels.
    /// in, out: is_exact  by interior row
    void add_pixels(std::size_t first_pixel, std::size_t n, std::uint64_t begin, std::uint64_t end,
                    std::span<std::uint8_t> is_exact, Crossings& out) {
        const std::size_t columns = of_path_.size();
        sum_.assign(n * columns, 0.0);
        square_.assign(n * columns, 0.0);
        out.exact_energy.assign(n_, 0.0);
        out.widened_energy.assign(n_, 0.0);
        for (std::uint64_t s = begin; s < end; ++s)
            for (std::size_t i = 0; i < n; ++i) {
                add_path(s * g_.n_pixels() + first_pixel + i, is_exact, out);
                for (const std::uint32_t k : touched_) {
                    for (std::size_t c = k * width_; c < (k + 1) * width_; ++c) {
                        sum_[i * columns + c] += of_path_[c];
                        square_[i * columns + c] += sqr(of_path_[c]);
                        of_path_[c] = 0;
                    }
                    is_touched_[k] = 0;
                }
                touched_.clear();
            }
        for (std::size_t i = 0; i < n; ++i)
            for (std::uint32_t k = 0; k <= bins_.n; ++k) {
                const double *sum = &sum_[i * columns + k * width_], *square = &square_[i * columns + k * width_];
                if (std::all_of(square, square + width_, [](double x) { return x == 0; })) continue;
                out.at.push_back({std::uint32_t(first_pixel + i), k});
                out.sum.insert(out.sum.end(), sum, sum + width_);
                out.square.insert(out.square.end(), square, square + width_);
            }
    }

  private:
    /// A vertex of the path in work.
    struct Vertex {
        std::size_t j;
        ShadingPoint at;
        Rgb<double> beta;
        double opl;  // from where lengths count
        std::vector<Vec> velocity;
    };

    void add_path(std::size_t path, std::span<std::uint8_t> is_exact, Crossings& out) {
        const auto [begin, end] = vertices_of(g_, path);
        add_seen(path, begin, end, out);
        if (begin == end) return;
        const std::size_t first = first_light_edge(g_, begin);
        const auto& edges = d_.interior.edge;
        std::size_t row = std::size_t(std::lower_bound(edges.begin(), edges.end(), first) - edges.begin());
        const auto is_of_path = [&] { return row < edges.size() && g_.light_edges.vertex[edges[row]] < end; };
        if (!is_of_path()) return;
        collect_vertices(path);
        for (; is_of_path(); ++row) {
            const std::size_t k = edges[row];
            const float* dopl = &d_.interior.dopl[row * n_];
            if (std::all_of(dopl, dopl + n_, [](float x) { return x == 0; })) continue;
            const Vertex& x = vertices_[g_.light_edges.vertex[k] - begin];
            const Rgb<double> L = x.beta * Rgb<double>(light(x, k));
            const bool exact = add_edge(k, g_.light_edges.vertex[k] - begin, dopl);
            is_exact[row] = exact ? 1 : 0;
            add_energy(luminance(L), dopl, exact ? out.exact_energy : out.widened_energy);
        }
    }

    void add_seen(std::size_t path, std::size_t begin, std::size_t end, Crossings& out) const {
        const auto& paths = d_.seen.path;
        const auto found = std::lower_bound(paths.begin(), paths.end(), path);
        if (begin == end || found == paths.end() || *found != path) return;
        add_energy(luminance(Rgb<double>(rgb(g_.paths.Le, path))),
                   &d_.seen.dopl[std::size_t(found - paths.begin()) * n_], out.widened_energy);
    }
    void add_energy(double light, const float* dopl, std::vector<double>& energy) const {
        for (std::size_t p = 0; p < n_; ++p) energy[p] += std::abs(light * double(dopl[p]));
    }

    void collect_vertices(std::size_t path) {
        n_vertices_ = 0;
        double opl = 0;
        walker_.walk_vertices(path, [&](const VertexState& state) {
            if (n_vertices_ == vertices_.size()) vertices_.emplace_back();
            Vertex& v = vertices_[n_vertices_];
            opl += n_vertices_ == 0
                       ? lengths_.from_camera(path)
                       : lengths_.to_vertex(state.vertex, position<double>(g_, vertices_[n_vertices_ - 1].j));
            v.j = state.vertex;
            v.at = *state.at;
            v.beta = state.beta;
            v.opl = opl;
            v.velocity.assign(state.velocity.begin(), state.velocity.end());
            ++n_vertices_;
        });
    }

    /// f cos Li w / pdf of a light edge.
    Spectrum light(const Vertex& x, std::size_t k) const { return own_light(reader_, x.at, x.j, k); }

    /// Adds the line samples of light edge k, of vertex i of the path. Returns false where they do not apply.
    bool add_edge(std::size_t k, std::size_t i, const float* dopl) {
        const auto& e = g_.light_edges;
        if (index_changes_ || e.y[4 * k + 3] == 0) return false;
        // Lengths that do not count must not change.
        if (!bins_.camera_segment) {
            const auto& v = vertices_[0].velocity;
            if (tangents_.camera_moves() || std::any_of(v.begin(), v.end(), [](const Vec& w) { return !(w == Vec{}); }))
                return false;
        }
        const Lobe lobe = Lobe(g_.vertices.lobe[vertices_[i].j]);
        const bool next_event = LightTechnique(e.technique[k]) == LightTechnique::next_event;
        if (!next_event && is_delta(lobe)) return false;
        if (!is_broad(vertices_[i].at.bsdf)) return false;
        switch (EmitterKind(g_.emitters.kind[e.emitter[k]])) {
            case EmitterKind::area:
                return slide_light_point(k, vertices_[i], next_event, dopl);
            case EmitterKind::point:
            case EmitterKind::laser_spot:
                return i > 0 && slide_vertex(k, vertices_[i - 1], vertices_[i], dopl);
            default:
                return false;
        }
    }

    // ---- A vertex between another one and a delta light.

    /// in:      a  the vertex before x
    bool slide_vertex(std::size_t k, const Vertex& a, const Vertex& x, const float* dopl) {
        const auto& e = g_.light_edges;
        const Lobe lobe = Lobe(g_.vertices.lobe[a.j]);
        const std::uint32_t material = g_.vertices.material[x.j];
        if (is_delta(lobe) || lobe == Lobe::null || !is_broad(a.at.bsdf)) return false;
        if (scene_.materials[material].textured() || x.at.perturbed) return false;
        if (!tangents_.emitters[e.emitter[k]].empty()) return false;
        const bool spot = EmitterKind(g_.emitters.kind[e.emitter[k]]) == EmitterKind::laser_spot;
        if (spot && !is_diffuse_spot()) return false;
        const double eta = g_.vertices.eta.empty() ? 1 : double(g_.vertices.eta[x.j]);
        if (eta != (e.eta.empty() ? 1 : double(e.eta[k]))) return false;

        Slide slide;
        slide.x = position<double>(g_, x.j);
        const std::uint32_t* primitive = g_.vertices.primitive.empty() ? nullptr : &g_.vertices.primitive[x.j];
        if (!find_polygon(g_.vertices.shape[x.j], primitive, slide.x, slide.polygon)) return false;
        const Pt from = position<double>(g_, a.j), y{e.y[4 * k], e.y[4 * k + 1], e.y[4 * k + 2]};
        slide.n_foci = 2;
        slide.foci[0] = front_of(a.at, from, slide.x, true);
        slide.foci[1].p = y;
        const Vec n_spot = spot ? Vec(unit_vector<Normal3f>(e.n, k)) : Vec{};
        if (spot) slide.foci[1].add_plane(n_spot, slide.x, false);
        if (!sight_.between(slide.foci[0], slide.polygon) || !sight_.between(slide.foci[1], slide.polygon))
            return false;
        slide.eta = eta;
        slide.rest_opl = x.opl + lengths_.to_light(k, slide.x) - eta * (length(slide.x - from) + length(slide.x - y));

        // What does not change with the place.
        const Vec nx = slide.polygon.normal;
        const auto geometry = [&](const Pt& z) {
            const Vec d = z - from;
            const double r2 = length2(d);
            return std::abs(dot(nx, d)) / (r2 * std::sqrt(r2));
        };
        const auto of_light = [&](const Pt& z) {
            const Vec d = z - y;
            const double r2 = length2(d);
            return spot ? std::abs(dot(n_spot, d)) / (r2 * std::sqrt(r2)) : 1 / r2;
        };
        const Rgb<double> scale =
            a.beta * Rgb<double>(rgb(e.Li, k)) *
            (1 / (double(g_.vertices.pdf_w[a.j]) * geometry(slide.x) * double(e.pdf_nee_w[k]) * of_light(slide.x)));
        rest_rates(a, x.velocity, slide, dopl);
        ShadingPoint at = x.at;
        return add_lines(
            slide,
            [&](const Pt& z) {
                at.p = Point3f(z);
                at.wo = Vector3f(normalize(from - z));
                at.wo_local = at.frame.to_local(at.wo);
                const Spectrum f = f_cos_pdf(a.at, -at.wo).f_cos * f_cos_pdf(at, Vector3f(normalize(y - z))).f_cos;
                return scale * Rgb<double>(f) * (geometry(z) * of_light(z));
            },
            [&](const Pt& z) {
                const Vec u = normalize(z - from), w = normalize(y - z);
                material_velocity(slide.polygon, z);
                for (std::size_t p = 0; p < n_; ++p)
                    rates_[p] = rest_rates_[p] + slide.eta * (dot(u, v_[p] - a.velocity[p]) - dot(w, v_[p]));
            });
    }

    /// Whether the laser spot reflects alike in all directions, so that its light changes with a cosine alone.
    bool is_diffuse_spot() const {
        if (!scene_.nlos || scene_.nlos->laser_points.empty() || !scene_.nlos->laser_points[0].hit) return false;
        const std::uint32_t shape = scene_.nlos->laser_points[0].hit.shape_idx;
        return scene_.materials[scene_.shapes[shape].material_idx].model.kind == BsdfKind::diffuse &&
               !tangents_.moves(shape);
    }

    // ---- A point on an area light.

    bool slide_light_point(std::size_t k, const Vertex& x, bool next_event, const float* dopl) {
        const auto& e = g_.light_edges;
        const Emitter& emitter = scene_.emitters[e.emitter[k]];
        if (emitter.texture_idx >= 0) return false;
        if (emitter.parallelogram && !tangents_.vertices[emitter.shape_idx].empty()) return false;
        Slide slide;
        slide.x = {e.y[4 * k], e.y[4 * k + 1], e.y[4 * k + 2]};
        if (!find_polygon(emitter.shape_idx, nullptr, slide.x, slide.polygon)) return false;
        if (emitter.parallelogram) complete(slide.polygon);
        const Pt from = position<double>(g_, x.j);
        slide.foci[0] = front_of(x.at, from, slide.x, false);
        if (!sight_.between(slide.foci[0], slide.polygon)) return false;
        slide.eta = e.eta.empty() ? 1 : double(e.eta[k]);
        slide.rest_opl = x.opl;

        const Vec ny = slide.polygon.normal;
        const auto geometry = [&](const Pt& z) {
            const Vec d = z - from;
            const double r2 = length2(d);
            return std::abs(dot(ny, d)) / (r2 * std::sqrt(r2));
        };
        const double pdf_w = double(next_event ? e.pdf_nee_w[k] : g_.vertices.pdf_w[x.j]);
        const double weight = double(mis_weight(next_event, e.pdf_nee_w[k], e.pdf_bsdf_w[k], Heuristic::power)) / pdf_w;
        const Rgb<double> scale = x.beta * Rgb<double>(rgb(e.Li, k)) * (weight / geometry(slide.x));
        rest_rates(x, light_velocity(slide), slide, dopl);
        return add_lines(
            slide,
            [&](const Pt& z) {
                return scale * Rgb<double>(f_cos_pdf(x.at, Vector3f(normalize(z - from))).f_cos) * geometry(z);
            },
            [&](const Pt& z) {
                const Vec u = normalize(z - from);
                material_velocity(slide.polygon, z);
                for (std::size_t p = 0; p < n_; ++p)
                    rates_[p] = rest_rates_[p] + slide.eta * dot(u, v_[p] - x.velocity[p]);
            });
    }
    const std::vector<Vec>& light_velocity(const Slide& slide) {
        material_velocity(slide.polygon, slide.x);
        return v_;
    }

    // ---- Both.

    /// Sets rest_rates_: opl' of all segments but those of the sliding vertex.
    /// in:      a         first focus
    ///          velocity  of the sliding vertex
    void rest_rates(const Vertex& a, const std::vector<Vec>& velocity, const Slide& slide, const float* dopl) {
        rest_rates_.resize(n_);
        const Vec u = normalize(slide.x - slide.foci[0].p);
        for (std::size_t p = 0; p < n_; ++p) {
            rest_rates_[p] = double(dopl[p]) - slide.eta * dot(u, velocity[p] - a.velocity[p]);
            if (slide.n_foci == 2) rest_rates_[p] += slide.eta * dot(normalize(slide.foci[1].p - slide.x), velocity[p]);
        }
    }

    /// A vertex as a focus: the planes of all its normals.
    static Focus front_of(const ShadingPoint& at, const Pt& p, const Pt& x, bool vanishes) {
        Focus focus;
        focus.p = p;
        focus.add_plane(Vec(at.frame.n), x, vanishes);
        if (!(at.ng == at.frame.n)) focus.add_plane(Vec(at.ng), x, false);
        if (at.perturbed) focus.add_plane(Vec(at.n_side), x, false);
        return focus;
    }

    /// Finds the triangle of a flat shape that contains a point.
    /// in:      primitive  its index, where it is known
    bool find_polygon(std::uint32_t shape_idx, const std::uint32_t* primitive, const Pt& p, Polygon& polygon) const {
        constexpr std::size_t most_triangles = 256;
        const Shape& shape = scene_.shapes[shape_idx];
        if (shape.kind != ShapeKind::mesh || !shape.mesh.normals.empty()) return false;
        polygon.shape_idx = shape_idx;
        if (primitive) {
            polygon.primitive_idx = *primitive;
        } else {
            if (shape.triangles.size() > most_triangles) return false;
            double least = INFINITY;
            for (std::size_t i = 0; i < shape.triangles.size(); ++i) {
                const double distance = outside(shape.triangles[i], p);
                if (distance < least) least = distance, polygon.primitive_idx = std::uint32_t(i);
            }
        }
        const TriangleRecord& t = shape.triangles[polygon.primitive_idx];
        const Pt p0(t.p0);
        const Vec e1(t.e1), e2(t.e2), n = cross(e1, e2);
        if (!(length2(n) > 0)) return false;
        polygon.n_corners = 3;
        polygon.corners = {p0, p0 + e1, p0 + e2, p0};
        polygon.normal = normalize(n);
        return true;
    }
    /// How far a point is from a triangle, in sizes of it: by its barycentric coordinates and its height.
    static double outside(const TriangleRecord& t, const Pt& p) {
        const Vec e1(t.e1), e2(t.e2), n = cross(e1, e2), d = p - Pt(t.p0);
        const double n2 = length2(n);
        if (!(n2 > 0)) return INFINITY;
        const double u = dot(cross(d, e2), n) / n2, v = dot(cross(e1, d), n) / n2;
        return std::max({-u, -v, u + v - 1, 0.0}) + std::abs(dot(d, n)) / std::pow(n2, 0.75);
    }
    /// Makes the parallelogram of which a triangle is the first or second half.
    void complete(Polygon& polygon) const {
        const TriangleRecord& t = scene_.shapes[polygon.shape_idx].triangles[0];
        const Pt p0(t.p0);
        const Vec e1(t.e1), e2(t.e2);
        polygon.primitive_idx = 0;
        polygon.n_corners = 4;
        polygon.corners = {p0, p0 + e1, p0 + e2, p0 + (e2 - e1)};
    }

    /// Sets v_: velocity of a material point.
    void material_velocity(const Polygon& polygon, const Pt& z) {
        std::fill(v_.begin(), v_.end(), Vec{});
        for (const auto& [p, v] : tangents_.shapes[polygon.shape_idx]) v_[p] = v_[p] + v.at(z);
        const auto& vertices = tangents_.vertices[polygon.shape_idx];
        if (vertices.empty()) return;
        const std::uint32_t* i = &scene_.shapes[polygon.shape_idx].mesh.indices[3 * std::size_t(polygon.primitive_idx)];
        const Point2<double> b = motions_.barycentric_of(polygon.shape_idx, polygon.primitive_idx, z);
        const double weight[3] = {1 - b.x - b.y, b.x, b.y};
        for (int corner = 0; corner < 3; ++corner)
            for (const auto& [p, v] : vertices[i[corner]]) v_[p] = v_[p] + v * weight[corner];
    }

    /// Adds all roots along both axes.
    /// in:      light(z)      F(z) / p(x) without opl'
    ///          set_rates(z)  sets rates_ to opl' at z
    template <class Light, class SetRates>
    bool add_lines(const Slide& slide, Light&& light, SetRates&& set_rates) {
        const Polygon& polygon = slide.polygon;
        const std::span foci(slide.foci.data(), std::size_t(slide.n_foci));
        const Vec first = normalize(polygon.corners[1] - polygon.corners[0]);
        const Vec axes[2] = {first, cross(polygon.normal, first)};
        for (int a = 0; a < 2; ++a) {
            // The line within the polygon and in front of the neighbours.
            Chord chord;
            for (int i = 0; i < polygon.n_corners; ++i) {
                const Pt& p = polygon.corners[std::size_t(i)];
                const Vec edge = polygon.corners[std::size_t((i + 1) % polygon.n_corners)] - p;
                chord.clip({cross(polygon.normal, edge), p}, slide.x, axes[a]);
            }
            for (const Focus& focus : foci)
                for (int i = 0; i < focus.n_front; ++i) chord.clip(focus.front[std::size_t(i)], slide.x, axes[a]);
            if (!(chord.begin < 0 && chord.end > 0)) continue;

            // The borders that it meets.
            const DistanceSum distance(slide.x, axes[a], foci);
            const double at_begin = distance.at(chord.begin), at_end = distance.at(chord.end),
                         lowest = distance.at(std::clamp(distance.lowest(), chord.begin, chord.end));
            const auto border_after = [&](double d) {
                return (slide.rest_opl + slide.eta * d - bins_.start) / bins_.width;
            };
            const double k_begin = std::max(std::ceil(border_after(lowest)), 0.0),
                         k_end = std::min(std::floor(border_after(std::max(at_begin, at_end))), double(bins_.n));
            const double kernel = chord.kernel();
            for (double k = k_begin; k <= k_end; ++k) {
                const double D = (bins_.start + k * bins_.width - slide.rest_opl) / slide.eta;
                for (const double s : distance.roots(D)) {
                    if (!(s > chord.begin && s < chord.end)) continue;
                    const Pt z = slide.x + axes[a] * s;
                    Vec gradient;
                    for (const Focus& focus : foci) gradient = gradient + normalize(z - focus.p) * slide.eta;
                    const double along = std::abs(dot(gradient, axes[a])),
                                 square = sqr(dot(gradient, axes[0])) + sqr(dot(gradient, axes[1]));
                    if (!(square > 0)) continue;
                    set_rates(z);
                    add(std::uint32_t(k), light(z) * (kernel * along / square));
                }
            }
        }
        return true;
    }
    void add(std::uint32_t border, const Rgb<double>& light) {
        if (!is_touched_[border]) is_touched_[border] = 1, touched_.push_back(border);
        double* to = &of_path_[border * width_];
        for (std::size_t p = 0; p < n_; ++p)
            for (int c = 0; c < 3; ++c) *to++ += light[c] * rates_[p];
    }

    const PathGraph& g_;
    const Scene& scene_;
    const SceneTangents& tangents_;
    const TemporalBins& bins_;
    const Derivative& d_;
    std::size_t n_, width_;
    GraphReader reader_;
    SurfaceMotions motions_;
    InteriorWalker walker_;
    ClearSight sight_;
    std::vector<double> of_path_, sum_, square_;  // [pixel, border, parameter, rgb]
    std::vector<std::uint8_t> is_touched_;
    std::vector<std::uint32_t> touched_;
    OpticalLengths lengths_;
    bool index_changes_ = false;
    std::vector<Vertex> vertices_;
    std::size_t n_vertices_ = 0;
    std::vector<double> rates_, rest_rates_;
    std::vector<Vec> v_;
};

/// Rows of temporal/ in work.
struct Rows {
    std::vector<std::uint32_t> pixel, border;
    std::vector<float> flux, var_mean;

    /// Adds the rows of pixels whose samples are in several parts.
    void add(std::span<const Crossings> parts, std::size_t width, double n_samples) {
        struct Source {
            Crossings::At at;
            const double *sum, *square;
        };
        std::vector<Source> sources;
        for (const Crossings& part : parts)
            for (std::size_t i = 0; i < part.at.size(); ++i)
                sources.push_back({part.at[i], &part.sum[i * width], &part.square[i * width]});
        std::stable_sort(sources.begin(), sources.end(), [](const Source& a, const Source& b) { return a.at < b.at; });
        for (std::size_t i = 0, end; i < sources.size(); i = end) {
            end = i + 1;
            while (end < sources.size() && sources[end].at == sources[i].at) ++end;
            pixel.push_back(sources[i].at.pixel);
            border.push_back(sources[i].at.border);
            for (std::size_t c = 0; c < width; ++c) {
                double sum = 0, square = 0;
                for (std::size_t j = i; j < end; ++j) sum += sources[j].sum[c], square += sources[j].square[c];
                const double mean = sum / n_samples;
                flux.push_back(float(mean));
                var_mean.push_back(
                    n_samples > 1 ? float(std::max(square / n_samples - mean * mean, 0.0) / (n_samples - 1)) : 0.0f);
            }
        }
    }
};

}  // namespace

void differentiate_temporal(const PathGraph& graph, const Scene& scene, const SceneTangents& tangents,
                            const Attached& attached, const TemporalBins& bins, int threads, app::Report& report,
                            Derivative& derivative) {
    const std::size_t n = tangents.n(), n_pixels = graph.n_pixels();
    const std::uint64_t n_samples = graph.tracing.samples_per_pixel;
    // Parts of pixels, and of their samples where there are few pixels; for any number of threads the same.
    const std::size_t pixel_bytes = (std::size_t(bins.n) + 1) * 3 * n * 2 * sizeof(double);
    const std::size_t chunk = std::clamp<std::size_t>((std::size_t(4) << 20) / pixel_bytes, 1, 256);
    const std::size_t n_chunks = (n_pixels + chunk - 1) / chunk;
    const std::size_t n_blocks = std::clamp<std::uint64_t>(64 / n_chunks, 1, (n_samples + 1023) / 1024);
    std::vector<Crossings> parts(n_chunks * n_blocks);
    std::vector<std::uint8_t> is_exact(derivative.interior.edge.size());
    app::Progress progress(report, "borders of bins", parts.size());
    tbb::enumerable_thread_specific<Lines> workers(
        [&] { return Lines(graph, scene, tangents, attached, bins, derivative); });
    parallel_chunks(parts.size(), 1, threads, [&](std::uint64_t i, std::uint64_t, std::uint64_t) {
        const std::size_t first = i / n_blocks * chunk, block = i % n_blocks;
        workers.local().add_pixels(first, std::min(chunk, n_pixels - first), n_samples * block / n_blocks,
                                   n_samples * (block + 1) / n_blocks, is_exact, parts[i]);
        progress.add(1);
    });

    auto& window = derivative.temporal_bins;
    window.start_opl = std::vector<double>{bins.start};
    window.width_opl = std::vector<double>{bins.width};
    window.n = std::vector<std::uint32_t>{bins.n};
    window.camera_segment = std::vector<std::uint8_t>{std::uint8_t(bins.camera_segment)};
    std::vector<double> exact(n), widened(n);
    for (const Crossings& part : parts)
        for (std::size_t p = 0; p < n; ++p) {
            exact[p] += part.exact_energy[p];
            widened[p] += part.widened_energy[p];
        }
    window.exact_energy = std::move(exact);
    window.widened_energy = std::move(widened);
    Rows rows;
    for (std::size_t c = 0; c < n_chunks; ++c)
        rows.add(std::span(parts).subspan(c * n_blocks, n_blocks), 3 * n, double(n_samples));
    auto& t = derivative.temporal;
    t.is_exact = std::move(is_exact);
    t.pixel = std::move(rows.pixel);
    t.border = std::move(rows.border);
    t.flux = std::move(rows.flux);
    t.var_mean = std::move(rows.var_mean);
}

}  // namespace loom::derive
