// Scene files of both dialects as one description.

#include "stages/core/description/description.h"

#include <algorithm>
#include <cmath>

#include "tests/unit/scene_folder.h"

namespace loom {
namespace {

namespace fs = std::filesystem;

class Description : public SceneFolder {
  protected:
    ObjectPtr first(const SceneDescription& scene, Category category) const {
        return scene.root->children(category).at(0);
    }
};

void expect_near(const Point3<double>& got, double x, double y, double z) {
    EXPECT_NEAR(got.x, x, 1e-12);
    EXPECT_NEAR(got.y, y, 1e-12);
    EXPECT_NEAR(got.z, z, 1e-12);
}

TEST_F(Description, ValuesOfEveryKind) {
    const auto scene = read(R"(
        <bsdf type="roughplastic" id="a">
            <string name="distribution" value="ggx"/>
            <float name="alpha" value=" 1e-008 "/>
            <float name="int_ior" value="+1.5"/>
            <string name="ext_ior" value="water"/>
            <boolean name="nonlinear" value="true"/>
            <rgb name="diffuse_reflectance" value=".1, .2 .3"/>
            <rgb name="specular_reflectance" value="0.5"/>
        </bsdf>
        <bsdf type="diffuse"><rgb name="reflectance" value="#ff0000"/></bsdf>
        <bsdf type="diffuse"><spectrum name="reflectance" value="400:0.78, 500:0.5 600:0.3, 700:0.1"/></bsdf>
        <emitter type="point"><point name="position" x="1" z="3"/><spectrum name="intensity" value="2"/></emitter>
        <emitter type="directional"><vector name="direction" value="0, 0, -1"/><integer name="irradiance" value="3"/></emitter>)");
    const auto bsdfs = scene.root->children(Category::bsdf);
    const Object& a = *bsdfs.at(0);
    EXPECT_EQ(a.plugin, "roughplastic");
    EXPECT_EQ(a.id, "a");
    EXPECT_TRUE(a.has_own_id);
    EXPECT_EQ(a.get_string("distribution"), "ggx");
    EXPECT_FLOAT_EQ(a.get_float("alpha"), 1e-8f);
    EXPECT_FLOAT_EQ(a.get_ior("int_ior", "bk7"), 1.5f);
    EXPECT_FLOAT_EQ(a.get_ior("ext_ior", "air"), 1.333f);
    EXPECT_TRUE(a.get_bool("nonlinear", false));
    EXPECT_EQ(a.get_rgb("diffuse_reflectance"), Spectrum(0.1f, 0.2f, 0.3f));
    EXPECT_EQ(std::get<Spectrum>(a.get_texture_or_rgb("specular_reflectance", Spectrum(1))), Spectrum(0.5f));
    EXPECT_FALSE(a.get_bool("absent", false));
    EXPECT_THROW(a.get_float("absent"), InputError);
    EXPECT_THROW(a.get_float("distribution"), InputError);
    EXPECT_EQ(bsdfs.at(1)->get_rgb("reflectance"), Spectrum(1, 0, 0));
    EXPECT_FALSE(bsdfs.at(1)->has_own_id);
    EXPECT_EQ(bsdfs.at(1)->id, "bsdf-2");
    EXPECT_NEAR(bsdfs.at(2)->get_rgb("reflectance").g, 0.410873, 1e-5);
    const auto emitters = scene.root->children(Category::emitter);
    expect_near(emitters.at(0)->get_point("position", {}), 1, 0, 3);
    EXPECT_NEAR(emitters.at(0)->get_rgb("intensity").r, 2.40960, 1e-4);
    EXPECT_EQ(emitters.at(1)->get_rgb("irradiance"), Spectrum(3));
    EXPECT_EQ(emitters.at(1)->get_vector("direction", {}).z, -1);
}

TEST_F(Description, TransformsComposeInTheOrderOfTheFile) {
    const auto scene = read(R"(<shape type="rectangle"><transform name="to_world">
            <scale x="2"/><rotate z="3" angle="90"/><translate value="1 2, 3"/>
            <matrix value="1 0 0 0 0 1 0 0 0 0 2 0 0 0 0 1"/></transform></shape>
        <shape type="cube"><transform name="to_world"><matrix value="0 1 0  1 0 0  0 0 1"/></transform></shape>
        <shape type="cube"/>)");
    const auto shapes = scene.root->children(Category::shape);
    expect_near(shapes.at(0)->get_transform("to_world").point({1, 1, 1}), 0, 4, 8);
    EXPECT_EQ(shapes.at(1)->get_transform("to_world").determinant3(), -1);
    EXPECT_EQ(shapes.at(2)->get_transform("to_world"), Matrix4d{});
}

// Mitsuba 3: the camera's x axis points to the left of the image.
TEST_F(Description, LookAt) {
    const std::string body = R"(<sensor type="perspective"><transform name="NAME">
        <TAG origin="1, 2, 3" target="1, 2, 4" up="0, 1, 0"/></transform></sensor>)";
    for (const char* version : {"3.0.0", "0.6.0"}) {
        std::string text = body;
        text.replace(text.find("NAME"), 4, version[0] == '3' ? "to_world" : "toWorld");
        text.replace(text.find("TAG"), 3, version[0] == '3' ? "lookat" : "lookAt");
        const auto scene = read(text, {}, version, "1");
        const Matrix4d m = scene.root->child(Category::sensor)->get_transform("to_world");
        expect_near(m.point({0, 0, 0}), 1, 2, 3);
        expect_near(m.point({0, 0, 1}), 1, 2, 4);
        expect_near(m.point({1, 0, 0}), 2, 2, 3);
        expect_near(m.point({0, 1, 0}), 1, 3, 3);
    }
}

TEST_F(Description, ReferencesAtAnyDepthAndInAnyOrder) {
    const auto scene = read(R"(
        <shape type="rectangle"><ref id="inner"/></shape>
        <shape type="rectangle"><ref name="bsdf" id="other name"/></shape>
        <bsdf type="mask"><float name="opacity" value="0.5"/><bsdf type="twosided" id="inner"><bsdf type="diffuse">
            <ref name="reflectance" id="map"/></bsdf></bsdf></bsdf>
        <texture type="checkerboard" id="map"/>
        <bsdf type="diffuse"><ref id="map" name="reflectance"/></bsdf>
        <alias id="inner" as="other name"/>)");
    const auto shapes = scene.root->children(Category::shape);
    const ObjectPtr inner = shapes.at(0)->child(Category::bsdf);
    EXPECT_EQ(inner->plugin, "twosided");
    EXPECT_EQ(shapes.at(1)->child(Category::bsdf), inner);
    EXPECT_EQ(first(scene, Category::bsdf)->child(Category::bsdf), inner);
    const ObjectPtr map = first(scene, Category::texture);
    EXPECT_EQ(inner->child(Category::bsdf)->get_object("reflectance"), map);
    EXPECT_EQ(
        std::get<ObjectPtr>(scene.root->children(Category::bsdf).at(1)->get_texture_or_rgb("reflectance", Spectrum(0))),
        map);
}

TEST_F(Description, ChildrenMayBearAnyName) {
    write("t.png", "not opened by the reader");
    const auto scene = read(R"(<bsdf type="bumpmap"><float name="scale" value="0.02"/>
        <texture name="whatever" type="bitmap"><string name="filename" value="t.png"/></texture>
        <bsdf type="diffuse"/></bsdf>)");
    EXPECT_EQ(first(scene, Category::bsdf)->child(Category::texture)->get_path("filename"), path("t.png"));
    EXPECT_EQ(scene.files, (std::vector<std::string>{path("scene.xml").string(), path("t.png").string()}));
}

TEST_F(Description, OldDialect) {
    write("a b.JPG", "");
    const auto scene = read(R"(<!-- comment -->
        <default name="size" value="100"/><default name="size" value="200"/>
        <bsdf type="roughdielectric"><float name="intIOR" value="1.4"/><string name="extIOR" value="air"/>
            <string name="distribution" value="phong"/><float name="nonsense" value="$size"/></bsdf>
        <bsdf type="diffuse"><texture name="reflectance" type="bitmap"><string name="filename" value="a b.JPG"/>
            <string name="filterType" value="trilinear"/><float name="gamma" value="2.2"/>
            <float name="uscale" value="2"/><float name="vscale" value="3"/><float name="uoffset" value=".5"/></texture></bsdf>
        <bsdf type="diffuse"><srgb name="reflectance" value="#00ff00"/></bsdf>
        <bsdf type="diffuse"><spectrum name="reflectance" value="0.1, 0.2, 0.3"/></bsdf>
        <shape type="rectangle"><boolean name="flipNormals" value="true"/>
            <emitter type="area"><spectrum name="radiance" value="16"/></emitter></shape>
        <sensor type="perspective"><string name="fovAxis" value="x"/>
            <film type="ldrfilm"><integer name="width" value="$size"/><boolean name="banner" value="false"/></film></sensor>)",
                            {}, "0.6.0", "1");
    const auto bsdfs = scene.root->children(Category::bsdf);
    EXPECT_FLOAT_EQ(bsdfs.at(0)->get_ior("int_ior", "bk7"), 1.4f);
    EXPECT_EQ(bsdfs.at(0)->get_string("distribution"), "beckmann");
    ASSERT_EQ(scene.warnings.size(), 2u);
    EXPECT_NE(scene.warnings[0].find("scene.xml:5:48: warning: distribution 'phong'"), std::string::npos)
        << scene.warnings[0];
    EXPECT_NE(scene.warnings[1].find("no parameter 'nonsense'; allowed: "), std::string::npos) << scene.warnings[1];
    const ObjectPtr map = bsdfs.at(1)->get_object("reflectance");
    EXPECT_EQ(map->get_string("filter_type"), "bilinear");
    const Matrix4d uv = map->get_transform("to_uv");
    expect_near(uv.point({1, 1, 0}), 2.5, 3, 0);
    EXPECT_EQ(bsdfs.at(2)->get_rgb("reflectance"), Spectrum(0, 1, 0));
    EXPECT_EQ(bsdfs.at(3)->get_rgb("reflectance"), Spectrum(0.1f, 0.2f, 0.3f));
    const ObjectPtr shape = first(scene, Category::shape);
    EXPECT_TRUE(shape->get_bool("flip_normals"));
    EXPECT_EQ(shape->child(Category::emitter)->get_rgb("radiance"), Spectrum(16));  // grey in this dialect
    EXPECT_EQ(scene.root->child(Category::sensor)->child(Category::film)->get_int("width"), 100);
    EXPECT_EQ(scene.parameters.at("size"), "100");
    EXPECT_FALSE(scene.notes.empty());
}

