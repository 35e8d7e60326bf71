// Options of materials and skies that decide a value, against closed forms. Detected mutations: each with its reader
// removed (the values before: shadowed and flipped in any file, balanced for all variants of ward, gamma by the type of
// the image).

#include <fmt/format.h>
#include <gtest/gtest.h>

#include "stages/core/graph/graph_reader.h"
#include "stages/core/scene/build.h"
#include "stages/core/tracing/path_step.h"
#include "tests/traced_graph.h"
#include "tests/unit/scene_folder.h"

namespace loom::test {
namespace {

class MaterialOptions : public SceneFolder {
  protected:
    /// Returns f cos of a white square with a constant normal map, viewed from `from` at the origin, for light from wi.
    float f_cos(Vector3f n, bool flips, bool shadows, const Vector3f& from, const Vector3f& wi) {
        const auto byte = [](float x) { return int(std::lround((x + 1) * 127.5f)); };
        write("n.ppm", fmt::format("P3\n1 1\n255\n{} {} {}\n", byte(n.x), byte(n.y), byte(n.z)));
        const auto scene = load_scene(write(
            "scene.xml",
            text(fmt::format(
                R"(<shape type="rectangle"><bsdf type="normalmap"><boolean name="flip_invalid_normals" value="{}"/>
<boolean name="use_shadowing_function" value="{}"/><texture type="bitmap" name="normalmap"><string name="filename" value="n.ppm"/>
<boolean name="raw" value="true"/></texture><bsdf type="diffuse"><rgb name="reflectance" value="1"/></bsdf></bsdf></shape>)",
                flips, shadows))));
        const Ray ray{Point3f(from), normalize(-from)};
        const Hit hit = scene->intersect(ray);
        EXPECT_TRUE(hit);
        const ShadingPoint at = shading_point(*scene, scene->surface(ray, hit), -ray.d);
        return loom::f_cos_pdf(at, normalize(wi)).f_cos.r;
    }
};

TEST_F(MaterialOptions, NormalMapsFlipAndShadeOnlyWhereTheyAreToldTo) {
    const Vector3f n = normalize(Vector3f{0.6f, 0, 0.8f}), wi = normalize(Vector3f{2, 0, 1});
    const float tan2_n = sqr(0.6f / 0.8f), tan2_i = 4;
    const float shadow = 2 / (1 + std::sqrt(1 + 0.125f * tan2_n * tan2_i));
    const float lit = dot(n, wi) * inv_pi<float>;
    for (const bool flips : {false, true}) {
        EXPECT_NEAR(f_cos(n, flips, false, {0, 0, 5}, wi), lit, 0.002f);
        EXPECT_NEAR(f_cos(n, flips, true, {0, 0, 5}, wi), lit * shadow, 0.002f);
    }
    EXPECT_GT(lit * (1 - shadow), 0.01f);
    // From behind the normal: black, or the normal turned to the other side.
    const Vector3f steep = normalize(Vector3f{0.8f, 0, 0.6f}), grazing{-4, 0, 1.2f},
                   above = normalize(Vector3f{-1, 0, 3});
    const float turned = dot(normalize(Vector3f{-0.8f, 0, 0.6f}), above) * inv_pi<float>;
    EXPECT_EQ(f_cos(steep, false, false, grazing, above), 0);
    EXPECT_EQ(f_cos(steep, false, true, grazing, above), 0);
    EXPECT_NEAR(f_cos(steep, true, false, grazing, above), turned, 0.002f);
}

TEST_F(MaterialOptions, WardHasThreeNormalisations) {
    const Vector3f wo = normalize(Vector3f{0.3f, 0.2f, 0.9f}), wi = normalize(Vector3f{-0.5f, 0.1f, 0.6f}), H = wo + wi;
    const double au = 0.3, av = 0.2;
    const double spread =
        std::exp(-(std::pow(H.x / au, 2) + std::pow(H.y / av, 2)) / (H.z * H.z)) / (pi_double * au * av);
    const std::pair<const char*, double> variants[] = {{"balanced", dot(H, H) / std::pow(H.z, 4)},
                                                       {"ward-duer", 1 / (4.0 * wo.z * wi.z)},
                                                       {"ward", 1 / (4 * std::sqrt(double(wo.z) * wi.z))}};
    for (const auto& [name, normalisation] : variants) {
        const auto scene = load_scene(write(
            "scene.xml",
            text(fmt::format(
                R"(<shape type="rectangle"><bsdf type="ward"><string name="variant" value="{}"/><float name="alpha_u" value="0.3"/><float name="alpha_v" value="0.2"/>
<rgb name="diffuse_reflectance" value="0.4"/><rgb name="specular_reflectance" value="0.25"/></bsdf></shape>)",
                name))));
        const Bsdf<float> bsdf(scene->materials[scene->shapes[0].material_idx].model);
        EXPECT_NEAR(f_cos_pdf(bsdf, wo, wi).f_cos.r, (0.4 / pi_double + 0.25 * spread * normalisation) * wi.z, 1e-5)
            << name;
    }
}

