// Geometry over a Dual: surfaces, shading points and light points that move with a parameter, against central
// differences of the same quantities.
// Detected mutations: the derivative of a sphere's colatitude lost; texture gradients by u and v exchanged; the
// spot's fall-off taken as a constant; normals of a sphere not rounded; the slope of fdr_int by roughness negated.

#include <gtest/gtest.h>

#include <array>
#include <functional>

#include "stages/core/math/matrix.h"
#include "stages/core/scene/delta_light.h"
#include "stages/core/scene/shading.h"
#include "tests/unit/bsdf_cases.h"

namespace loom::test {
namespace {

using D = Dual<1, double>;

/// Derivatives of all numbers that f gives at x, against central differences.
///   f  D -> std::vector<D>
void expect_derivatives(const char* name, const std::function<std::vector<D>(const D&)>& f, double x, double step,
                        double tolerance) {
    const std::vector<D> at = f(D::variable(x, 0)), above = f(D(x + step)), below = f(D(x - step));
    double moving = 0;
    for (std::size_t i = 0; i < at.size(); ++i) {
        const double difference = (above[i].value - below[i].value) / (2 * step);
        EXPECT_NEAR(at[i].d[0], difference, tolerance * (1 + std::abs(difference))) << name << ", number " << i;
        moving += std::abs(difference);
    }
    EXPECT_GT(moving, 0.1) << name << ": nothing moves";
}

template <class Kind>
void append(std::vector<D>& all, const Triple<D, Kind>& v) {
    all.insert(all.end(), {v.x, v.y, v.z});
}
void append(std::vector<D>& all, const Tangents<D>& t) {
    append(all, t.dp_du);
    append(all, t.dp_dv);
}

/// Rotation about an oblique axis, and a shift, both by x.
Matrix4<D> motion(const D& x) {
    return Matrix4<D>::translation(x, D(0.5) * x, -x) * Matrix4<D>::rotation({D(1), D(2), D(0.5)}, x);
}
Vector3<D> moved(const D& x, const Vector3<double>& v) {
    return motion(x).vector(Vector3<D>(v));
}
Point3<D> moved(const D& x, const Point3<double>& p) {
    return motion(x).point(Point3<D>(p));
}

TEST(GeometryDerivative, MapsOfPointsAndNormals) {
    expect_derivatives(
        "matrices",
        [](const D& x) {
            std::vector<D> all;
            const Matrix4<D> m = motion(x) * Matrix4<D>::scaling(D(1) + x, D(2), D(3)) *
                                 Matrix4<D>::look_at({x, D(1), D(2)}, {D(0), D(0), x}, {D(0), D(1), D(0)});
            append(all, m.point({D(1), D(2), D(3)}));
            append(all, m.vector({D(1), D(2), D(3)}));
            for (const D& n : m.normal_matrix()) all.push_back(n);
            all.push_back(m.determinant3());
            Matrix4<D> projective = m;
            projective(3, 0) = x;  // 1 at the origin of x: the derivative of the divisor counts
            append(all, projective.point({D(1), D(2), D(3)}));
            return all;
        },
        0.0, 1e-5, 1e-8);
}

TEST(GeometryDerivative, PointsNormalsAndTangentsOfSurfaces) {
    for (const double x : {0.0, 0.7}) {
        expect_derivatives(
            "triangle",
            [](const D& x) {
                const TriangleGeometry<D> t{moved(x, Point3<double>{1, 0, 0}), moved(x, Vector3<double>{0.3, 1, 0}),
                                            moved(x, Vector3<double>{0.1, 0.2, 1})};
                std::vector<D> all;
                append(all, t.point(x * x, D(0.2) + x));
                append(all, t.normal());
                append(all, t.tangents({D(0), D(0)}, {D(1), x}, {D(0.2), D(1)}, t.normal()));
                append(all, TriangleGeometry<D>::any_tangents(t.normal()));
                append(all, interpolate(t.e1, t.e2, Vector3<D>(t.normal()), x, D(0.4)));
                return all;
            },
            x, 1e-5, 1e-7);
        expect_derivatives(
            "sphere and disk",
            [](const D& x) {
                RoundGeometry<D> round;
                round.center = moved(x, Point3<double>{1, 2, 0});
                round.radius = D(1) + x;
                round.u_axis = moved(x, Vector3<double>{1, 0, 0});
                round.v_axis = moved(x, Vector3<double>{0, 1, 0});
                round.w_axis = moved(x, Vector3<double>{0, 0, 1});
                const Vector3<D> outward = normalize(Vector3<D>{D(0.3), D(-0.5) + x, D(0.6)});
                std::vector<D> all;
                append(all, round.sphere_point(outward));
                append(all, round.sphere_tangents(outward));
                append(all, round.disk_point(D(0.3) + x, D(0.2)));
                append(all, round.disk_normal());
                append(all, round.disk_tangents(D(0.3) + x, D(0.2)));
                for (const Point2<D>& uv : {round.sphere_uv(outward), round.disk_uv(D(0.3) + x, D(0.2))})
                    all.insert(all.end(), {uv.x, uv.y});
                return all;
            },
            x, 1e-5, 1e-7);
        expect_derivatives(
            "maps",
            [](const D& x) {
                const Normal3<D> n(moved(x, normalize(Vector3<double>{0.2, 0.3, 1})));
                const Frame<D> base = frame_along(n, moved(x, Vector3<double>{1, 0.2, 0}));
                std::vector<D> all;
                append(all, base.s);
                append(all, base.t);
                append(all, mapped_normal(Rgb<D>{D(0.5) + x * D(0.1), D(0.6), D(0.9)}));
                append(all,
                       bumped_normal(base, {moved(x, Vector3<double>{1, 0, 0}), moved(x, Vector3<double>{0, 2, 0})},
                                     Point2<D>{D(0.2) + x, D(-0.1)}));
                return all;
            },
            x, 1e-5, 1e-7);
    }
}

/// What a light point on a tilted, moving light sends into the BSDF of a moving, bumped point.
TEST(GeometryDerivative, LightOfALightPointAtAShadingPoint) {
    for (const BsdfCase& c : bsdf_cases()) {
        if (c.model.kind == BsdfKind::rough_plastic) continue;                          // its tables: RoughCoatSlopes
        if (c.model.kind == BsdfKind::rough_diffuse && c.model.alpha_u == 0) continue;  // a kink
        const Bsdf<float> bsdf(c.model);
        if (!has_smooth_lobe(bsdf)) continue;
        const auto light = [&](const D& x) {
            ShadingPoint still;
            still.frame = Framef(Normal3f(normalize(Vector3f{0.1f, 0.2f, 1})));
            still.bsdf = bsdf;
            still.perturbed = true;
            ShadingPointOf<D> at(still);
            at.p = moved(x, Point3<double>{0, 0.1, 0});
            at.n_side = Normal3<D>(moved(x, normalize(Vector3<double>{0, 0.15, 1})));
            at.wo = normalize(Point3<D>{D(1), D(0.3), D(2)} - at.p);
            at.wo_local = at.frame.to_local(at.wo);
            LightPointOf<D> point;
            point.Li = {D(1) + x, D(2), D(3)};
            point.y = Point3<D>{D(-0.6), D(-0.2) + x, D(1.5)};
            point.n = Normal3<D>(moved(x, normalize(Vector3<double>{0.2, 0, -1})));
            point.area = D(0.3);
            const LightSampleOf<D> s = seen_from(point, at.p);
            const BsdfValue<D> v = f_cos_pdf(at, s.wi);
            const Rgb<D> L = v.f_cos * s.Li / s.pdf_w;
            return std::vector<D>{L.r, L.g, L.b, v.pdf_w, s.pdf_w};
        };
        expect_derivatives(c.name.c_str(), light, 0.05, 1e-6, 2e-5);
    }
}

TEST(GeometryDerivative, LightOfDeltaEmittersWithTextures) {
    Scene scene;
    Texture texture;
    auto image = std::make_shared<TextureImage>();
    image->width = 3, image->height = 2;
    for (const float v : {0.1f, 0.5f, 0.9f, 0.8f, 0.3f, 0.6f})
        image->floats.insert(image->floats.end(), {v, 1 - v, v * v});
    texture.image = image;
    texture.to_uv = {0.8f, 0.1f, 0.05f, -0.2f, 0.9f, 0.1f};
    scene.textures.push_back(texture);
    for (const EmitterKind kind :
         {EmitterKind::point, EmitterKind::spot, EmitterKind::directional, EmitterKind::projector}) {
        Emitter e;
        e.kind = kind;
        e.radiance = {1, 2, 3};
        e.texture_idx = kind == EmitterKind::point || kind == EmitterKind::directional ? -1 : 0;
        e.cutoff_rad = 0.6f, e.beam_rad = 0.1f, e.tan_x = 1, e.tan_y = 0.8f;
        const auto light = [&](const D& x) {
            EmitterPose<D> pose(e);
            pose.radiance = pose.radiance * (D(1) + x);
            pose.position = moved(x, Point3<double>{0, 0.2, 0});
            pose.frame = Frame<D>(moved(x, Vector3<double>{1, 0, 0}), moved(x, Vector3<double>{0, 1, 0}),
                                  Normal3<D>(moved(x, Vector3<double>{0, 0, 1})));
            const LightSampleOf<D> s = delta_light(scene, e, pose, Point3<D>{D(0.5), D(0.3) + x, D(2)});
            std::vector<D> all{s.Li.r, s.Li.g, s.Li.b};
            append(all, s.wi);
            return all;
        };
        // Look-ups are in float: the step is as long as the texture is smooth.
        expect_derivatives(e.texture_idx < 0 ? "without a texture" : "with a texture", light, 0.03,
                           e.texture_idx < 0 ? 1e-5 : 1e-3, e.texture_idx < 0 ? 1e-7 : 2e-3);
    }
}

// Rounding for the disk format happens in as_stored() alone: what the tracer gets of a surface are the exact position
// and texture coordinates and the rounded exact normals.
TEST(SurfaceGeometry, OnlyNormalsAreRounded) {
    Scene scene;
    scene.materials.resize(1);
    Shape& sphere = scene.shapes.emplace_back();
    sphere.kind = ShapeKind::sphere;
    sphere.round = {{0.1f, 0.2f, 0.3f}, 1.5f, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
    const Vector3f d = normalize(Vector3f{0.3f, -0.7f, 0.6f});
    const Ray ray{sphere.round.center + d * 4.0f, -d};
    const SurfacePoint at = scene.surface(ray, {2.5f, 0, 0, 0, 0});
    const Vector3f outward = normalize(ray.o + ray.d * 2.5f - sphere.round.center);
    EXPECT_EQ(at.p, sphere.round.sphere_point(outward));
    EXPECT_EQ(at.ng, as_stored(Normal3f(outward)));
    EXPECT_FALSE(at.ng == Normal3f(outward));
    EXPECT_EQ(as_stored(at.ng), at.ng);
}

// Slopes of the tables of a rough plastic against differences of tables at other roughnesses and indices. The tables
// are in float, so steps are long and the fourth-order formula is used.
TEST(RoughCoatSlopes, AreThoseOfTheTables) {
    const auto table = [](Microfacet distribution, float alpha, float eta) {
        BsdfModel m;
        m.kind = BsdfKind::rough_plastic;
        m.distribution = distribution;
        m.alpha_u = m.alpha_v = alpha;
        m.int_ior = eta, m.ext_ior = 1;
        prepare(m);
        return m;
    };
    for (const Microfacet distribution : {Microfacet::ggx, Microfacet::beckmann}) {
        BsdfModel m = table(distribution, 0.25f, 1.5f);
        prepare_coat_slopes(m);
        using D2 = Dual<2, double>;
        Bsdf<D2> b(m);
        b.alpha_u = D2::variable(b.alpha_u.value, 0), b.eta = D2::variable(b.eta.value, 1);
        for (const int variable : {0, 1}) {
            constexpr float h = 0.02f;
            const auto at = [&](float k) {
                return table(distribution, 0.25f + (variable == 0 ? k * h : 0), 1.5f + (variable == 1 ? k * h : 0));
            };
            const std::array<BsdfModel, 4> shifted{at(-2), at(-1), at(1), at(2)};
            const auto difference = [&](const auto& value_of_model) {
                const double a = value_of_model(shifted[0]), b = value_of_model(shifted[1]),
                             c = value_of_model(shifted[2]), d = value_of_model(shifted[3]);
                return (8 * (c - b) - (d - a)) / (12 * double(h));
            };
            for (float RoughCoat::*side : {&RoughCoat::fdr_int, &RoughCoat::fdr_ext}) {
                const double expected = difference([&](const BsdfModel& x) { return double(x.coat.*side); });
                // The tables' own quadrature from inside makes differences uncertain by 2 %.
                const double tolerance = side == &RoughCoat::fdr_int ? 0.03 : 2e-3;
                EXPECT_NEAR(RoughPlasticFamily::diffuse_reflectance(b, side).d[variable], expected,
                            1e-4 + tolerance * std::abs(expected));
                EXPECT_GT(std::abs(expected), 0.01);
            }
            for (const double cos : {0.05, 0.1, 0.3, 0.6, 1.0}) {
                const double expected = difference([&](const BsdfModel& x) {
                    return double(RoughPlasticFamily::transmittance(Bsdf<float>(x), float(cos)));
                });
                EXPECT_NEAR(RoughPlasticFamily::transmittance(b, D2(cos)).d[variable], expected,
                            2e-3 * (0.1 + std::abs(expected)))
                    << cos << " variable " << variable;
            }
        }
    }
}

TEST(RoughCoatSlopes, WithoutThemADerivativeIsRefused) {
    BsdfModel m;
    m.kind = BsdfKind::rough_plastic;
    prepare(m);
    Bsdf<D> by_eta(m), by_alpha(m);
    by_eta.eta.d[0] = by_alpha.alpha_u.d[0] = 1;
    EXPECT_NO_THROW(RoughPlasticFamily::transmittance(Bsdf<D>(m), D::variable(0.5, 0)));
    EXPECT_THROW(RoughPlasticFamily::transmittance(by_eta, D(0.5)), std::logic_error);
    EXPECT_THROW(RoughPlasticFamily::transmittance(by_alpha, D(0.5)), std::logic_error);
    RoughCoats coats;
    coats.alpha_min = 0.1f, coats.alpha_max = 0.3f;
    coats.rows = {m.coat, m.coat, m.coat};
    m.coats = &coats;
    EXPECT_THROW(RoughPlasticFamily::transmittance(by_eta, D(0.5)), std::logic_error);
}

// Where a texture gives the roughness, the derivative by roughness is that of the interpolated rows.
TEST(RoughCoatSlopes, OfTexturedRoughness) {
    BsdfModel m;
    m.kind = BsdfKind::rough_plastic;
    m.int_ior = 1.5f, m.ext_ior = 1;
    prepare_coats(m, 0.12f, 0.16f);
    RoughCoats coats = *m.coats;
    prepare_coat_slopes(m, &coats);
    m.coats = &coats;
    using D2 = Dual<2, double>;
    Bsdf<D2> b(m);
    b.alpha_u = D2::variable(0.13, 0), b.eta = D2::variable(b.eta.value, 1);
    const D2 value = RoughPlasticFamily::transmittance(b, D2(0.3));
    BsdfModel constant = m;
    constant.coats = nullptr;
    constant.alpha_u = constant.alpha_v = 0.13f;
    prepare(constant);
    prepare_coat_slopes(constant);
    Bsdf<D2> of_constant(constant);
    of_constant.alpha_u = D2::variable(of_constant.alpha_u.value, 0);
    of_constant.eta = D2::variable(of_constant.eta.value, 1);
    const D2 exact = RoughPlasticFamily::transmittance(of_constant, D2(0.3));
    EXPECT_NEAR(value.value, exact.value, 1e-3);
    // A chord between rows 0.02 apart against the tangent.
    EXPECT_NEAR(value.d[0], exact.d[0], 0.2 * std::abs(exact.d[0]));
    EXPECT_NEAR(value.d[1], exact.d[1], 0.02 * std::abs(exact.d[1]));
}

}  // namespace
}  // namespace loom::test
