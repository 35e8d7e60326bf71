// Family 3: from a stored vertex, the edges in front of surfaces and of an environment; the light beside the edge by a
// path of its own.
//   sum over visible silhouettes of beta f_cos(omega) L(x_L -> x_S) swept / r_B^2 dl_B

#include <tbb/enumerable_thread_specific.h>

#include <algorithm>

#include "stages/core/app/report.h"
#include "stages/core/compute/parallel.h"
#include "stages/core/edges/boundary.h"
#include "stages/core/sampling/streams.h"
#include "stages/core/scene/media.h"
#include "stages/derive/given_rays.h"
#include "stages/derive/interior.h"
#include "stages/derive/outline.h"

namespace loom::derive {
namespace {

using Vec = Vector3<double>;
using Pt = Point3<double>;

/// A sample whose light beside the edge is yet to be traced.
struct Pending {
    std::uint64_t path = 0;
    Rgb<double> value;  // all but the light and the rate
    double opl = 0;     // up to the vertex
    Pt x_s;
    OutlinePoint b;
    std::vector<Vec> v_s, v_b;
};

class Sampling {
  public:
    Sampling(const BoundaryScene& s, double share, bool surfaces, bool environment)
        : s_(s),
          share_(share),
          surfaces_(surfaces),
          environment_(environment),
          outline_(s),
          walker_(s.graph, s.scene, s.tangents),
          light_(s, streams::family(s.options.seed, 3)),
          v_light_(s.n()),
          rates_(s.n()) {}

    std::uint64_t n_samples = 0, n_rays() const { return light_.n_rays; }

    void sample_path(std::size_t path, BoundaryRows& rows) {
        const std::size_t first = s_.graph.paths.first_vertex[path];
        MediumStack media;
        if (s_.graph.n_vertices() > first && s_.scene.features.dielectric)
            media = s_.scene.sensor_media.at(s_.scene, camera_origin(s_.graph, path));
        walker_.walk_vertices(path, [&](const VertexState& x) {
            const Sampler sampler(SamplerKind::independent, streams::family(s_.options.seed, 5), x.vertex, 0);
            const auto flags = s_.graph.vertices.flags[x.vertex];
            if ((flags & vertex_flag::attempted_bsdf) && has_smooth_lobe(x.at->bsdf) &&
                double(sampler.pair(0).x) < share_) {
                ++n_samples;
                sample_vertex(x, path, int(x.vertex - first), media, sampler);
                if (pending_.size() == PathBatch::capacity) finish(rows);
            }
            if (s_.scene.features.dielectric && (flags & vertex_flag::continued)) follow(x, media);
        });
    }

    /// Traces the light of the samples so far.
    void finish(BoundaryRows& rows) {
        light_.trace(rays_, [&](std::size_t i, const PathGraph& g, std::size_t& edge) {
            const Pending& p = pending_[i];
            const std::size_t begin = g.paths.first_vertex[i], end = g.paths.first_vertex[i + 1];
            const bool escaped = begin == end;
            if (escaped) {
                // Its direction turns about the vertex.
                const auto e = std::size_t(std::max(s_.scene.environment_idx, 0));
                if (environment_ && s_.scene.environment_idx >= 0) {
                    s_.emitter_velocity(e, Pt(p.b.omega), v_light_);
                    set_rates(p, 0, p.b.r);
                }
                light_.walk(i, edge, [&](const Spectrum& L, double) {
                    if (environment_) add(p, Rgb<double>(L), -1, rows);
                });
                return;
            }
            const std::uint32_t shape = g.vertices.shape[begin];
            const Pt x_l = position<double>(g, begin);
            const double r = length(x_l - p.x_s);
            const bool beside = r > p.b.r * (1 - 1e-6) && surfaces_;
            if (beside) {
                s_.shape_velocity(shape, g.vertices.primitive[begin], x_l, v_light_);
                set_rates(p, p.b.r / r, 1);
            }
            // Emission at the first hit belongs to the family of emitters.
            bool emitted_first = !is_black(rgb(g.paths.Le, i));
            light_.walk(i, edge, [&](const Spectrum& L, double opl) {
                if (std::exchange(emitted_first, false)) return;
                if (beside) add(p, Rgb<double>(L), opl, rows);
            });
        });
        pending_.clear();
        rays_.clear();
    }