TEST_F(Description, DefinesWinOverDefaults) {
    const auto scene = read(R"(<default name="kind" value="path"/><default name="depth" value="3"/>
        <integrator type="$kind"><integer name="max_depth" value="$depth"/></integrator>)",
                            {{"depth", "7"}});
    EXPECT_EQ(first(scene, Category::integrator)->get_int("max_depth"), 7);
    EXPECT_EQ(scene.parameters, (std::map<std::string, std::string>{{"depth", "7"}, {"kind", "path"}}));
}

TEST_F(Description, IncludesAreRelativeToTheIncludingFile) {
    write("parts/materials.xml",
          R"(<scene version="0.6.0"><default name="grey" value="0.25"/><include filename="more/deep.xml"/>
        <bsdf type="plastic" id="m"><float name="intIOR" value="1.3"/></bsdf></scene>)");
    write("parts/more/deep.xml",
          R"(<scene version="3.0.0"><bsdf type="diffuse" id="deep"><rgb name="reflectance" value="$grey"/></bsdf>
        <texture type="bitmap"><string name="filename" value="beside_main.png"/></texture>
        <texture type="bitmap"><string name="filename" value="beside_part.png"/></texture></scene>)");
    write("beside_main.png", "");
    write("parts/more/beside_part.png", "");
    const auto scene = read(R"(<shape type="cube"><ref id="m"/></shape><include filename="parts/materials.xml"/>
        <shape type="cube"><ref id="deep"/></shape>)");
    const auto shapes = scene.root->children(Category::shape);
    EXPECT_FLOAT_EQ(shapes.at(0)->child(Category::bsdf)->get_ior("int_ior", "bk7"), 1.3f);
    EXPECT_EQ(shapes.at(1)->child(Category::bsdf)->get_rgb("reflectance"), Spectrum(0.25f));
    EXPECT_EQ(scene.files.size(), 5u);
}

