// Every kind of bad scene file ends in one message with file:line:column, the line, a caret and, where a
// name is wrong, the names that are allowed.

#include "stages/core/assets/mesh.h"
#include "stages/core/assets/texture.h"
#include "tests/unit/scene_folder.h"

namespace loom {
namespace {

class BadScene : public SceneFolder {
  protected:
    std::string message(const std::string& body, const char* version = "3.0.0", const Defines& defines = {}) const {
        return error_of([&] { read(body, defines, version); });
    }
    /// The first shape's mesh, as build would load it.
    std::string mesh_message(const std::string& shape) const {
        return error_of([&] {
            std::vector<std::string> notes;
            load_mesh(*read(shape).root->children(Category::shape).at(0), notes);
        });
    }
};

struct Case {
    const char* body;
    const char* place;  // of the body's first line: 2
    const char* contains;
};

TEST_F(BadScene, EachMessageHasItsPlaceAndSaysWhat) {
    const Case cases[] = {
        // names
        {"<bsdf type='difuse'/>", "2:13", "bsdf 'difuse' is not known; allowed: diffuse, "},
        {"<bsdf type='diffuse'><rgb name='reflectence' value='1'/></bsdf>", "2:33",
         "has no parameter 'reflectence'; allowed: reflectance"},
        {"<bsdf type='dielectric'><float name='intIOR' value='1.5'/></bsdf>", "2:38", "allowed: int_ior, ext_ior"},
        {"<shape type='cube'><bsdf type='principled'/></shape>", "2:32", "bsdf 'principled' is not supported yet"},
        {"<shape type='cube'><ref id='p'/></shape><bsdf type='mask' id='p'><bsdf type='principled'/></bsdf>", "2:78",
         "bsdf 'principled' is not supported yet"},
        {"<shape type='cylinder'/>", "2:14", "shape 'cylinder' is not supported yet"},
        {"<shape type='disk'><emitter type='angulararea'/></shape>", "2:35",
         "emitter 'angulararea' is not supported yet"},
        {"<shape type='cube'><medium type='homogeneous' name='interior'/></shape>", "2:34",
         "medium 'homogeneous' is not supported yet"},
        {"<bsdff type='diffuse'/>", "2:1", "<bsdff> is not known here; allowed: bsdf, "},
        {"<bsdf type='diffuse' nme='x'/>", "2:27", "<bsdf> has no attribute 'nme'; allowed: name, "},
        {"<bsdf/>", "2:1", "<bsdf> needs the attribute 'type'"},
        {"stray text", "2:1", "unexpected text"},
        {"<bsdf type='roughplastic'><string name='distribution' value='gxx'/></bsdf>", "2:62",
         "distribution 'gxx' is not known; allowed: ggx, beckmann"},
        {"<bsdf type='conductor'><string name='material' value='Gold'/></bsdf>", "2:55",
         "material 'Gold' is not known; allowed: "},
        {"<bsdf type='dielectric'><string name='int_ior' value='bk8'/></bsdf>", "2:55",
         "material 'bk8' is not known; allowed: bk7, "},
        // kinds and values
        {"<bsdf type='roughplastic'><string name='alpha' value='0.1'/></bsdf>", "2:27",
         "'alpha' must be float or texture, not string"},
        {"<bsdf type='diffuse'><bsdf name='reflectance' type='diffuse'/></bsdf>", "2:22",
         "'reflectance' must be rgb, spectrum or float or texture, not bsdf"},
        {"<bsdf type='roughplastic'><float name='alpha' value='0.1x'/></bsdf>", "2:54", "'0.1x' is not a number"},
        {"<bsdf type='roughplastic'><float name='alpha' value='nan'/></bsdf>", "2:54", "'nan' is not a finite number"},
        {"<bsdf type='roughplastic'><float name='alpha' value='1e99'/></bsdf>", "2:54",
         "'1e99' is not a finite number"},
        {"<bsdf type='roughplastic'><float name='alpha' value='-0.1'/></bsdf>", "2:54", "'alpha' must not be negative"},
        {"<bsdf type='dielectric'><float name='int_ior' value='0'/></bsdf>", "2:54",
         "'int_ior' must be greater than 0"},
        {"<bsdf type='diffuse'><rgb name='reflectance' value='1.5'/></bsdf>", "2:53",
         "'reflectance' must lie between 0 and 1"},
        {"<bsdf type='diffuse'><rgb name='reflectance' value='1, 0'/></bsdf>", "2:53",
         "a colour has 1 or 3 numbers, not 2"},
        {"<bsdf type='diffuse'><rgb name='reflectance' value='#12345'/></bsdf>", "2:53", "'#12345' is not a colour"},
        {"<bsdf type='diffuse'><spectrum name='reflectance' value='500:1, 400:1'/></bsdf>", "2:58",
         "wavelengths must increase"},
        {"<bsdf type='diffuse'><spectrum name='reflectance' value='1,2,3'/></bsdf>", "2:58",
         "three numbers are an <rgb>"},
        {"<emitter type='constant'><rgb name='radiance' value='1,-1,1'/></emitter>", "2:54",
         "'radiance' must not be negative"},
        {"<shape type='cube'><boolean name='flip_normals' value='yes'/></shape>", "2:56",
         "'yes' is neither true nor false"},
        {"<integrator type='path'><integer name='max_depth' value='5.5'/></integrator>", "2:58",
         "'5.5' is not an integer"},
        {"<integrator type='path'><integer name='max_depth' value='99999999999'/></integrator>", "2:58",
         "is not an integer of 32 bits"},
        {"<shape type='cube'><float name='a'/></shape>", "2:33", "shape 'cube' has no parameter 'a'"},
        {"<shape type='sphere'><float name='radius'/></shape>", "2:22", "<float> needs the attribute 'value'"},
        {"<shape type='sphere'><float name='radius' value='1'/><float name='radius' value='2'/></shape>", "2:82",
         "given twice, first at scene.xml:2:50"},
        {"<emitter type='directional'><vector name='direction' value='0 0 0'/></emitter>", "2:29",
         "'direction' must not be zero"},
        // transforms
        {"<shape type='cube'><transform name='to_world'><scale x='0'/></transform></shape>", "2:20",
         "the matrix is singular"},
        {"<shape type='cube'><transform name='to_world'><matrix value='1 2 3'/></transform></shape>", "2:62",
         "a matrix has 16 or 9 numbers, not 3"},
        {"<shape type='cube'><transform name='to_world'><rotate angle='3'/></transform></shape>", "2:47",
         "axis of a rotation must not be zero"},
        {"<shape type='cube'><transform name='to_world'><lookat origin='1 1 1' target='1 1 1' up='0 1 "
         "0'/></transform></shape>",
         "2:78", "target and origin are the same point"},
        {"<shape type='cube'><transform name='to_world'><shear x='1'/></transform></shape>", "2:47",
         "<shear> is not a transformation; allowed: "},
        // structure
        {"<shape type='cube'><ref id='nowhere'/></shape><bsdf type='diffuse' id='here'/>", "2:29",
         "no object has the id 'nowhere'; nearest: here"},
        {"<bsdf type='mask' id='a'><ref id='a'/></bsdf>", "2:35", "'a' contains itself: the reference is cyclic"},
        {"<bsdf type='mask' id='a'><ref id='b'/></bsdf><bsdf type='twosided' id='b'><ref id='a'/></bsdf>", "2:84",
         "'a' contains itself"},
        {"<bsdf type='diffuse' id='a'/><bsdf type='diffuse' id='a'/>", "2:55",
         "id 'a' exists already, at scene.xml:2:1"},
        {"<bsdf type='twosided'/>", "2:1", "bsdf 'twosided' needs a bsdf inside"},
        {"<shape type='cube'><bsdf type='diffuse'/><bsdf type='diffuse'/></shape>", "2:42", "takes at most 1 bsdf"},
        {"<bsdf type='diffuse'><texture type='checkerboard'/></bsdf>", "2:22",
         "bsdf 'diffuse' takes no texture without a name"},
        {"<shape type='cube'><emitter type='point'/></shape>", "2:20",
         "emitter 'point' does not belong inside a shape"},
        {"<emitter type='constant'/><emitter type='constant'/>", "2:27",
         "at most one emitter of constant, envmap, sunsky"},
        {"<bsdf type='conductor'><string name='material' value='Al'/><float name='k' value='1'/></bsdf>", "2:55",
         "either 'material' or 'eta' and 'k'"},
        {"<include filename='none.xml'/>", "2:20", "file 'none.xml' not found"},
        {"<include filename='scene.xml'/>", "2:20", "includes itself"},
        // files and sizes
        {"<shape type='obj'/>", "2:1", "shape 'obj' needs the parameter 'filename'"},
        {"<shape type='obj'><string name='filename' value='a.obj'/></shape>", "2:50",
         "file 'a.obj' not found (looked for a.obj)"},
        {"<texture type='bitmap'><string name='filename' value='a.png'/></texture>", "2:55", "file 'a.png' not found"},
        {"<film type='hdrfilm'><integer name='width' value='0'/></film>", "2:51",
         "width 0 is not between 1 and 100000"},
        {"<film type='hdrfilm'><integer name='width' value='100000'/><integer name='height' "
         "value='90000'/></film>",
         "2:51", "are more than 2147483648"},
        {"<path value='parts'/>", "2:14", "folder 'parts' not found (looked for parts)"},
        {"<shape type='cube'><path value='.'/></shape>", "2:20", "<path> is not known here"},
        {"<bsdf type='diffuse' id='a'/><alias id='a' as='b'/><bsdf type='plastic' id='b'/>", "2:41",
         "alias 'b' is the id of an object, at scene.xml:2:52"},
        {"<integrator type='path'><integer name='max_depth' value='-2'/></integrator>", "2:58",
         "'max_depth' must be -1 (no limit) or not negative"},
        {"<integrator type='any'><integer name='rr_depth' value='0'/></integrator>", "2:56",
         "'rr_depth' must be greater than 0"},
        {"<integrator type='transient_nlos_path'><integer name='capture_type' value='4'/></integrator>", "2:76",
         "capture_type 4 is not between 1 and 3 (single, confocal, exhaustive)"},
        {"<integrator type='transient_path'><boolean name='discard_direct_light' value='true'/></integrator>", "2:79",
         "'discard_direct_light' is not supported"},
        {"<sensor type='perspective'><float name='fov' value='180'/></sensor>", "2:53", "'fov' must be less than 180"},
        {"<shape type='cube'><float name='$nothing' value='1'/></shape>", "2:33", "$nothing has no value"},
    };
    for (const Case& c : cases) {
        const std::string got = message(c.body);
        EXPECT_TRUE(got.starts_with(std::string("scene.xml:") + c.place + ": ")) << c.body << "\n" << got;
        EXPECT_NE(got.find(c.contains), std::string::npos) << c.body << "\n" << got;
        EXPECT_NE(got.find(std::string("\n  ") + std::string(c.body).substr(0, 20)), std::string::npos) << got;
        EXPECT_TRUE(got.ends_with("^")) << got;
    }
}

TEST_F(BadScene, WholeFile) {
    const auto read_text = [&](const char* text) { return error_of([&] { read_scene(write("scene.xml", text)); }); };
    EXPECT_TRUE(error_of([&] { read_scene(path("none.xml")); }).starts_with("none.xml: no such file"));
    EXPECT_NE(read_text("").find("malformed XML"), std::string::npos);
    EXPECT_NE(read_text("<scene version='3.0.0'>").find("malformed XML"), std::string::npos);
    EXPECT_NE(read_text("<svg/>").find("scene.xml:1:1: <svg> is not a Mitsuba scene"), std::string::npos);
    EXPECT_NE(read_text("<scene/>").find("<scene> needs the attribute 'version'"), std::string::npos);
    EXPECT_NE(read_text("<scene version='7'/>").find("1:17: version '7' is not known"), std::string::npos);
    EXPECT_NE(read_text("<scene version='3.0.0'/>").find("scene 'scene' needs a sensor inside"), std::string::npos);
    std::string deep = "<scene version='3.0.0'>";
    for (int i = 0; i < 100; ++i) deep += "<bsdf type='mask'>";
    for (int i = 0; i < 100; ++i) deep += "</bsdf>";
    EXPECT_NE(read_text((deep + "</scene>").c_str()).find("nested deeper than"), std::string::npos);
}

TEST_F(BadScene, UnusedDefineListsTheNames) {
    EXPECT_EQ(message("<default name='resx' value='4'/><default name='spp' value='4'/>"
                      "<film type='hdrfilm'><integer name='width' value='$resx'/></film>",
                      "3.0.0", {{"rex", "5"}}),
              "-D rex=5: the scene does not use $rex; it uses: resx");
}

TEST_F(BadScene, CyclicIncludeThroughAnotherFile) {
    write("other.xml", "<scene version='3.0.0'>\n<include filename='scene.xml'/></scene>");
    EXPECT_TRUE(message("<include filename='other.xml'/>").starts_with("other.xml:2:20: 'scene.xml' includes itself"));
}

TEST_F(BadScene, OldDialectWarnsOfUnknownParametersOnly) {
    EXPECT_EQ(message("<bsdf type='diffuse'><float name='fancy' value='1'/></bsdf>", "0.6.0"), "no error");
    EXPECT_NE(message("<bsdf type='fancy'/>", "0.6.0").find("2:13: bsdf 'fancy' is not known"), std::string::npos);
    EXPECT_NE(message("<bsdf type='diffuse'><string name='reflectance' value='1'/></bsdf>", "0.6.0").find("2:22: "),
              std::string::npos);
}

TEST_F(BadScene, Meshes) {
    const std::string obj = "<shape type='obj'><string name='filename' value='m.obj'/></shape>";
    const auto obj_message = [&](const char* text) {
        write("m.obj", text);
        return mesh_message(obj);
    };
    const std::string place = "scene.xml:2:50: m.obj";
    EXPECT_TRUE(obj_message("").starts_with(place + ": empty mesh")) << obj_message("");
    EXPECT_TRUE(obj_message("v 0 0 0\nv 1 0 0\nv nan 1 0\nf 1 2 3\n")
                    .starts_with(place + ": position of vertex 2 is not finite"));
    EXPECT_TRUE(
        obj_message("v 0 0 0\nv 1 0 0\nf 1 2 3\n").starts_with(place + ":3: face refers to vertex 3, 2 are known"));
    EXPECT_TRUE(obj_message("v 0 0 0\nv 1 0\n").starts_with(place + ":2: 'v' needs more numbers"));
    EXPECT_TRUE(obj_message("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 x\n").starts_with(place + ":4: a corner of a face"));
    write("m.obj", "v 0 0 0\nv 1 0 0\nv 2 0 0\nf 1 2 3\n");
    EXPECT_EQ(mesh_message(obj), "no error");  // a mesh without area is empty, but not wrong
    EXPECT_TRUE(mesh_message("<shape type='obj'><string name='filename' value='m.obj'/><emitter type='area'/></shape>")
                    .starts_with(place + ": an emitter without area"));
    write("m.obj", "v 0 0 0\nv 3e38 0 0\nv 0 1 0\nf 1 2 3\n");
    EXPECT_NE(mesh_message("<shape type='obj'><string name='filename' value='m.obj'/><transform name='to_world'>"
                           "<scale value='10'/></transform></shape>")
                  .find("position of vertex 1 is not finite after the transform"),
              std::string::npos);

    const std::string ply = "<shape type='ply'><string name='filename' value='m.ply'/></shape>";
    const std::string header =
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
        "element face 1\nproperty list uchar int vertex_indices\nend_header\n";
    const auto ply_message = [&](const std::string& text) {
        write("m.ply", text);
        return mesh_message(ply);
    };
    EXPECT_EQ(ply_message(header + "0 0 0 1 0 0 0 1 0 3 0 1 2"), "no error");
    EXPECT_NE(ply_message(header + "0 0 0 1 0 0 0 1 0 3 0 1 3").find("m.ply: face 0 refers to vertex 3"),
              std::string::npos);
    EXPECT_NE(ply_message(header + "0 0 0 1 0 0 0 inf 0 3 0 1 2").find("position of vertex 2 is not finite"),
              std::string::npos);
    EXPECT_NE(ply_message(header + "0 0 0 1 0 0").find("m.ply: truncated at byte"), std::string::npos);
    EXPECT_NE(ply_message("hello world\n").find("not a PLY file"), std::string::npos);
    EXPECT_NE(ply_message("ply\nformat ascii 1.0\nelement vertex 99999999999\nend_header\n").find("truncated"),
              std::string::npos);

    const std::string serialized = "<shape type='serialized'><string name='filename' value='m.serialized'/></shape>";
    write("m.serialized", "short");
    EXPECT_NE(mesh_message(serialized).find("truncated: shorter than its header"), std::string::npos);
    write("m.serialized", "this is something else");
    EXPECT_NE(mesh_message(serialized).find("not a Mitsuba .serialized file"), std::string::npos);
}

TEST_F(BadScene, Textures) {
    const auto texture_message = [&] {
        return error_of([&] {
            TextureCache cache;
            make_texture(*read("<texture type='bitmap'><string name='filename' value='t.png'/></texture>")
                              .root->children(Category::texture)
                              .at(0),
                         cache);
        });
    };
    write("t.png", "not an image");
    EXPECT_TRUE(texture_message().starts_with("scene.xml:2:55: t.png: not a readable image")) << texture_message();
}

}  // namespace
}  // namespace loom
