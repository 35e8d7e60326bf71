// Light samples against the density that multiple importance sampling requires: over directions by chi-square, and
// direction by direction. Detected mutations: no cosine in the density of an area light, the cone's 1 - cos_max
// squared, sin(theta) left out of the environment's density or derived from its cosine (wrong by 12 % near the poles),
// the choice of the emitter left out of pdf_light_w.

#include <OpenImageIO/imageio.h>
#include <fmt/format.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <span>
#include <string>
#include <vector>

#include "formats/image.h"
#include "stages/core/sampling/sampler.h"
#include "stages/core/sampling/warp.h"
#include "stages/core/scene/build.h"
#include "stages/core/stats/chi_square.h"
#include "tests/unit/bsdf_cases.h"
#include "tests/unit/scene_folder.h"

namespace loom::test {
namespace {

/// Density with which sample_light finds direction d on the surface that is hit there first.
double surface_density(const Scene& scene, const Point3f& from, const Vector3f& d) {
    const Ray ray{from, d};
    const Hit hit = scene.intersect(ray);
    if (!hit) return 0;
    const SurfacePoint at = scene.surface(ray, hit);
    return is_black(emitted(scene, at, -d)) ? 0 : pdf_light_w(scene, from, at);
}
double environment_density(const Scene& scene, const Vector3f& d) {
    return scene.environment_idx >= 0 ? pdf_environment_w(scene, d) : 0;
}

/// Cells of equal solid angle about an axis that no light here is aligned with.
struct Cells {
    static constexpr int n_z = 20, n_phi = 20, n = n_z * n_phi;
    Framef frame{normalize(Normal3f(0.36f, 0.48f, 0.8f))};

