// Defaults of plugins, read from built scenes of both dialects. Values: sources of Mitsuba 0.6 and what Mitsuba 3.8
// prints of objects without parameters; docs/dialects.md has them all.

#include <gtest/gtest.h>

#include "stages/core/description/ior.h"
#include "stages/core/scene/build.h"
#include "tests/unit/scene_folder.h"

namespace loom::test {
namespace {

constexpr const char *mitsuba_06 = "0.6.0", *mitsuba_3 = "3.0.0";
constexpr const char* dialects[] = {mitsuba_06, mitsuba_3};

class Dialect : public SceneFolder {
  protected:
    std::unique_ptr<Scene> build(const std::string& body, const char* version) {
        return load_scene(write("scene.xml", text(body, version)));
    }
    /// The model of a sphere's BSDF.
    BsdfModel model(const std::string& bsdf, const char* version) {
        const auto scene = build("<shape type='sphere'>" + bsdf + "</shape>", version);
        return scene->materials[scene->shapes[0].material_idx].model;
    }
};

void expect_colour(const Spectrum& a, const Spectrum& b, float tolerance = 1e-6f) {
    for (int i = 0; i < 3; ++i) EXPECT_NEAR(a[i], b[i], tolerance * std::max(1.0f, std::abs(b[i]))) << "channel " << i;
}

// Detected mutations: copper in new files, none in old ones, the air outside left out.
TEST_F(Dialect, ConductorWithoutMaterialIsCopperInOldFilesAndAMirrorInNewOnes) {
    for (const char* type : {"conductor", "roughconductor"}) {
        const std::string plain = "<bsdf type='" + std::string(type) + "'/>";
        const BsdfModel old = model(plain, mitsuba_06), modern = model(plain, mitsuba_3);
        const float air = *dielectric_ior("air");
        expect_colour(old.eta_c, conductor_ior("Cu")->eta / air);
        expect_colour(old.k_c, conductor_ior("Cu")->k / air);
        expect_colour(modern.eta_c, Spectrum(0.0f));
        expect_colour(modern.k_c, Spectrum(1.0f));
    }
    // One of the two alone: the other is that of the material.
    const BsdfModel old = model("<bsdf type='conductor'><spectrum name='eta' value='0.5'/></bsdf>", mitsuba_06);
    expect_colour(old.eta_c * *dielectric_ior("air"), Spectrum(0.5f));
    expect_colour(old.k_c * *dielectric_ior("air"), conductor_ior("Cu")->k);
}

// Detected mutation: the default BSDF for emitters too.
TEST_F(Dialect, EmitterWithoutBsdfReflectsNothing) {
    const std::string lamp = "<emitter type='area'/>";
    for (const char* version : dialects) {
        SCOPED_TRACE(version);
        const auto material = [&](const std::string& inside) {
            const auto scene = build("<shape type='rectangle'>" + inside + "</shape>", version);
            return scene->materials[scene->shapes[0].material_idx];
        };
        EXPECT_TRUE(material(lamp).black());
        EXPECT_EQ(material("").model.diffuse, Spectrum(0.5f));
        EXPECT_EQ(material(lamp + "<bsdf type='diffuse'/>").model.diffuse, Spectrum(0.5f));
    }
}

// Detected mutations: swapped in both dialects, in neither, as a colour too.
TEST_F(Dialect, CheckerboardAsANumberIsTheOtherWayRoundInNewFiles) {
    const std::string board =
        "<bsdf type='roughconductor'><texture type='checkerboard' name='alpha'><rgb name='color0' value='0.1'/>"
        "<rgb name='color1' value='0.3'/></texture></bsdf>";
    for (const char* version : dialects) {
        const auto scene = build("<shape type='sphere'>" + board + "</shape>", version);
        const Texture& texture = scene->textures.at(std::size_t(scene->materials[0].alpha_u_idx));
        const bool swapped = version == mitsuba_3;
        EXPECT_NEAR(texture.eval_float({0.25f, 0.25f}), swapped ? 0.3 : 0.1, 1e-6) << version;
        EXPECT_NEAR(texture.eval_float({0.75f, 0.25f}), swapped ? 0.1 : 0.3, 1e-6) << version;
        EXPECT_NEAR(texture.eval({0.25f, 0.25f}).r, 0.1, 1e-6) << version;
        EXPECT_EQ(std::count_if(scene->notes.begin(), scene->notes.end(),
                                [](const std::string& note) { return note.find("checkerboard") != std::string::npos; }),
                  swapped);
    }
}

// Detected mutations: alpha 0.1 of roughdiffuse, polypropylene for glass, opacity 1, nonlinear, sample_visible off.
TEST_F(Dialect, DefaultsOfBsdfs) {
    const float bk7 = 1.5046f, polypropylene = 1.49f, air = 1.000277f;
    for (const char* version : dialects) {
        SCOPED_TRACE(version);
        const auto plain = [&](const char* type) { return model("<bsdf type='" + std::string(type) + "'/>", version); };
        EXPECT_EQ(plain("diffuse").diffuse, Spectrum(0.5f));
        EXPECT_FLOAT_EQ(plain("roughdiffuse").alpha_u, 0.2f);
        for (const char* type : {"dielectric", "thindielectric", "roughdielectric"}) {
            EXPECT_FLOAT_EQ(plain(type).int_ior, bk7) << type;
            EXPECT_FLOAT_EQ(plain(type).ext_ior, air) << type;
            EXPECT_EQ(plain(type).specular, Spectrum(1.0f)) << type;
            EXPECT_EQ(plain(type).transmittance, Spectrum(1.0f)) << type;
        }
        for (const char* type : {"plastic", "roughplastic"}) {
            EXPECT_FLOAT_EQ(plain(type).int_ior, polypropylene) << type;
            EXPECT_FLOAT_EQ(plain(type).ext_ior, air) << type;
            EXPECT_EQ(plain(type).diffuse, Spectrum(0.5f)) << type;
            EXPECT_EQ(plain(type).specular, Spectrum(1.0f)) << type;
            EXPECT_FALSE(plain(type).nonlinear) << type;
        }
        for (const char* type : {"roughconductor", "roughdielectric", "roughplastic"}) {
            EXPECT_EQ(plain(type).distribution, Microfacet::beckmann) << type;
            EXPECT_FLOAT_EQ(plain(type).alpha_u, 0.1f) << type;
            EXPECT_FLOAT_EQ(plain(type).alpha_v, 0.1f) << type;
            EXPECT_TRUE(plain(type).sample_visible) << type;
        }
        for (const char* type : {"phong", "ward"}) {
            EXPECT_EQ(plain(type).diffuse, Spectrum(0.5f)) << type;
            EXPECT_EQ(plain(type).specular, Spectrum(0.2f)) << type;
        }
        EXPECT_FLOAT_EQ(plain("phong").exponent, 30);
        EXPECT_FLOAT_EQ(plain("ward").alpha_u, 0.1f);
        EXPECT_FLOAT_EQ(plain("ward").alpha_v, 0.1f);
        EXPECT_FLOAT_EQ(model("<bsdf type='mask'><bsdf type='diffuse'/></bsdf>", version).opacity, 0.5f);
    }
}

// Detected mutations: a width of 512, a near_clip of 1 mm, `direct` of any depth, 50 mm along x instead of along the
// diagonal.
TEST_F(Dialect, DefaultsOfSensorFilmAndIntegrator) {
    for (const char* version : dialects) {
        SCOPED_TRACE(version);
        const auto scene = load_scene(
            write("scene.xml",
                  "<scene version='" + std::string(version) +
                      "'><integrator type='path'/><sensor type='perspective'><film type='hdrfilm'/></sensor></scene>"));
        const Sensor& s = scene->sensor;
        EXPECT_EQ(s.width, 768u);
        EXPECT_EQ(s.height, 576u);
        EXPECT_EQ(s.filter, Filter::gaussian);
        EXPECT_FLOAT_EQ(s.gaussian_stddev, 0.5f);
        EXPECT_FLOAT_EQ(s.filter_radius, 2);
        // 50 mm on 35 mm film; Mitsuba 3.8 prints x_fov = 38.1848.
        EXPECT_NEAR(std::atan(s.tan_half_fov_x) * 360 / pi_double, 38.1848, 1e-4);
        EXPECT_EQ(s.near_clip, 1e-2);
        EXPECT_EQ(s.far_clip, 1e4);
        EXPECT_EQ(scene->max_depth, -1);
        EXPECT_EQ(scene->rr_depth, 5);
        EXPECT_EQ(build("<integrator type='direct'/>", version)->max_depth, 2);
    }
}

// Detected mutations: cutoff_angle 30, beam_width half of it, irradiance 2.
TEST_F(Dialect, DefaultsOfEmitters) {
    constexpr double rad_per_deg = pi_double / 180;
    for (const char* version : dialects) {
        SCOPED_TRACE(version);
        const auto plain = [&](const char* type) {
            return build("<emitter type='" + std::string(type) + "'/>", version)->emitters.at(0);
        };
        for (const char* type : {"point", "spot", "directional", "constant", "projector"}) {
            EXPECT_EQ(plain(type).radiance, Spectrum(1.0f)) << type;
            EXPECT_EQ(plain(type).sampling_weight, 1) << type;
        }
        EXPECT_NEAR(plain("spot").cutoff_rad, 20 * rad_per_deg, 1e-6);
        EXPECT_NEAR(plain("spot").beam_rad, 15 * rad_per_deg, 1e-6);
        EXPECT_NEAR(std::atan(plain("projector").tan_x) / rad_per_deg * 2, 34.0221, 1e-4);  // as printed by Mitsuba 3.8
        EXPECT_EQ(plain("directional").frame.n, Normal3f(0, 0, 1));
        EXPECT_EQ(build("<shape type='sphere'><emitter type='area'/></shape>", version)->emitters.at(0).radiance,
                  Spectrum(1.0f));
    }
}

// Detected mutation: the two colours swapped.
TEST_F(Dialect, DefaultsOfTextures) {
    for (const char* version : dialects) {
        const auto scene = build(
            "<shape type='sphere'><bsdf type='diffuse'><texture type='checkerboard' "
            "name='reflectance'/></bsdf></shape>",
            version);
        expect_colour(scene->textures.at(0).eval({0.25f, 0.25f}), Spectrum(0.4f));
        expect_colour(scene->textures.at(0).eval({0.75f, 0.25f}), Spectrum(0.2f));
    }
}

// Parameters in the sources of Mitsuba 0.6 beyond its documentation. Detected mutation: each of them unknown, as
// before: a warning, and the default instead.
TEST_F(Dialect, ParametersOfOldFilesAlone) {
    for (const char* type : {"diffuse", "roughdiffuse"}) {
        const std::string named = "<bsdf type='" + std::string(type) + "'><rgb name='";
        EXPECT_EQ(model(named + "diffuseReflectance' value='0.1, 0.2, 0.3'/></bsdf>", mitsuba_06).diffuse,
                  Spectrum(0.1f, 0.2f, 0.3f))
            << type;
        EXPECT_EQ(
            model(named + "diffuseReflectance' value='0.1'/><rgb name='reflectance' value='0.7'/></bsdf>", mitsuba_06)
                .diffuse,
            Spectrum(0.7f))
            << type;
        EXPECT_NE(error_of([&] {
                      build(named + "diffuse_reflectance' value='0.1'/></bsdf>", mitsuba_3);
                  }).find("has no parameter 'diffuse_reflectance'"),
                  std::string::npos);
    }
    EXPECT_NE(error_of([&] {
                  build("<bsdf type='diffuse'><texture type='checkerboard' name='diffuse_reflectance'/></bsdf>",
                        mitsuba_3);
              }).find("has no parameter"),
              std::string::npos);
    const BsdfModel ward = model(
        "<bsdf type='ward'><float name='alpha' value='0.3'/><float name='alphaV' value='0.2'/></bsdf>", mitsuba_06);
    EXPECT_FLOAT_EQ(ward.alpha_u, 0.3f);
    EXPECT_FLOAT_EQ(ward.alpha_v, 0.2f);
    const auto sky = [&](const std::string& parameters) {
        const auto scene = build("<emitter type='sunsky'>" + parameters + "</emitter>", mitsuba_06);
        return Rgb<double>(environment(*scene, Vector3f(0, 1, 0))).g;
    };
    EXPECT_NEAR(sky("<float name='scale' value='3'/>") / sky(""), 3, 1e-4);
    EXPECT_NEAR(sky("<float name='scale' value='3'/><float name='skyScale' value='2'/>") / sky(""), 2, 1e-4);
}

// Mitsuba 0.6 scales a reflectance above 1 to a largest channel of 0.99, and phong and ward by the sum of their lobes.
// Detected mutation: channels clamped to 1.
TEST_F(Dialect, ReflectancesAboveOneAreScaledInOldFiles) {
    const auto bsdf = [&](const char* type, const char* parameters, const char* version) {
        return model(std::string("<bsdf type='") + type + "'>" + parameters + "</bsdf>", version);
    };
    expect_colour(bsdf("diffuse", "<rgb name='reflectance' value='2, 1, 0.5'/>", mitsuba_06).diffuse,
                  Spectrum(0.99f, 0.495f, 0.2475f));
    expect_colour(bsdf("diffuse", "<rgb name='reflectance' value='1, 1, 0.5'/>", mitsuba_06).diffuse,
                  Spectrum(1, 1, 0.5f));
    for (const char* type : {"phong", "ward"}) {
        const BsdfModel m = bsdf(
            type, "<spectrum name='diffuseReflectance' value='1.5'/><spectrum name='specularReflectance' value='0.5'/>",
            mitsuba_06);
        expect_colour(m.diffuse, Spectrum(1.5f * 0.495f));
        expect_colour(m.specular, Spectrum(0.5f * 0.495f));
    }
    EXPECT_NE(error_of([&] {
                  bsdf("diffuse", "<rgb name='reflectance' value='2, 1, 0.5'/>", mitsuba_3);
              }).find("must lie between 0 and 1"),
              std::string::npos);
}

}  // namespace
}  // namespace loom::test
