#include <gtest/gtest.h>

#include <cstring>
#include <memory>

#include "stages/core/sampling/sampler.h"
#include "stages/core/scene/shading.h"
#include "stages/core/tracing/diffuse_levels.h"

namespace loom::test {
namespace {

/// Columns with surfaces, paths and lights of all sorts; some lights are black or behind, some normals flat.
void fill(DiffuseColumns& c, std::size_t n) {
    std::memset(static_cast<void*>(&c), 0, sizeof c);
    for (std::size_t i = 0; i < n; ++i) {
        const Sampler sampler(SamplerKind::independent, 5, 0, i);
        std::uint32_t pair = 0;
        const auto u2 = [&] { return sampler.pair(pair++); };
        const auto unit = [&] { return sample_uniform_sphere(u2()); };
        const auto colour = [&] { return Spectrum(u2().x, u2().x, u2().x); };
        const Vector3f ng = as_stored(unit());
        c.p.set(i, unit() * 3.0f);
        c.ng.set(i, ng);
        c.hit_error[i] = 1e-6f * u2().x;
        c.n.set(i, i % 3 == 0 ? Vector3f() : (ng + unit() * 0.3f) * 0.7f);
        c.side[i] = i % 3 == 0 ? 0.0f : i % 3 == 1 ? 1.0f : -1.0f;
        c.reflectance.set(i, i % 11 == 0 ? Spectrum(0) : colour());
        c.two_sided[i] = i % 2 == 0 ? 1.0f : 0.0f;
        c.wo.set(i, unit());
        c.beta.set(i, colour());
        c.eta_scale[i] = 1 + u2().x;
        const Point2f direction = u2();
        c.u_direction_x[i] = direction.x;
        c.u_direction_y[i] = direction.y;
        c.u_roulette[i] = u2().x;
        const bool at_infinity = i % 5 == 0;
        c.light_y.set(i, at_infinity ? unit() : unit() * 5.0f);
        c.light_n.set(i, unit());
        c.light_hit_error[i] = 1e-6f * u2().x;
        c.light_Li.set(i, i % 13 == 0 ? Spectrum(0) : colour());
        c.light_area[i] = 0.1f + u2().x;
        c.light_pdf_w[i] = u2().x;
        c.light_pmf[i] = u2().x;
        c.light_at_infinity[i] = at_infinity ? 1.0f : 0.0f;
    }
}

/// The functions of a single path, against the columns.
void expect_plain(const DiffuseColumns& c, std::size_t n, Roulette roulette, const char* level) {
    std::size_t asked = 0, went_on = 0;
    for (std::size_t i = 0; i < n; ++i) {
        SCOPED_TRACE(std::string(level) + ", path " + std::to_string(i));
        BsdfModel model;
        model.two_sided = c.two_sided[i] != 0;
        model.diffuse = c.reflectance.get<Spectrum>(i);
        ShadingPoint here;
        here.p = c.p.get<Point3f>(i);
        here.wo = c.wo.get<Vector3f>(i);
        here.ng = c.ng.get<Normal3f>(i);
        here.hit_error = c.hit_error[i];
        here.n_side = c.side[i] == 0 ? here.ng : smooth_normal(c.n.get<Vector3f>(i), c.side[i]);
        here.frame = Framef(here.n_side);
        here.wo_local = here.frame.to_local(here.wo);
        here.bsdf = Bsdf<float>(model);
        ASSERT_EQ(c.ns.get<Normal3f>(i), here.frame.n);
        ASSERT_EQ(c.albedo.get<Spectrum>(i), albedo(here.bsdf, here.wo_local));

        const auto beta = c.beta.get<Spectrum>(i);
        float q = 1;
        if (roulette != Roulette::off) {
            Spectrum survival = albedo(here.bsdf, here.wo_local);
            if (roulette == Roulette::throughput) survival *= beta * c.eta_scale[i];
            q = std::min(max_channel(survival), max_survival);
        }
        ASSERT_EQ(c.q[i], q);

        LightPoint point;
        point.Li = c.light_Li.get<Spectrum>(i);
        point.y = c.light_y.get<Point3f>(i);
        point.n = c.light_n.get<Normal3f>(i);
        point.hit_error = c.light_hit_error[i];
        point.area = c.light_area[i];
        point.pdf_w = c.light_pdf_w[i];
        point.pmf = c.light_pmf[i];
        point.at_infinity = c.light_at_infinity[i] != 0;
        const LightSample light = seen_from(point, here.p);
        const BsdfValue<float> value = f_cos_pdf(here, light.wi);
        const bool asks = light.pdf_w > 0 && !is_black(value.f_cos);
        ASSERT_EQ(c.needs_shadow_ray(i), asks);
        if (asks) {
            ++asked;
            const Ray ray =
                light.at_infinity ? spawn_ray(here.end(), light.wi) : spawn_segment(here.end(), light.end());
            const float weight = power_heuristic(light.pdf_w, value.pdf_w * q) / light.pdf_w;
            ASSERT_EQ(c.contribution.get<Spectrum>(i), beta * value.f_cos * light.Li * weight);
            ASSERT_EQ(c.shadow_pdf_w[i], light.pdf_w);
            ASSERT_EQ(c.shadow_pdf_bsdf_w[i], value.pdf_w * q);
            ASSERT_EQ(c.shadow_o.get<Point3f>(i), ray.o);
            ASSERT_EQ(c.shadow_d.get<Vector3f>(i), ray.d);
            ASSERT_EQ(c.shadow_t_max[i], ray.t_max);
        }

        ASSERT_EQ(c.roulette_ends(i), q < 1 && c.u_roulette[i] >= q);
        const BsdfSample<float> s = sample(here.bsdf, here.wo_local, 0.0f, {c.u_direction_x[i], c.u_direction_y[i]});
        const bool has_next = s.lobe != Lobe::none && !is_black(s.weight);
        ASSERT_EQ(c.has_next(i), has_next);
        if (has_next && !c.roulette_ends(i)) {
            ++went_on;
            const Ray ray = spawn_ray(here.end(), here.frame.to_world(s.wi));
            ASSERT_EQ(c.next_o.get<Point3f>(i), ray.o);
            ASSERT_EQ(c.next_d.get<Vector3f>(i), ray.d);
            ASSERT_EQ(c.next_beta.get<Spectrum>(i), beta * (s.weight * (1 / q)));
            ASSERT_EQ(c.next_pdf_w[i], s.pdf_w * q);
        }
    }
    EXPECT_GT(asked, n / 10);
    EXPECT_GT(went_on, n / 10);
}

TEST(DiffuseColumns, EveryLevelEqualsTheSinglePath) {
    const auto columns = std::make_unique<DiffuseColumns>();
    for (const Roulette roulette : {Roulette::off, Roulette::albedo, Roulette::throughput})
        for (const std::size_t n : {DiffuseColumns::capacity, std::size_t(101)}) {
            const auto expect = [&](auto* shade, const char* level) {
                fill(*columns, n);
                shade(*columns, n, roulette);
                expect_plain(*columns, n, roulette, level);
            };
            expect(shade_diffuse, "chosen");
            expect(v2::shade_diffuse, "v2");
            if (__builtin_cpu_supports("x86-64-v3")) expect(v3::shade_diffuse, "v3");
            if (__builtin_cpu_supports("x86-64-v4")) expect(v4::shade_diffuse, "v4");
        }
}

}  // namespace
}  // namespace loom::test