bool has_note(const SceneDescription& scene, const std::string& text) {
    return std::any_of(scene.notes.begin(), scene.notes.end(),
                       [&](const std::string& note) { return note.find(text) != std::string::npos; });
}

// A <path> precedes the folder of the scene, the last <path> first, also for names written before it.
TEST_F(Description, PathsAreSearchedFirst) {
    for (const char* name : {"a.png", "near/a.png", "far/near/a.png", "b.png", "far/c.png"}) write(name, name);
    write("far/near/part.xml", R"(<scene version="3.0.0"><bsdf type="diffuse" id="grey">
        <spectrum name="reflectance" filename="half.spd"/></bsdf><emitter type="area" id="lamp"/></scene>)");
    write("far/near/half.spd", "\xEF\xBB\xBF# nm value\r\n400 0.5\r\n700\t0.5\r\n");
    const auto scene = read(R"(<texture type="bitmap"><string name="filename" value="a.png"/></texture>
        <path value="far"/><path value="near"/><include filename="part.xml"/>
        <texture type="bitmap"><string name="filename" value="b.png"/></texture>
        <texture type="bitmap"><string name="filename" value="c.png"/></texture>
        <shape type="cube"><ref id="grey"/></shape>)");
    // The second <path> is sought in the first: it is far/near.
    const auto textures = scene.root->children(Category::texture);
    EXPECT_EQ(textures.at(0)->get_path("filename"), path("far/near/a.png"));
    EXPECT_EQ(textures.at(1)->get_path("filename"), path("b.png"));
    EXPECT_EQ(textures.at(2)->get_path("filename"), path("far/c.png"));
    EXPECT_NEAR(first(scene, Category::shape)->child(Category::bsdf)->get_rgb("reflectance").g, 0.5, 0.03);
    for (const char* used : {"scene.xml", "far/near/part.xml", "far/near/half.spd", "far/near/a.png", "far/c.png"})
        EXPECT_EQ(std::count(scene.files.begin(), scene.files.end(), path(used).string()), 1) << used;
}