    int of(const Vector3f& d) const {
        const Vector3f local = frame.to_local(d);
        const double phi = std::atan2(local.y, local.x) / (2 * pi_double);
        const int i = std::min(int((local.z + 1.0) / 2 * n_z), n_z - 1);
        return i * n_phi + std::min(int((phi < 0 ? phi + 1 : phi) * n_phi), n_phi - 1);
    }
    Vector3f direction(double i, double j) const {
        const double z = 2 * i / n_z - 1, phi = 2 * pi_double * j / n_phi, r = std::sqrt(std::max(1 - z * z, 0.0));
        return frame.to_world({float(r * std::cos(phi)), float(r * std::sin(phi)), float(z)});
    }
};

class Emitters : public SceneFolder {
  protected:
    void expect_samples_follow_density(const Scene& scene, const Point3f& from, const std::string& what) {
        const Cells cells;
        constexpr int n = 1 << 15, sub = 32;  // sub x sub points in a cell: its edges are off by less than the noise
        std::vector<double> expected(Cells::n + 1), observed(Cells::n + 1);
        double found = 0;
        for (int i = 0; i < Cells::n_z * sub; ++i)
            for (int j = 0; j < Cells::n_phi * sub; ++j) {
                const Vector3f d = cells.direction((i + 0.5) / sub, (j + 0.5) / sub);
                const double pdf = surface_density(scene, from, d) + environment_density(scene, d);
                const double samples = n * pdf * 4 * pi_double / (double(Cells::n) * sub * sub);
                expected[i / sub * Cells::n_phi + j / sub] += samples;
                found += samples;
            }
        EXPECT_LE(found, n * 1.003) << what;
        // The last cell: samples that find the unlit side of their emitter.
        expected.back() = std::max(0.0, n - found);
        int compared = 0;
        for (int i = 0; i < n; ++i) {
            const LightSample s = sample_light(scene, from, Sampler(SamplerKind::independent, 21, 0, i).pair(0));
            if (s.density() == 0) {
                ++observed.back();
                continue;
            }
            ASSERT_NEAR(length(s.wi), 1, 1e-5);
            ++observed[cells.of(s.wi)];
            if (i % 16 != 0) continue;
            // At the very edge of a light the ray may miss it: then there is nothing to compare with.
            const double pdf = s.at_infinity ? environment_density(scene, s.wi) : surface_density(scene, from, s.wi);
            if (pdf == 0) continue;
            ++compared;
            EXPECT_NEAR(s.pdf_w / pdf, 1, 2e-3) << what;
        }
        EXPECT_GT(compared, n / 64) << what;
        const ChiSquareResult result = chi_square_test(observed, expected);
        EXPECT_GE(result.p_value, sidak_alpha(n_comparisons))
            << what << ": chi2 " << result.statistic << " dof " << result.dof;
        EXPECT_LE(result.stray, n * 1e-4) << what;
    }
    std::unique_ptr<Scene> scene_of(const std::string& body) { return load_scene(write("scene.xml", text(body))); }
    static std::string lamp(const std::string& shape, const std::string& place, const std::string& more = "") {
        return "<shape type='" + shape + "'>" + more + "<transform name='to_world'>" + place +
               "</transform><emitter type='area'/></shape>\n";
    }
};

constexpr Point3f origin{0.1f, -0.2f, 0.05f};
const std::string tilted = "<rotate x='1' y='2' z='0.5' angle='205'/><translate x='0.4' y='-0.3' z='1.4'/>";

TEST_F(Emitters, Mesh) {
    expect_samples_follow_density(*scene_of(lamp("rectangle", tilted)), origin, "rectangle");
    expect_samples_follow_density(*scene_of(lamp("cube", "<scale x='0.3' y='0.5' z='0.2'/>" + tilted)), origin, "cube");
    expect_samples_follow_density(*scene_of(lamp("rectangle", "<scale x='-1'/>" + tilted)), origin,
                                  "mirrored rectangle");
}

TEST_F(Emitters, SphereFromOutsideAndInside) {
    const std::string place = "<scale value='0.8'/><translate x='0.5' y='-0.3' z='1.1'/>";
    expect_samples_follow_density(*scene_of(lamp("sphere", place)), origin, "from outside");
    expect_samples_follow_density(
        *scene_of(lamp("sphere", "<scale value='2'/>" + place, "<boolean name='flip_normals' value='true'/>")), origin,
        "from inside");
    // Far away the cone is narrow: nothing may cancel.
    const auto far = scene_of(lamp("sphere", "<translate x='2000' y='1000' z='2000'/>"));
    const LightSample s = sample_light(*far, origin, {0.3f, 0.7f});
    EXPECT_NEAR(s.pdf_w * pi_double / 9e6, 1, 1e-3);
}

TEST_F(Emitters, SphereFromInsideIsDarkWhenItShinesOutwards) {
    const auto scene = scene_of(lamp("sphere", "<scale value='3'/>"));
    for (int i = 0; i < 100; ++i)
        EXPECT_EQ(sample_light(*scene, origin, Sampler(SamplerKind::sobol, 1, 0, i).pair(0)).density(), 0);
}

TEST_F(Emitters, Disk) {
    expect_samples_follow_density(*scene_of(lamp("disk", tilted)), origin, "disk");
    expect_samples_follow_density(*scene_of(lamp("disk", "<scale x='0.5' y='1.2'/>" + tilted)), origin, "ellipse");
}

/// Where a sample and a ray find the same point of a light, they must find the same radiance. With the densities above,
/// next-event estimation and hits by the BSDF then estimate the same integral. The texture is smooth, 3 to 1 along both
/// of its axes, so that swapped, rotated or missing texture coordinates in one of the two differ in every sample.
/// Detected mutation: the radiance of a sphere without its texture.
TEST_F(Emitters, TextureOfALightSampleIsThatOfTheHit) {
    {
        auto out = OIIO::ImageOutput::create(path("map.exr").string());
        const OIIO::ImageSpec spec(16, 16, 3, OIIO::TypeDesc::FLOAT);
        std::vector<float> texels;
        for (int i = 0; i < 256; ++i) texels.insert(texels.end(), {1 + float(i % 16) / 8, 1 + float(i / 16) / 8, 1});
        ASSERT_TRUE(out->open(path("map.exr").string(), spec) &&
                    out->write_image(OIIO::TypeDesc::FLOAT, texels.data()));
        out->close();
    }
    write("triangle.obj", "v -1 -1 0\nv 1 -1 0\nv 0 1 0\nf 1 2 3\n");
    write("mapped.obj", "v -1 -1 0\nv 1 -1 0\nv 0 1 0\nvt 0.9 0.1\nvt 0.2 0.3\nvt 0.4 0.8\nf 1/1 2/2 3/3\n");
    const std::string emitter =
        "<emitter type='area'><texture type='bitmap' name='radiance'><string name='filename' value='map.exr'/>"
        "<string name='wrap_mode' value='clamp'/></texture></emitter></shape>\n";
    const auto shape = [&](const std::string& type, const std::string& place, const std::string& more = "") {
        return scene_of("<shape type='" + type + "'>" + more + "<transform name='to_world'>" + place + "</transform>" +
                        emitter);
    };
    const std::string turned = "<rotate x='1' y='2' z='0.5' angle='205'/>",
                      there = "<translate x='0.4' y='-0.3' z='1.4'/>";
    const std::string flip = "<boolean name='flip_normals' value='true'/>";
    const auto file = [](const std::string& name) { return "<string name='filename' value='" + name + "'/>"; };
    const std::vector<std::pair<std::string, std::unique_ptr<Scene>>> scenes = [&] {
        std::vector<std::pair<std::string, std::unique_ptr<Scene>>> s;
        s.emplace_back("sphere from outside", shape("sphere", turned + there));
        s.emplace_back("sphere from inside", shape("sphere", "<scale value='3'/>" + turned + there, flip));
        s.emplace_back("mirrored sphere from inside", shape("sphere", "<scale x='-3' y='3' z='3'/>" + turned + there));
        s.emplace_back("sphere close by", shape("sphere", "<scale value='1.36'/>" + turned + there));
        s.emplace_back("disk", shape("disk", tilted));
        s.emplace_back("rectangle", shape("rectangle", tilted));
        s.emplace_back("mirrored rectangle", shape("rectangle", "<scale x='-1'/>" + tilted));
        s.emplace_back("cube", shape("cube", "<scale value='0.4'/>" + tilted));
        s.emplace_back("mesh without coordinates", shape("obj", tilted, file("triangle.obj")));
        s.emplace_back("mesh", shape("obj", tilted, file("mapped.obj")));
        return s;
    }();
    for (const auto& [name, scene] : scenes) {
        constexpr int n = 2000;
        int compared = 0;
        double smallest = INFINITY, largest = 0;
        for (int i = 0; i < n; ++i) {
            const LightSample s = sample_light(*scene, origin, Sampler(SamplerKind::independent, 5, 0, i).pair(0));
            if (s.density() == 0) continue;
            const Ray ray{origin, s.wi};
            const Hit hit = scene->intersect(ray);
            if (!hit) continue;  // at the very edge
            const SurfacePoint at = scene->surface(ray, hit);
            if (length(at.p - s.y) > 1e-3f) continue;  // the far side of a cube or sphere
            ++compared;
            const Spectrum Le = emitted(*scene, at, -s.wi);
            EXPECT_NEAR(s.Li.r / Le.r, 1, 2e-3) << name;
            EXPECT_NEAR(s.Li.g / Le.g, 1, 2e-3) << name;
            smallest = std::min(smallest, double(Le.r)), largest = std::max(largest, double(Le.r));
        }
        EXPECT_GT(compared, n / 8) << name;
        EXPECT_GT(largest, 1.05 * smallest) << name;  // by far more than the tolerance
    }
}

TEST_F(Emitters, Constant) {
    expect_samples_follow_density(*scene_of("<emitter type='constant'/>"), origin, "constant");
}

TEST_F(Emitters, EnvironmentMap) {
    const std::string map = (std::filesystem::path(LOOM_SOURCE_DIR) / "scenes/textures/sky.png").string();
    expect_samples_follow_density(
        *scene_of("<emitter type='envmap'><string name='filename' value='" + map +
                  "'/><transform name='to_world'><rotate x='1' y='0.3' angle='70'/></transform></emitter>"),
        origin, "envmap");
}

// None of the surfaces hides another: the densities of all add up, each with the choice of its emitter.
TEST_F(Emitters, SeveralWithWeights) {
    expect_samples_follow_density(
        *scene_of("<emitter type='constant'><float name='sampling_weight' value='0.5'/></emitter>\n" +
                  lamp("rectangle", tilted) +
                  lamp("sphere", "<scale value='0.4'/><translate x='-1.5' y='1' z='-0.5'/>")),
        origin, "constant, rectangle and sphere");
}

TEST_F(Emitters, DeltaLightsHaveAProbabilityForADensity) {
    const auto scene = scene_of(
        "<emitter type='point'><point name='position' x='0' y='0' z='2'/><rgb name='intensity' value='8'/></emitter>\n"
        "<emitter type='directional'><vector name='direction' x='0' y='-3' z='-4'/><rgb name='irradiance' value='5'/>"
        "<float name='sampling_weight' value='3'/></emitter>");
    const LightSample point = sample_light(*scene, {0, 0, 0}, {0.1f, 0.5f});
    EXPECT_TRUE(point.delta);
    EXPECT_FALSE(point.at_infinity);
    EXPECT_EQ(point.density(), 0.25f);
    EXPECT_NEAR(point.Li.g, 2, 1e-6);
    const LightSample sun = sample_light(*scene, {0, 0, 0}, {0.9f, 0.5f});
    EXPECT_TRUE(sun.delta);
    EXPECT_TRUE(sun.at_infinity);
    EXPECT_EQ(sun.density(), 0.75f);
    EXPECT_EQ(sun.Li.g, 5);
    EXPECT_NEAR(sun.wi.y, 0.6, 1e-6);
    EXPECT_NEAR(sun.wi.z, 0.8, 1e-6);
}

/// An EXR with every pixel (r, r, r), but the last.
std::string write_map(const std::filesystem::path& file, float value, float last) {
    Image image;
    image.width = 4, image.height = 2;
    for (const char* channel : {"R", "G", "B"}) {
        const std::span<float> values = image.add(channel);
        std::fill(values.begin(), values.end(), value);
        values.back() = last;
    }
    write_image(image, file);
    return "<emitter type='envmap'><string name='filename' value='" + file.filename().string() + "'/>";
}

// A density whose weights add up to zero ended in a segmentation fault.
TEST_F(Emitters, AMapWithoutLightIsNoLight) {
    const std::string black = write_map(path("black.exr"), 0, 0), grey = write_map(path("grey.exr"), 1, 1);
    for (const std::string& map : {black + "</emitter>", grey + "<float name='scale' value='0'/></emitter>",
                                   std::string("<emitter type='sunsky'><float name='sun_scale' value='0'/><float "
                                               "name='sky_scale' value='0'/></emitter>")}) {
        const auto scene = scene_of(map + "<emitter type='point'/>");
        EXPECT_EQ(environment(*scene, {0, 1, 0}), Spectrum(0));
        std::vector<LightQuery> queries(3);
        for (LightQuery& query : queries) query.kind = LightQuery::Kind::environment, query.d = {0, 0.6f, 0.8f};
        queries[1].kind = LightQuery::Kind::point, queries[1].u = {0.1f, 0.5f};
        queries[2].kind = LightQuery::Kind::point, queries[2].u = {0.9f, 0.5f};
        look_up_lights(*scene, queries);
        EXPECT_EQ(queries[0].Le, Spectrum(0));
        EXPECT_EQ(sample_light(*scene, {0, 0, 0}, queries[2]).density() +
                      sample_light(*scene, {0, 0, 0}, queries[1]).density(),
                  0.5f);
    }
}

TEST_F(Emitters, NegativeValuesOfAMapCountAsZeroAndAreNoted) {
    const auto scene = scene_of(write_map(path("map.exr"), 2, -1) + "</emitter>");
    const std::vector<Spectrum>& texels = scene->emitters[0].map->texels;
    EXPECT_EQ(texels[0], Spectrum(2));
    EXPECT_EQ(texels[7], Spectrum(0));
    EXPECT_EQ(scene->notes.back(),
              "warning: map.exr: 1 of 8 pixels have negative values (lowest -1), which are read as 0");
}

TEST_F(Emitters, ATexturedLightWithNegativeValuesIsAnError) {
    write_map(path("map.exr"), 2, -1);
    const std::string body =
        "<shape type='sphere'><emitter type='area'><texture type='bitmap' name='radiance'>"
        "<string name='filename' value='map.exr'/></texture></emitter></shape>";
    EXPECT_NE(error_of([&] { scene_of(body); }).find("scene.xml:2:113: the image has negative values"),
              std::string::npos);
}

// Weights of zero: an error when light could be found by chance only, nothing when there is no light to be found.
TEST_F(Emitters, WeightsThatAddUpToNothing) {
    const std::string weight = "<float name='sampling_weight' value='0'/>",
                      lit = "<emitter type='constant'>" + weight + "</emitter>";
    EXPECT_NE(error_of([&] {
                  scene_of(lit + "<emitter type='point'>" + weight + "</emitter>");
              }).find("scene.xml:2:63: 'sampling_weight' is 0 for every emitter"),
              std::string::npos);
    const auto dark = scene_of("<emitter type='constant'><rgb name='radiance' value='0'/>" + weight + "</emitter>");
    EXPECT_EQ(sample_light(*dark, {0, 0, 0}, {0.5f, 0.5f}).density(), 0);
    EXPECT_EQ(dark->notes.back(), "no emitter of the scene emits light: its images are black");
    EXPECT_EQ(scene_of("")->notes.back(), dark->notes.back());
    // The constant light is found by BSDF sampling alone.
    const auto half = scene_of(lit + "<emitter type='point'/>");
    EXPECT_EQ(pdf_environment_w(*half, {0, 1, 0}), 0);
    EXPECT_EQ(environment(*half, {0, 1, 0}), Spectrum(1));
}

// Many queries at once equal single queries bit for bit, for any emitters. Detected mutation: the pmf of the
// environment left out of the density of a miss.
TEST_F(Emitters, ManyQueriesAtOnceEqualOneByOne) {
    const std::string map = "<emitter type='envmap'><string name='filename' value='" +
                            (std::filesystem::path(LOOM_SOURCE_DIR) / "scenes/textures/sky.png").string() +
                            "'/></emitter>\n";
    const std::string sphere = lamp("sphere", "<translate x='4'/>"), point = "<emitter type='point'/>";
    for (const std::string& emitters :
         {map, map + lamp("rectangle", tilted) + sphere + point, sphere + point, std::string()}) {
        const auto scene = scene_of(emitters);
        std::vector<LightQuery> many(1000);
        for (std::size_t i = 0; i < many.size(); ++i) {
            many[i].kind = LightQuery::Kind(i % 3);
            many[i].u = Sampler(SamplerKind::independent, 5, 0, i).pair(0);
            many[i].d = sample_uniform_sphere(many[i].u);
        }
        const std::vector<LightQuery> asked = many;
        look_up_lights(*scene, many);
        for (std::size_t i = 0; i < many.size(); ++i) {
            LightQuery one = asked[i];
            look_up_light(*scene, one);
            EXPECT_EQ(many[i].placed, one.placed);
            EXPECT_EQ(many[i].point.emitter_idx, one.point.emitter_idx);
            EXPECT_EQ(many[i].point.pmf, one.point.pmf);
            EXPECT_EQ(many[i].pdf_w, one.pdf_w);
            EXPECT_EQ(many[i].Le, one.Le);
            if (one.kind == LightQuery::Kind::point && !one.placed) {
                EXPECT_EQ(many[i].u.x, one.u.x);
            }
            EXPECT_EQ(many[i].point.Li, one.point.Li);
            EXPECT_EQ(Vector3f(many[i].point.y), Vector3f(one.point.y));
            EXPECT_EQ(many[i].point.pdf_w, one.point.pdf_w);
        }
    }
}

}  // namespace
}  // namespace loom::test
