#include "stages/residual/dynamic/dynamic_path.h"

namespace loom::residual {
namespace {

double cosine(const Normal3f& n, const Vector3f& d) {
    return std::abs(double(dot(n, d)));
}

}  // namespace

bool FullPath::dynamic() const {
    return light.changed ||
           std::any_of(vertices.begin(), vertices.end(), [](const Interaction& x) { return x.site != no_site; }) ||
           std::any_of(segments.begin(), segments.end(), [](const Segment& s) { return s.n > 0; });
}

Vector3f direction_to(const LightEnd& light, const Point3f& from) {
    return light.at_infinity ? Vector3f(light.y) : normalize(light.y - from);
}

Ray shadow_ray(const Vertex& v, const LightEnd& light) {
    return light.at_infinity ? spawn_ray(v.at.end(), Vector3f(light.y)) : spawn_segment(v.at.end(), light.end());
}

Segment segment_between(const DynamicScene& side, const Vertex& s, const Vertex& l, Crossings& crossings) {
    const Vector3f d = normalize(l.at.p - s.at.p);
    const auto first = std::uint32_t(crossings.all.size());
    return {std::abs(dot(s.at.ng, d)), std::abs(dot(l.at.ng, d)), first,
            side.cross(spawn_segment(s.at.end(), l.at.end()), crossings)};
}

Segment segment_to_light(const DynamicScene& side, const Vertex& v, const LightEnd& light, Crossings& crossings) {
    const auto first = std::uint32_t(crossings.all.size());
    return {std::abs(dot(v.at.ng, direction_to(light, v.at.p))), 1, first, side.cross(shadow_ray(v, light), crossings)};
}

bool scatters_on_both_sides(const Scene& scene, const ShadingPoint& here, const Vertex& vertex) {
    const BsdfModel& model = *here.bsdf.model;
    return model.two_sided || scene.materials[scene.shapes[vertex.hit.shape_idx].material_idx].back_idx >= 0 ||
           here.bsdf.opacity < 1 || model.kind == BsdfKind::dielectric || model.kind == BsdfKind::thin_dielectric ||
           model.kind == BsdfKind::rough_dielectric || model.kind == BsdfKind::null;
}

Interaction interact(const DynamicScene& side, const Vertex& vertex, const Vector3f& to_sensor,
                     const Vector3f& to_light, Lobe lobe) {
    Interaction x;
    x.site = vertex.site;
    ShadingPoint here = side.aimed(vertex, to_sensor);
    x.q_light = survival(here);
    // Convert to one measure for both directions: d_omega_light / d_omega_sensor of a perfectly specular lobe.
    double projected = 1;
    if (is_delta(lobe)) {
        x.specular = true;
        const DeltaLobe<float> forward = delta_lobe(here.bsdf, here.wo_local, lobe);
        x.f_cos = Radiance(forward.value);
        if (here.perturbed && lobe != Lobe::null)
            x.f_cos *= bump_shadowing(here, to_light, here.frame.to_local(to_light).z);
        x.pdf_light = forward.pmf;
        if (lobe == Lobe::delta_transmission && forward.eta != 1)
            projected = std::abs(double(here.wo_local.z)) /
                        (sqr(double(forward.eta)) * std::abs(double(here.frame.to_local(to_light).z)));
    } else {
        const BsdfValue<float> value = f_cos_pdf(here, to_light);
        x.f_cos = Radiance(value.f_cos);
        x.pdf_light = value.pdf_w;
    }
    if (x.site != no_site) {
        const double cos_light = here.frame.to_local(to_light).z;
        x.pdf_cosine = scatters_on_both_sides(side.scene, here, vertex) ? 0.5 * std::abs(cos_light) / pi_double
                                                                        : std::max(cos_light, 0.0) / pi_double;
    }
    side.aim(vertex, to_light, here);
    x.q_sensor = survival(here);
    x.pdf_sensor =
        is_delta(lobe) ? delta_pmf(here.bsdf, here.wo_local, lobe) * projected : f_cos_pdf(here, to_sensor).pdf_w;
    return x;
}

double light_pdf(const Scene& scene, const LightEnd& light, const Point3f& from) {
    const double pmf = scene.emitters.size() > 1 ? scene.emitter_pmf.pmf(light.emitter) : 1.0;
    if (light.delta) return pmf;
    if (light.at_infinity) return pdf_environment_w(scene, Vector3f(light.y));
    SurfacePoint at;
    at.p = light.y;
    at.ng = light.n;
    at.shape_idx = scene.emitters[light.emitter].shape_idx;
    return pdf_light_w(scene, from, at);
}

namespace {

/// Adds the densities of techniques 1 to 6.
class SiteDensities {
  public:
    SiteDensities(const DynamicScenes& scenes, const DynamicScene& side, const SampleCounts& counts,
                  const FullPath& path, double p_light, std::vector<Term>* terms, Evaluation& e)
        : scenes_(scenes), side_(side), counts_(counts), path_(path), m_(path.m()), terms_(terms), e_(e) {
        if (m_ > inline_size) {
            many_.resize(2 * m_);
            S_ = many_.data();
            E_ = many_.data() + m_;
        }
        from_sensor_ = 1 / (path.sensor.scale * path.segments[0].cos_light);
        S_[0] = path.vertices[0].specular ? 0 : from_sensor_;
        for (std::size_t i = 1; i < m_; ++i) {
            const Interaction& x = path.vertices[i];
            S_[i] = S_[i - 1] * x.pdf_sensor * x.q_sensor * path.segments[i].cos_sensor / path.segments[i].cos_light;
        }
        E_[m_ - 1] = p_light;
        for (std::size_t i = m_ - 1; i-- > 0;)
            E_[i] = path.vertices[i].pdf_light * path.vertices[i].q_light * E_[i + 1];
    }