// A graph without the columns means the defaults.
TEST_F(MaterialOptions, GraphsKeepVariantAndShadowing) {
    const std::string map =
        "<texture type='bitmap' name='normalmap'><string name='filename' value='n.ppm'/><boolean name='raw' "
        "value='true'/></texture>";
    write("n.ppm", "P3\n1 1\n255\n140 128 250\n");
    const auto graph_of = [&](const std::string& option, const std::string& variant) {
        const auto scene =
            load_scene(write("scene.xml", text("<shape type='sphere'><bsdf type='normalmap'>" + option + map +
                                               "<bsdf type='ward'>" + variant + "</bsdf></bsdf></shape>")));
        scene->sensor.width = scene->sensor.height = 2;
        return loom::testing::trace_graph(*scene, loom::testing::path_options(*scene, 1), 1);
    };
    const PathGraph plain = graph_of("", ""), other = graph_of("<boolean name='use_shadowing_function' value='false'/>",
                                                               "<string name='variant' value='ward'/>");
    EXPECT_TRUE(plain.materials.variant.empty());
    EXPECT_TRUE(plain.materials.bump_shadowing.empty());
    EXPECT_EQ(GraphReader(plain).model(0).variant, WardVariant::balanced);
    EXPECT_TRUE(GraphReader(plain).model(0).bump_shadowing);
    EXPECT_EQ(GraphReader(other).model(0).variant, WardVariant::ward);
    EXPECT_FALSE(GraphReader(other).model(0).bump_shadowing);
}

TEST_F(MaterialOptions, GammaOfAnEnvironmentMapIsThatOfTheFile) {
    write("sky.ppm", "P3\n2 2\n255\n" + std::string("128 128 128 ") + "128 128 128 128 128 128 128 128 128\n");
    const auto radiance = [&](const std::string& gamma, const char* version) {
        const auto scene = load_scene(write(
            "scene.xml",
            text("<emitter type='envmap'><string name='filename' value='sky.ppm'/>" + gamma + "</emitter>", version)));
        return environment(*scene, {0, 1, 0}).r;
    };
    const float encoded = 128.0f / 255;
    EXPECT_NEAR(radiance("", "0.6.0"), 0.2159, 1e-4);  // sRGB
    EXPECT_NEAR(radiance("<float name='gamma' value='1'/>", "0.6.0"), encoded, 1e-6);
    EXPECT_NEAR(radiance("<float name='gamma' value='2.2'/>", "0.6.0"), std::pow(encoded, 2.2f), 1e-6);
    EXPECT_NEAR(radiance("<float name='gamma' value='-1'/>", "0.6.0"), 0.2159, 1e-4);
}

// Its half vector has no direction for light that goes straight on; Mitsuba refuses it, too.
TEST_F(MaterialOptions, RoughGlassOfEqualIndicesIsRefused) {
    const auto load = [](const char* plugin, const char* ior) {
        return testing::load_inline(
            {.sensor = R"(type="perspective">)",
             .body = fmt::format(
                 R"(<shape type="sphere"><bsdf type="{}"><float name="int_ior" value="{}"/><float name="ext_ior" value="1.3"/></bsdf></shape>)",
                 plugin, ior)});
    };
    EXPECT_NO_THROW(load("roughdielectric", "1.4"));
    EXPECT_NO_THROW(load("dielectric", "1.3"));
    try {
        load("roughdielectric", "1.3");
        FAIL() << "not refused";
    } catch (const InputError& error) {
        EXPECT_NE(std::string(error.what()).find("int_ior and ext_ior are both 1.3"), std::string::npos)
            << error.what();
    }
}

}  // namespace
}  // namespace loom::test