TEST_F(Description, OneObjectMayBeIncluded) {
    write("map.xml", R"(<texture version="3.0.0" type="checkerboard" id="map"/>)");
    write("part.xml",
          R"(<bsdf version="3.0.0" type="diffuse" id="part"><include filename="map.xml" name="reflectance"/></bsdf>)");
    const auto scene =
        read(R"(<shape type="cube"><include filename="part.xml"/></shape><shape type="disk"><ref id="part"/></shape>)");
    const auto shapes = scene.root->children(Category::shape);
    EXPECT_EQ(shapes.at(0)->child(Category::bsdf)->get_object("reflectance")->plugin, "checkerboard");
    EXPECT_EQ(shapes.at(0)->child(Category::bsdf), shapes.at(1)->child(Category::bsdf));
    EXPECT_NE(error_of([&] {
                  read(R"(<shape type="cube"><include filename="scene.xml"/></shape>)");
              }).find("includes itself"),
              std::string::npos);
    write("whole.xml", R"(<scene version="3.0.0"/>)");
    EXPECT_NE(error_of([&] {
                  read(R"(<shape type="cube"><include filename="whole.xml"/></shape>)");
              }).find("whole.xml:1:1: a <scene> cannot be included in a shape"),
              std::string::npos);
}

TEST_F(Description, EmittersAreAttachedByReference) {
    const auto scene = read(R"(<emitter type="area" id="lamp"><rgb name="radiance" value="3"/></emitter>
        <emitter type="area" id="spare"/><emitter type="constant"/><shape type="cube"><ref id="lamp"/></shape>)");
    EXPECT_EQ(first(scene, Category::shape)->child(Category::emitter)->get_rgb("radiance"), Spectrum(3));
    ASSERT_EQ(scene.root->children(Category::emitter).size(), 1u);
    EXPECT_EQ(first(scene, Category::emitter)->plugin, "constant");
    EXPECT_TRUE(has_note(scene, "scene.xml:3:9 has no effect: no shape refers to it"));
    EXPECT_EQ(scene.notes.size(), 1u);
}

