// What a parameter changes: $parameters found by differences against named parts, and what is refused, where and why.
#include <gtest/gtest.h>

#include <cmath>

#include "stages/core/scene/build.h"
#include "stages/derive/scene_tangents.h"
#include "tests/unit/scene_folder.h"

namespace loom::derive {
namespace {

using Vec = Vector3<double>;

class DeriveParameters : public SceneFolder {
  protected:
    /// A scene of one ball, one plate, lights and a camera, with a piece replaced.
    std::string scene(const std::string& from = {}, const std::string& to = {}) const {
        std::string xml = R"(<scene version="3.0.0">
<default name="theta" value="0"/>
<integrator type="path"/>
<sensor type="perspective"><float name="fov" value="40"/><transform name="to_world"><lookat origin="0.5, 1, 4" target="0, 0, 0" up="0, 1, 0"/></transform>
<film type="hdrfilm"><integer name="width" value="8"/><integer name="height" value="8"/></film></sensor>
<bsdf type="diffuse" id="matte"><rgb name="reflectance" value="0.5"/></bsdf>
<bsdf type="roughconductor" id="metal"><string name="distribution" value="ggx"/><float name="alpha" value="0.2"/><string name="material" value="Al"/></bsdf>
<bsdf type="dielectric" id="glass"><float name="int_ior" value="1.5"/></bsdf>
<shape type="cube" id="box"><transform name="to_world"><scale value="1"/><translate x="1.5"/></transform><ref id="matte"/></shape>
<shape type="rectangle" id="plate"><transform name="to_world"><translate y="-1"/></transform><ref id="metal"/></shape>
<shape type="sphere" id="ball"><point name="center" x="0.3" y="0.2" z="0.1"/><float name="radius" value="0.5"/><ref id="glass"/></shape>
<shape type="rectangle" id="lamp"><transform name="to_world"><translate y="2"/></transform><emitter type="area"><rgb name="radiance" value="3"/></emitter></shape>
<emitter type="point" id="point"><point name="position" x="1" y="2" z="1"/><rgb name="intensity" value="2"/></emitter>
<emitter type="constant" id="sky"><rgb name="radiance" value="1"/></emitter>
</scene>)";
        if (from.empty()) return xml;
        const std::size_t at = xml.find(from);
        EXPECT_NE(at, std::string::npos) << from;
        return xml.replace(at, from.size(), to);
    }
    struct Found {
        std::unique_ptr<Scene> scene;
        SceneTangents tangents;
    };
    Found find(const std::string& xml, const std::vector<std::string>& names, const Defines& defines = {}) const {
        const auto file = write("s.xml", xml);
        const SceneDescription description = read_scene(file, defines, "");
        std::unique_ptr<Scene> scene = build_scene(description);
        SceneTangents tangents = find_tangents(*scene, description, file, defines, "", names);
        return {std::move(scene), std::move(tangents)};
    }
    std::string refusal(const std::string& xml, const std::string& name, const Defines& defines = {}) const {
        return error_of([&] { find(xml, {name}, defines); });
    }
    template <class Things>
    static std::size_t index(const Things& things, const std::string& id) {
        for (std::size_t i = 0; i < things.size(); ++i)
            if (things[i].id == id) return i;
        ADD_FAILURE() << id;
        return 0;
    }
    static void expect_near(const AffineVelocity& a, const AffineVelocity& b, double tolerance = 1e-7) {
        for (std::size_t i = 0; i < 9; ++i) EXPECT_NEAR(a.linear[i], b.linear[i], tolerance) << i;
        for (int k = 0; k < 3; ++k) EXPECT_NEAR(a.offset[k], b.offset[k], tolerance) << k;
    }
};

TEST_F(DeriveParameters, MotionsOfShapesAreFound) {
    const Found named = find(scene(), {"shape:box/pose", "shape:box/scale"});
    const auto& parts = named.tangents.shapes[index(named.scene->shapes, "box")];
    ASSERT_EQ(parts.size(), 7u);
    ASSERT_EQ(named.tangents.parameters[4].name, "shape:box/pose.ry");
    EXPECT_EQ(named.tangents.parameters[4].unit, "rad");
    EXPECT_EQ(named.tangents.parameters[6].name, "shape:box/scale");
    const char *scale = R"(<scale value="1"/>)", *shift = R"(<translate x="1.5"/>)";
    const auto found = [&](const char* from, const char* to, const Defines& defines = {}) {
        const Found f = find(scene(from, to), {"theta"}, defines);
        const auto& effects = f.tangents.shapes[index(f.scene->shapes, "box")];
        EXPECT_EQ(effects.size(), 1u);
        std::size_t n = 0;
        for (const auto& of : f.tangents.shapes) n += of.size();
        EXPECT_EQ(n, 1u);
        EXPECT_FALSE(f.tangents.camera_moves());
        return effects.at(0).effect;
    };
    expect_near(found(shift, R"(<translate x="1.5" y="$theta"/>)"), parts[1].effect);
    AffineVelocity turn = parts[4].effect;
    for (double& x : turn.linear) x *= M_PI / 180;
    turn.offset = turn.offset * (M_PI / 180);
    expect_near(found(scale, R"(<rotate y="1" angle="$theta"/>)"), turn, 1e-6);
    // A turn that has begun has the same velocity field.
    expect_near(found(scale, R"(<rotate y="1" angle="$theta"/>)", {{"theta", "33"}}), turn, 1e-6);
    expect_near(found(scale, R"(<scale value="$theta"/>)", {{"theta", "1"}}), parts[6].effect, 1e-6);
    // d log / d theta of a scale is 1 / theta.
    AffineVelocity half = parts[6].effect;
    for (double& x : half.linear) x *= 0.5;
    half.offset = half.offset * 0.5;
    expect_near(found(scale, R"(<scale value="$theta"/>)", {{"theta", "2"}}), half, 1e-6);
}

TEST_F(DeriveParameters, MaterialsAndLightsAreFound) {
    struct {
        const char *named, *from, *to, *value;
        double per_unit = 1;
    } const cases[] = {
        {"bsdf:matte/reflectance", R"(name="reflectance" value="0.5")", R"(name="reflectance" value="$theta")", "0.5"},
        {"bsdf:metal/alpha", R"(name="alpha" value="0.2")", R"(name="alpha" value="$theta")", "0.2"},
        {"bsdf:glass/int_ior", R"(value="1.5"/></bsdf>)", R"(value="$theta"/></bsdf>)", "1.5"},
        {"shape:lamp/radiance", R"(name="radiance" value="3")", R"(name="radiance" value="$theta")", "3"},
        {"emitter:point/radiance", R"(name="intensity" value="2")", R"(name="intensity" value="$theta")", "2"},
        {"emitter:sky/radiance", R"(name="radiance" value="1")", R"(name="radiance" value="$theta")", "1"},
    };
    for (const auto& c : cases) {
        SCOPED_TRACE(c.named);
        const Found named = find(scene(), {c.named}),
                    found = find(scene(c.from, c.to), {"theta"}, {{"theta", c.value}});
        ASSERT_EQ(named.tangents.n(), 1u);
        EXPECT_FALSE(found.tangents.geometry());
        std::size_t n = 0;
        for (std::size_t m = 0; m < named.scene->materials.size(); ++m) {
            const auto &a = named.tangents.materials[m], &b = found.tangents.materials[m];
            ASSERT_EQ(a.size(), b.size()) << m;
            if (a.empty()) continue;
            ++n;
            std::vector<double> values;
            MaterialTangent::each(a[0].effect, [&](double x) { values.push_back(x); });
            std::size_t i = 0;
            MaterialTangent::each(b[0].effect, [&](double x) { EXPECT_NEAR(x, values[i++], 1e-5); });
        }
        for (std::size_t e = 0; e < named.scene->emitters.size(); ++e) {
            const auto &a = named.tangents.radiance[e], &b = found.tangents.radiance[e];
            ASSERT_EQ(a.size(), b.size()) << e;
            if (a.empty()) continue;
            ++n;
            for (int k = 0; k < 3; ++k) EXPECT_NEAR(a[0].effect[k], b[0].effect[k], 1e-5);
        }
        EXPECT_EQ(n, 1u);
        EXPECT_FLOAT_EQ(float(found.tangents.parameters[0].value), float(named.tangents.parameters[0].value));
    }
}

TEST_F(DeriveParameters, CameraAndPointLightAreFound) {
    const Found named = find(scene(), {"sensor/pose", "emitter:point/pose"});
    ASSERT_EQ(named.tangents.camera.size(), 6u);
    {
        const Found f =
            find(scene("<lookat origin=\"0.5, 1, 4\" target=\"0, 0, 0\" up=\"0, 1, 0\"/>",
                       "<lookat origin=\"0.5, 1, 4\" target=\"0, 0, 0\" up=\"0, 1, 0\"/><translate x=\"$theta\"/>"),
                 {"theta"});
        ASSERT_EQ(f.tangents.camera.size(), 1u);
        expect_near(f.tangents.camera[0].effect, named.tangents.camera[0].effect);
        EXPECT_FALSE(f.tangents.any_shape_moves());
    }
    {
        const Found f = find(scene(R"(x="1" y="2" z="1")", R"(x="1" y="$theta" z="1")"), {"theta"}, {{"theta", "2"}});
        const std::size_t e = index(f.scene->emitters, "point");
        ASSERT_EQ(f.tangents.emitters[e].size(), 1u);
        expect_near(f.tangents.emitters[e][0].effect, named.tangents.emitters[e][1].effect);
    }
    {
        // tan(fov / 2) grows by 1 / (2 sin cos) = 1 / sin(fov) per radian.
        const Found f =
            find(scene(R"(name="fov" value="40")", R"(name="fov" value="$theta")"), {"theta"}, {{"theta", "40"}});
        ASSERT_EQ(f.tangents.lens.size(), 1u);
        EXPECT_TRUE(f.tangents.camera.empty());
        EXPECT_NEAR(f.tangents.lens[0].effect, M_PI / 180 / std::sin(40 * M_PI / 180), 1e-6);
    }
}

// At the end of a parameter's range its values are read on one side.
TEST_F(DeriveParameters, EndsOfRangesAreReadOnOneSide) {
    for (const char* value : {"1", "0"}) {
        const Found f = find(scene(R"(name="reflectance" value="0.5")", R"(name="reflectance" value="$theta")"),
                             {"theta"}, {{"theta", value}});
        const auto& effects = f.tangents.materials[index(f.scene->materials, "matte")];
        ASSERT_EQ(effects.size(), 1u) << value;
        for (int c = 0; c < 3; ++c) EXPECT_NEAR(effects[0].effect.diffuse[c], 1, 1e-4) << value;
    }
}

TEST_F(DeriveParameters, RefusalsNameThePlace) {
    const std::string no = ": no derivative by it";
    const auto expect = [&](const std::string& message, const std::string& place, const std::string& part) {
        EXPECT_TRUE(message.starts_with(place)) << message;
        EXPECT_NE(message.find(part), std::string::npos) << message;
    };
    // Other kinds of changes.
    expect(refusal(scene(R"(<integer name="width" value="8"/>)", R"(<integer name="width" value="$theta"/>)"), "theta",
                   {{"theta", "8"}}),
           "", "theta");
    expect(
        refusal(scene(R"(name="radius" value="0.5")", R"(name="radius" value="$theta")"), "theta", {{"theta", "0.5"}}),
        "no error", "no error");
    expect(refusal(scene(R"(<integrator type="path"/>)",
                         R"(<integrator type="path"><integer name="max_depth" value="$theta"/></integrator>)"),
                   "theta", {{"theta", "3"}}),
           "", "theta");
    expect(
        refusal(
            scene(R"(<rgb name="reflectance" value="0.5"/>)",
                  R"(<texture type="checkerboard" name="reflectance"><rgb name="color0" value="$theta"/></texture>)"),
            "theta", {{"theta", "0.5"}}),
        "s.xml:6:", "one of its textures changes" + no);
    expect(refusal(scene(R"(<sensor type="perspective">)",
                         R"(<sensor type="perspective"><float name="near_clip" value="$theta"/>)"),
                   "theta", {{"theta", "0.1"}}),
           "s.xml:", "more of the sensor changes than its to_world and field of view" + no);
    // Another mesh file.
    write("m0.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n");
    expect(refusal(scene("<shape type=\"cube\" id=\"box\">",
                         "<shape type=\"obj\" id=\"mesh\"><string name=\"filename\" "
                         "value=\"m$theta.obj\"/></shape>\n<shape type=\"cube\" id=\"box\">"),
                   "theta"),
           "--wrt theta: the scene cannot be read at theta = 0 plus and minus 0.01: s.xml:9:", "not found");
    // Unknown names.
    EXPECT_EQ(refusal(scene(R"(value="3")", R"(value="$theta")"), "phi"),
              "--wrt phi: s.xml has no parameter $phi; it has theta");
    EXPECT_EQ(refusal(scene(), "shape:nobody/pose"),
              "--wrt shape:nobody/pose: the scene has no shape 'nobody'; it has box, plate, ball, lamp");
    EXPECT_EQ(refusal(scene(), "bsdf:matte/colour").substr(0, 46), "--wrt bsdf:matte/colour: 'colour' is none of r");
    EXPECT_EQ(refusal(scene(), "lens:a/pose"), "--wrt lens:a/pose: 'lens' is none of shape, bsdf, emitter");
    EXPECT_EQ(refusal(scene(), "shape:box"), "--wrt shape:box: expected CATEGORY:ID/PART");
    EXPECT_EQ(refusal(scene(), "shape:box/radiance"), "--wrt shape:box/radiance: the shape emits no light");
    EXPECT_EQ(refusal(scene(), "shape:ball/vertices"), "--wrt shape:ball/vertices: a sphere or disk has no vertices");
    EXPECT_EQ(refusal(scene(), "shape:lamp/vertices"),
              "--wrt shape:lamp/vertices: vertices of an emitter cannot move alone");
    EXPECT_EQ(refusal(scene(), "emitter:sky/colour"), "--wrt emitter:sky/colour: 'colour' is none of radiance, pose");
    // Values that are no numbers.
    for (const char* text : {"", "a", "1 2", "nan", "inf", "1e999"})
        EXPECT_NE(refusal(scene(R"(value="3")", R"(value="3, $theta, 3")"), "theta", {{"theta", text}}), "no error")
            << text;
}

// Names come from anywhere.
TEST_F(DeriveParameters, HostileNames) {
    for (const std::string& name :
         {std::string(), std::string(":"), std::string("/"), std::string("shape:"), std::string("shape:/"),
          std::string("shape:box/"), std::string("shape:box/bsdf/"), std::string("shape::/pose"),
          std::string("bsdf:/rgb"), std::string("bsdf:matte//rgb"), std::string("$theta"), std::string("theta\0x", 7),
          std::string(100000, ':'), std::string("{}"), std::string("shape:{}/pose"), std::string("\xff\xfe:\xff/\xff"),
          std::string("sensor/"), std::string("emitter:point/vertices")})
        EXPECT_THROW(find(scene(), {name}), InputError) << name.substr(0, 40);
    // The same name twice: two equal columns.
    EXPECT_EQ(find(scene(), {"bsdf:glass/int_ior", "bsdf:glass/int_ior"}).tangents.n(), 2u);
}

}  // namespace
}  // namespace loom::derive