    void add_dynamic() {
        for (std::size_t i = 0; i < m_; ++i) {
            const Interaction& x = path_.vertices[i];
            if (x.site == no_site) continue;
            const Site site = Site(x.site);
            if (i + 1 == m_)
                add(Technique::dynamic_from_emitter, site, i + 1, S_[i] * E_[i]);
            else if (i == 0)
                add(Technique::dynamic_from_sensor, site, i + 1, from_sensor_ * E_[0]);
            else
                add(Technique::dynamic_two_ends, site, i + 1, S_[i] * x.pdf_cosine * E_[i + 1]);
        }
    }

    void add_ghosts() {
        const Site site = side_.ghost_site();
        for (std::size_t i = 0; i <= m_; ++i) {
            const Segment& s = path_.segments[i];
            for (std::uint32_t c = s.first; c < s.first + s.n; ++c) {
                const Crossing& g = (*path_.crossings)[c];
                if (i == m_) {
                    if (path_.light.delta && path_.vertices[m_ - 1].specular) continue;
                    add(Technique::ghost_from_emitter, site, c, light_density(g, s.cos_sensor) * S_[m_ - 1]);
                } else if (i == 0) {
                    const std::optional<FilmPoint> film = side_.scene.sensor.project(g.p);
                    if (film) add(Technique::ghost_from_sensor, site, c, E_[0] / (film->scale * cosine(g.n, film->d)));
                } else {
                    add(Technique::ghost_two_ends, site, c, 0.5 * inv_pi<double> * s.cos_sensor * S_[i - 1] * E_[i]);
                }
            }
        }
    }

  private:
    static constexpr std::size_t inline_size = 32;

    /// Density of sampling the vertex behind a ghost on the light's segment, through that ghost.
    double light_density(const Crossing& g, float cos_sensor) const {
        const Point3f& v = path_.places[m_ - 1]->at.p;
        const Vector3f to_light = direction_to(path_.light, v);
        double nearer = 1;  // a point light falls off from the ghost to the vertex
        if (path_.light.delta && !path_.light.at_infinity)
            nearer = double(length2(path_.light.y - g.p)) / length2(path_.light.y - v);
        return light_pdf(side_.scene, path_.light, g.p) * nearer * cos_sensor / cosine(g.n, to_light);
    }

    void add(Technique technique, Site site, std::size_t place, double density) {
        const SampleCounts::FromSite& from = counts_.of(technique, site);
        if (!(from.n > 0)) return;
        const double d = from.n / scenes_.at(site).area(start_of(technique)) * density;
        e_.site_density += d;
        if (terms_) terms_->push_back({technique, std::uint32_t(place), d, from.family});
    }

    const DynamicScenes& scenes_;
    const DynamicScene& side_;
    const SampleCounts& counts_;
    const FullPath& path_;
    std::size_t m_;
    std::vector<Term>* terms_;
    Evaluation& e_;
    // Prefixes from the sensor and from the emitter: S[i] and E[i] belong to vertex i + 1.
    std::array<double, inline_size> S_few_, E_few_;
    std::vector<double> many_;
    double *S_ = S_few_.data(), *E_ = E_few_.data();
    double from_sensor_;  // density of the connection to the sensor, for techniques 2 and 5
};

}  // namespace

Evaluation evaluate(const DynamicScenes& scenes, const DynamicScene& side, const SampleCounts& counts,
                    const PathOptions& options, const FullPath& path, std::vector<Term>* terms) {
    // Contribution, and the density of path tracing.
    const std::size_t m = path.m();
    Evaluation e;
    if (!path.dynamic()) return e;
    e.F = path.light.Le;
    double nee = 1, hit = 1;
    for (std::size_t i = 0; i < m; ++i) {
        const Interaction& x = path.vertices[i];
        e.F *= x.f_cos;
        const bool roulette = roulette_at(options, int(i) + 1) != Roulette::off;
        const double p = x.pdf_light * (roulette ? x.q_light : 1);
        if (i + 1 < m) nee *= p;
        hit *= p;
    }
    const bool light_can_be_sampled = m > 0 && !path.vertices[m - 1].specular;
    const double p_light = light_can_be_sampled ? path.light.pdf : 0.0;
    e.nee_density = nee * p_light;
    e.camera_density = e.nee_density + (path.light.delta ? 0 : hit);
    if (terms) terms->push_back({Technique::path_tracing, 0, e.camera_density});
    if (m == 0 || (counts.first_to_camera && path.dynamic_at_first())) return e;

    // Densities of paths from sites.
    SiteDensities sites(scenes, side, counts, path, p_light, terms, e);
    sites.add_dynamic();
    sites.add_ghosts();
    return e;
}

}  // namespace loom::residual