TEST_F(Description, OneSensorIsKept) {
    const std::string body = R"(<sensor type="perspective" id="side"/><sensor type="thinlens" id="1"/>)";
    const auto at = [&](const std::string& sensor) { return read(body, {}, "3.0.0", sensor); };
    EXPECT_EQ(at("").root->child(Category::sensor)->id, "sensor-1");
    EXPECT_EQ(at("").sensor, 0);
    EXPECT_EQ(at("side").sensor, 1);
    EXPECT_EQ(at("0").sensor, 0);
    EXPECT_NE(error_of([&] { at("1"); }).find("scene.xml:2:53: sensor 'thinlens' is not supported yet"),
              std::string::npos);  // an id first
    EXPECT_EQ(error_of([&] { at("3"); }),
              "--sensor 3: the scene has no such sensor; it has 0 (perspective 'sensor-1'), 1 (perspective 'side'), 2 "
              "(thinlens '1')");
    EXPECT_TRUE(has_note(at("side"),
                         "sensor 1 (perspective 'side') is rendered; --sensor chooses another: 0 (perspective "
                         "'sensor-1'), 2 (thinlens '1')"));
}

TEST_F(Description, WhatNothingUsesNeedsNoSupport) {
    const auto scene = read(R"(<default name="g" value="0.5"/>
        <bsdf type="principled" id="gold"><rgb name="base_color" value="$g"/><float name="metallic" value="1"/>
            <texture type="volume" name="anything"/><bsdf type="diffuse" id="inner"/></bsdf>
        <medium type="heterogeneous" id="fog"><volume name="albedo" type="gridvolume"><string name="filename" value="no.vol"/></volume>
            <phase type="hg"><float name="g" value="$g"/></phase></medium>
        <texture type="bitmap" id="t"><string name="filename" value="scene.xml"/><string name="wrapModeU" value="clamp"/></texture>
        <shape type="cube"><ref id="inner"/></shape>)",
                            {}, "0.6.0");
    EXPECT_EQ(first(scene, Category::shape)->child(Category::bsdf)->plugin, "diffuse");
    for (const char* text : {"bsdf 'principled' is not supported yet (", "medium 'heterogeneous' is not",
                             "texture 'bitmap': parameter 'wrap_mode_u' is not"})
        EXPECT_TRUE(has_note(scene, text)) << text;
    EXPECT_EQ(scene.parameters.count("g"), 1u);
}

TEST_F(Description, AnyIntegratorFilmFilterAndSampler) {
    const auto scene = read(R"(<integrator type="aov"><string name="aovs" value="dd:depth"/>
            <integrator type="volpath"><integer name="max_depth" value="7"/><float name="guess" value="1"/></integrator>
            <integrator type="path"/></integrator>
        <sensor type="perspective"><sampler type="bush"><integer name="strength" value="2"/></sampler>
            <film type="specfilm"><integer name="width" value="40"/><spectrum name="band1" value="400:1, 700:1"/><rfilter type="mitchell"/></film></sensor>)",
                            {}, "3.0.0", "1");
    const ObjectPtr inner = first(scene, Category::integrator)->child(Category::integrator);
    EXPECT_EQ(inner->get_int("max_depth"), 7);
    EXPECT_EQ(scene.root->child(Category::sensor)->child(Category::film)->get_int("width"), 40);
    for (const char* text :
         {"integrator 'aov': rendered by path tracing", "the first of its 2 integrators",
          "integrator 'volpath': without effect here: guess", "integrator 'aov': without effect here: aovs",
          "sampler 'bush': without effect here: strength", "film 'specfilm': without effect here: band1",
          "rfilter 'mitchell': rendered as a gaussian"})
        EXPECT_TRUE(has_note(scene, text)) << text;
}

