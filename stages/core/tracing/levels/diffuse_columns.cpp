// The step at a diffuse surface, compiled once per x86-64 level (LOOM_LEVEL is v2, v3 or v4). `flatten` inlines all
// callees, so no other code of a level enters the program.
#include "stages/core/tracing/diffuse_levels.h"
#include "stages/core/tracing/vertex_rules.h"

namespace loom::LOOM_LEVEL {
namespace {

// Several loops over few columns, not one loop over all. A comparison with the result of a select() in the same loop
// becomes a select of comparisons, which g++ does not vectorise. For the same reason directions are mirrored by a
// product, and the operands of a decision are stored in a column.

Vector3f times_z(const Vector3f& w, float sign) {
    return {w.x, w.y, w.z * sign};
}
float sum(const Spectrum& s) {
    return s.r + s.g + s.b;
}
Bsdf<float> diffuse_bsdf(const DiffuseColumns& c, std::size_t i) {
    Bsdf<float> bsdf;
    bsdf.diffuse = c.reflectance.get<Spectrum>(i);
    return bsdf;
}

void find_normal(DiffuseColumns& c, std::size_t i) {
    const Normal3f smooth = smooth_normal(c.n.get<Vector3f>(i), c.side[i]);
    c.ns.set(i, select(c.side[i] != 0, smooth, c.ng.get<Normal3f>(i)));
}

void turn_to_front(DiffuseColumns& c, std::size_t i) {
    const Vector3f wo_local = Framef(c.ns.get<Normal3f>(i)).to_local(c.wo.get<Vector3f>(i));
    const float turn = select((c.two_sided[i] != 0) & (wo_local.z < 0), -1.0f, 1.0f);
    c.turn[i] = turn;
    c.wo_local.set(i, times_z(wo_local, turn));
}

void find_albedo(DiffuseColumns& c, std::size_t i) {
    const Spectrum a = DiffuseFamily::albedo(diffuse_bsdf(c, i), c.wo_local.get<Vector3f>(i));
    c.albedo.set(i, Spectrum(clamp(a.r, 0.0f, 1.0f), clamp(a.g, 0.0f, 1.0f), clamp(a.b, 0.0f, 1.0f)));
}

void find_survival(DiffuseColumns& c, std::size_t i, bool may_end, bool by_throughput) {
    const Spectrum beta = c.beta.get<Spectrum>(i) * c.eta_scale[i];
    c.q[i] = select(may_end, survival(c.albedo.get<Spectrum>(i), select(by_throughput, beta, Spectrum(1))), 1.0f);
}

void see_light(DiffuseColumns& c, std::size_t i) {
    LightPoint point;
    point.Li = c.light_Li.get<Spectrum>(i);
    point.y = c.light_y.get<Point3f>(i);
    point.n = c.light_n.get<Normal3f>(i);
    point.area = c.light_area[i];
    point.pdf_w = c.light_pdf_w[i];
    point.pmf = c.light_pmf[i];
    point.at_infinity = c.light_at_infinity[i] != 0;
    const LightSample light = seen_from(point, c.p.get<Point3f>(i));
    c.light_wi.set(i, light.wi);
    c.shadow_pdf_w[i] = light.pdf_w;
}

void reflect_light(DiffuseColumns& c, std::size_t i) {
    const Framef frame(c.ns.get<Normal3f>(i));
    const Vector3f wi = times_z(frame.to_local(c.light_wi.get<Vector3f>(i)), c.turn[i]);
    const BsdfValue<float> value = DiffuseFamily::f_cos_pdf(diffuse_bsdf(c, i), c.wo_local.get<Vector3f>(i), wi);
    const float pdf = c.shadow_pdf_w[i], pdf_bsdf = value.pdf_w * c.q[i];
    c.contribution.set(
        i, light_sample_contribution(c.beta.get<Spectrum>(i), value.f_cos, c.light_Li.get<Spectrum>(i), pdf, pdf_bsdf));
    c.shadow_f[i] = sum(value.f_cos);
    c.shadow_pdf_bsdf_w[i] = pdf_bsdf;
}

/// Computes spawn_ray() or spawn_segment() without a Ray, because the vectoriser does not optimise copies of it.
void aim_at_light(DiffuseColumns& c, std::size_t i) {
    const auto p = c.p.get<Point3f>(i), y = c.light_y.get<Point3f>(i);
    const auto wi = c.light_wi.get<Vector3f>(i);
    const bool at_infinity = c.light_at_infinity[i] != 0;
    const Point3f o = offset_origin(p, c.ng.get<Normal3f>(i), c.hit_error[i], select(at_infinity, wi, y - p));
    const Vector3f segment = offset_end(y, c.light_n.get<Normal3f>(i), c.light_hit_error[i], o) - o;
    const float distance = length(segment);
    c.shadow_o.set(i, o);
    c.shadow_d.set(i, select(at_infinity, wi, segment / distance));
    c.shadow_t_max[i] = select(at_infinity, float(INFINITY), distance * (1 - surface_epsilon));
}

void choose_direction(DiffuseColumns& c, std::size_t i) {
    c.next_d.set(i, sample_cosine_hemisphere({c.u_direction_x[i], c.u_direction_y[i]}));
}

void scatter(DiffuseColumns& c, std::size_t i) {
    const auto wi = c.next_d.get<Vector3f>(i);
    const BsdfValue<float> value = DiffuseFamily::f_cos_pdf(diffuse_bsdf(c, i), c.wo_local.get<Vector3f>(i), wi);
    const Spectrum weight = value.f_cos / value.pdf_w;
    const float q = c.q[i];
    c.next_d.set(i, Framef(c.ns.get<Normal3f>(i)).to_world(times_z(wi, c.turn[i])));
    c.next_beta.set(i, continued(c.beta.get<Spectrum>(i), weight, q));
    c.next_pdf_w[i] = value.pdf_w * q;
    c.next_weight[i] = sum(weight);
}

void leave_surface(DiffuseColumns& c, std::size_t i) {
    c.next_o.set(i,
                 offset_origin(c.p.get<Point3f>(i), c.ng.get<Normal3f>(i), c.hit_error[i], c.next_d.get<Vector3f>(i)));
}

}  // namespace

[[gnu::flatten]] void shade_diffuse(DiffuseColumns& columns, std::size_t n, Roulette roulette) {
    const bool may_end = roulette != Roulette::off, by_throughput = roulette == Roulette::throughput;
    const auto each = [&](auto&& step) {
        for (std::size_t i = 0; i < n; ++i) step(columns, i);
    };
    each(find_normal);
    each(turn_to_front);
    each(find_albedo);
    each([=](DiffuseColumns& c, std::size_t i) { find_survival(c, i, may_end, by_throughput); });
    each(see_light);
    each(reflect_light);
    each(aim_at_light);
    each(choose_direction);
    each(scatter);
    each(leave_surface);
}

}  // namespace loom::LOOM_LEVEL