  private:
    void sample_vertex(const VertexState& x, std::size_t path, int depth, const MediumStack& arriving,
                       const Sampler& sampler) {
        const ShadingPoint& at = *x.at;
        const int max_depth = s_.graph.tracing.max_depth;
        const int edge_number = depth + 2;
        if (max_depth >= 0 && (edge_number > max_depth || (edge_number == max_depth && !environment_))) return;
        const bool interface = is_interface(*at.bsdf.model);
        const float hit_error = s_.scene.shapes[s_.graph.vertices.shape[x.vertex]].hit_error;
        const RayEnd from{at.p, interface ? Normal3f{} : facing(at.ng, at.wo), hit_error};
        Pending p;
        p.x_s = Pt(at.p);
        // What lies behind an edge may move although neither the edge nor the vertex does.
        if (!outline_.collect(Shaft::to_infinity(from), p.x_s, false, x.velocity, s_.all_edges, true)) return;
        if (!outline_.sample(sampler.pair(1), p.b)) return;
        const Vector3f wi(p.b.omega);
        const Spectrum f_cos = f_cos_pdf(at, wi).f_cos;
        if (is_black(f_cos)) return;
        p.path = path;
        p.opl = x.opl;
        p.value = x.beta * Rgb<double>(f_cos) *
                  Rgb<double>(1 / (p.b.r * p.b.r * p.b.density * share_ * double(s_.graph.tracing.samples_per_pixel)));
        p.v_s.assign(x.velocity.begin(), x.velocity.end());
        p.v_b.assign(outline_.velocity().begin(), outline_.velocity().end());
        const Vec beside = p.b.omega + p.b.out * (s_.clearance(p.b.p, p.b.r) / (length(p.b.out) * p.b.r));
        const Vector3f d(normalize(beside));
        MediumStack media = arriving;
        if (interface && dot(at.n_side, d) * dot(at.n_side, at.wo) < 0)
            media.pass(surface(x.vertex), dot(at.n_side, d) < 0, *at.bsdf.model);
        rays_.push_back({spawn_ray({at.p, at.ng, hit_error}, d), {x.vertex, 0}, media, edge_number});
        pending_.push_back(std::move(p));
    }

    SurfaceIdx surface(std::size_t vertex) const {
        return {s_.graph.vertices.shape[vertex], s_.graph.vertices.material[vertex]};
    }
    /// Moves the media past a vertex that the path crosses.
    void follow(const VertexState& x, MediumStack& media) const {
        const Lobe lobe = Lobe(s_.graph.vertices.lobe[x.vertex]);
        if (lobe != Lobe::delta_transmission && lobe != Lobe::glossy_transmission) return;
        const Vector3f wi = x.at->frame.to_local(continuation_direction(s_.graph, x.vertex));
        media.pass(surface(x.vertex), wi.z < 0, *x.at->bsdf.model);
    }

    /// in:      share  |x_S x_B| / |x_S x_L|; scale  of the far velocity
    void set_rates(const Pending& p, double share, double scale) {
        for (std::size_t k = 0; k < s_.n(); ++k) {
            const Vec v_rel = share > 0 ? relative_velocity(share, p.v_b[k], p.v_s[k], v_light_[k])
                                        : p.v_b[k] - p.v_s[k] - v_light_[k] * scale;
            rates_[k] = swept(p.b.out, v_rel);
        }
    }
    void add(const Pending& p, const Rgb<double>& L, double opl, BoundaryRows& rows) {
        if (std::all_of(rates_.begin(), rates_.end(), [](double r) { return r == 0; })) return;
        const bool arrives = opl >= 0 && std::isfinite(opl);
        rows.add(p.path % s_.graph.n_pixels(), arrives ? p.opl + opl : -1, p.value * L, rates_,
                 BoundaryFamily::indirect, p.path);
    }

    const BoundaryScene& s_;
    double share_;
    bool surfaces_, environment_;
    Outline outline_;
    InteriorWalker walker_;
    RayLight light_;
    std::vector<Vec> v_light_;
    std::vector<double> rates_;
    std::vector<Pending> pending_;
    std::vector<GivenRay> rays_;
};

}  // namespace

std::uint64_t add_indirect(const BoundaryScene& s, double share, bool surfaces, bool environment,
                           std::vector<BoundaryRows>& rows, std::span<std::uint64_t> samples, app::Report& report) {
    constexpr std::uint64_t chunk = 16384;
    const std::size_t first = rows.size();
    const std::uint64_t n_paths = s.graph.n_paths();
    rows.resize(first + (n_paths + chunk - 1) / chunk, BoundaryRows(s.options.adjoint));
    app::Progress progress(report, "edges in front of surfaces", n_paths);
    tbb::enumerable_thread_specific<Sampling> workers(
        [&] { return Sampling(s, std::min(share, 1.0), surfaces, environment); });
    parallel_chunks(n_paths, chunk, s.options.threads, [&](std::uint64_t i, std::uint64_t begin, std::uint64_t end) {
        Sampling& worker = workers.local();
        for (std::size_t path = begin; path < end; ++path) worker.sample_path(path, rows[first + i]);
        worker.finish(rows[first + i]);
        progress.add(end - begin);
    });
    std::uint64_t rays = 0;
    for (const Sampling& worker : workers) {
        rays += worker.n_rays();
        samples[std::size_t(BoundaryFamily::indirect)] += worker.n_samples;
    }
    return rays;
}

}  // namespace loom::derive