TEST_F(Description, ChoicesInAnyCaseAndByNumber) {
    const auto scene = read(
        R"(<bsdf type="roughconductor"><string name="distribution" value="GGX"/><string name="material" value="AU"/></bsdf>
        <bsdf type="dielectric"><string name="int_ior" value="Fused Quartz"/></bsdf>
        <texture type="bitmap"><string name="filename" value="scene.xml"/><string name="wrap_mode" value="Mirror"/><boolean name="raw" value="TRUE"/></texture>
        <integrator type="transient_nlos_path"><integer name="capture_type" value="2"/></integrator>)");
    const Object& metal = *first(scene, Category::bsdf);
    EXPECT_EQ(metal.get_string("distribution"), "ggx");
    EXPECT_EQ(metal.get_string("material"), "Au");
    EXPECT_FLOAT_EQ(scene.root->children(Category::bsdf).at(1)->get_ior("int_ior", "air"), 1.458f);
    EXPECT_EQ(first(scene, Category::texture)->get_string("wrap_mode"), "mirror");
    EXPECT_TRUE(first(scene, Category::texture)->get_bool("raw"));
    EXPECT_EQ(first(scene, Category::integrator)->get_string("capture_type"), "confocal");
}

// Every scene that is shared for comparison reads in its own dialect.
TEST(SharedScenes, AllRead) {
    const fs::path shared = fs::path(LOOM_SOURCE_DIR) / ".." / "shared";
    if (!fs::exists(shared / "scenes")) GTEST_SKIP() << "no shared scenes beside the repository";
    int n_read = 0;
    for (const char* folder : {"scenes", "oracles/render", "oracles/derivative"})
        for (const auto& entry : fs::recursive_directory_iterator(shared / folder)) {
            // Fragments are included by scenes, whose folder their paths start from.
            if (entry.path().extension() != ".xml" || entry.path().parent_path().filename() == "fragments") continue;
            EXPECT_NO_THROW({
                const auto scene = read_scene(entry.path());
                EXPECT_EQ(scene.warnings.size(), 0u) << scene.warnings.front();
                ++n_read;
            }) << entry.path();
        }
    EXPECT_GE(n_read, 45);
}

TEST(SharedScenes, StaircaseRefersToTheNestedMaterial) {
    const fs::path file = fs::path(LOOM_SOURCE_DIR) / "../shared/scenes/staircase/scene.xml";
    if (!fs::exists(file)) GTEST_SKIP() << "no shared scenes beside the repository";
    for (const ObjectPtr& shape : read_scene(file).root->children(Category::shape))
        EXPECT_NE(shape->child(Category::bsdf)->plugin, "bumpmap");
}

TEST(SharedScenes, TransientFilmIsRead) {
    const fs::path file = fs::path(LOOM_SOURCE_DIR) / "../shared/oracles/transient/cornell_box.xml";
    if (!fs::exists(file)) GTEST_SKIP() << "no shared scenes beside the repository";
    const SceneDescription scene = read_scene(file);
    EXPECT_EQ(scene.root->child(Category::integrator)->plugin, "transient_path");
    const auto film = scene.root->child(Category::sensor)->child(Category::film);
    EXPECT_EQ(film->get_int("temporal_bins"), 300);
    EXPECT_DOUBLE_EQ(film->get_double("start_opl"), 3.5);
    EXPECT_DOUBLE_EQ(film->get_double("bin_width_opl"), 0.02);
}

}  // namespace
}  // namespace loom
