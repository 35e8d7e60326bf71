// The edit between two scenes: as text for the user, by shape for the estimators.

#include <cmath>
#include <filesystem>

#include "stages/core/edit/edit.h"
#include "stages/core/scene/build.h"
#include "tests/unit/scene_folder.h"

namespace loom::residual {
namespace {

constexpr const char* base = R"(
    <bsdf type="diffuse" id="white"><rgb name="reflectance" value="0.7 0.7 0.7"/></bsdf>
    <bsdf type="roughplastic" id="rough"><float name="alpha" value="0.1"/></bsdf>
    <shape type="rectangle" id="floor"><ref id="white"/></shape>
    <shape type="cube" id="box">
        <transform name="to_world"><scale value="0.2"/><translate x="0.5" z="0.2"/></transform>
        <ref id="rough"/>
    </shape>
    <shape type="sphere" id="ball"><point name="center" x="-0.5" z="0.2"/><float name="radius" value="0.2"/><ref id="white"/></shape>
    <shape type="rectangle" id="lamp">
        <transform name="to_world"><scale value="0.1"/><rotate x="1" angle="180"/><translate z="2"/></transform>
        <emitter type="area"><rgb name="radiance" value="5 5 5"/></emitter>
    </shape>
    <emitter type="point" id="bulb"><point name="position" x="1" z="1"/><rgb name="intensity" value="1 1 1"/></emitter>
    <emitter type="constant"><rgb name="radiance" value="0.1 0.1 0.1"/></emitter>)";

class FindEdit : public SceneFolder {
  protected:
    /// `base` with texts replaced, old by new.
    static std::string with(std::initializer_list<std::pair<std::string, std::string>> changes,
                            std::string body = base) {
        for (const auto& [from, to] : changes) {
            const auto at = body.find(from);
            EXPECT_NE(at, std::string::npos) << from;
            body.replace(at, from.size(), to);
        }
        return body;
    }
    SceneDescription described(const std::string& name, const std::string& body, const Defines& defines = {}) const {
        return read_scene(write(name, text(body)), defines);
    }
    /// The edit of two bodies, checked against the scenes that are built from them.
    Edit found(const std::string& old_body, const std::string& new_body) const {
        Edit edit = find_edit(described("old.xml", old_body), described("new.xml", new_body));
        const auto before = load_scene(path("old.xml")), after = load_scene(path("new.xml"));
        EXPECT_EQ(edit.old_shapes.size(), before->shapes.size());
        EXPECT_EQ(edit.new_shapes.size(), after->shapes.size());
        EXPECT_EQ(edit.old_emitters.size(), before->emitters.size());
        EXPECT_EQ(edit.new_emitters.size(), after->emitters.size());
        check_side(edit.old_shapes, edit.new_shapes, *before, *after);
        check_side(edit.new_shapes, edit.old_shapes, *after, *before);
        for (std::size_t i = 0; i < edit.old_emitters.size(); ++i)
            if (const std::uint32_t j = edit.old_emitters[i].partner_idx; j != EmitterEdit::none) {
                EXPECT_EQ(edit.new_emitters.at(j).partner_idx, i);
                EXPECT_EQ(edit.new_emitters.at(j).changed, edit.old_emitters[i].changed);
                EXPECT_EQ(before->emitters[i].kind == EmitterKind::area, after->emitters[j].kind == EmitterKind::area);
            } else {
                EXPECT_TRUE(edit.old_emitters[i].changed);
            }
        return edit;
    }
    std::vector<std::string> words(std::initializer_list<std::pair<std::string, std::string>> changes) const {
        return found(base, with(changes)).changes;
    }
    static unsigned changes_of(const std::vector<ShapeEdit>& shapes, std::size_t i) { return shapes.at(i).changes; }

  private:
    /// Partners refer to each other, and the map takes the points of one to those of the other.
    static void check_side(const std::vector<ShapeEdit>& mine, const std::vector<ShapeEdit>& theirs,
                           const Scene& my_scene, const Scene& their_scene) {
        for (std::size_t i = 0; i < mine.size(); ++i) {
            const std::uint32_t j = mine[i].partner_idx;
            if (j == ShapeEdit::none) {
                EXPECT_TRUE(mine[i].changes == shape_change::removed || mine[i].changes == shape_change::added);
                continue;
            }
            EXPECT_EQ(theirs.at(j).partner_idx, i);
            EXPECT_EQ(theirs[j].changes, mine[i].changes);
            const Shape &a = my_scene.shapes[i], &b = their_scene.shapes[j];
            std::vector<std::pair<Point3f, Point3f>> points{{a.round.center, b.round.center}};
            if (!a.mesh.positions.empty()) points.clear();
            for (std::size_t k = 0; k < a.mesh.positions.size(); ++k)
                points.emplace_back(a.mesh.positions[k], b.mesh.positions.at(k));
            for (const auto& [p, q] : points) {
                const Point3<double> mapped = mine[i].to_partner.point(Point3<double>(p));
                EXPECT_NEAR(mapped.x, double(q.x), 1e-5);
                EXPECT_NEAR(mapped.y, double(q.y), 1e-5);
                EXPECT_NEAR(mapped.z, double(q.z), 1e-5);
            }
        }
    }
};

using Words = std::vector<std::string>;

// Moves count by the size of what moves, not by an absolute length.
TEST_F(FindEdit, MovesOfSmallThings) {
    const std::string small = with({{R"(<scale value="0.2"/><translate x="0.5" z="0.2"/>)",
                                     R"(<scale value="2e-5"/><translate x="5e-5" z="2e-5"/>)"}});
    const std::string moved = with({{"x=\"5e-5\"", "x=\"5.003e-5\""}}, small),
                      rounded = with({{"x=\"5e-5\"", "x=\"5.0000000001e-5\""}}, small);
    ASSERT_EQ(found(small, moved).changes.size(), 1u);
    EXPECT_NE(found(small, moved).changes[0].find("by (3e-08, 0, 0)"), std::string::npos)
        << found(small, moved).changes[0];
    EXPECT_TRUE(found(small, rounded).changes.empty());
}

TEST_F(FindEdit, NothingDiffersHoweverItIsWritten) {
    EXPECT_TRUE(found(base, base).nothing());
    // Another order of attributes and parameters, grey as a number, a matrix instead of its factors, 0.x spelling
    // throughout, -D instead of a literal, an include, other spaces, an id that only the BSDF's users refer to.
    const std::string other =
        with({{"<rgb name=\"reflectance\" value=\"0.7 0.7 0.7\"/>", "<rgb value='0.7' name='reflectance'/>"},
              {"<scale value=\"0.2\"/><translate x=\"0.5\" z=\"0.2\"/>",
               "<matrix value='0.2 0 0 0.5  0 0.2 0 0  0 0 0.2 0.2  0 0 0 1'/>"},
              {"value=\"5 5 5\"", "value='$light'"},
              {"<point name=\"center\" x=\"-0.5\" z=\"0.2\"/><float name=\"radius\" value=\"0.2\"/>",
               "<transform name='to_world'><scale value='0.2'/><translate x='-0.5' z='0.2'/></transform>"},
              {"id=\"white\"", "id=\"chalk\""},
              {"<ref id=\"white\"/>", "<ref id=\"chalk\"/>"},
              {"<ref id=\"white\"/>", "<ref id=\"chalk\"/>"}});
    write("body.xml", "<scene version=\"3.0.0\">" + other + "</scene>");
    const SceneDescription included = described(
        "main.xml", "<default name='light' value='1'/><include filename='body.xml'/>", {{"light", "5, 5, 5"}});
    const Edit edit = find_edit(described("old.xml", base), included);
    EXPECT_EQ(edit.changes, Words{});
    for (const ShapeEdit& s : edit.new_shapes) EXPECT_EQ(s.changes, 0u);
    for (const EmitterEdit& e : edit.new_emitters) EXPECT_FALSE(e.changed);
}

TEST_F(FindEdit, OneFileWithTwoSetsOfValues) {
    const std::string body =
        with({{"value=\"5 5 5\"", "value='$light'"}}, std::string("<default name='light' value='5'/>") + base);
    const auto file = write("scene.xml", text(body));
    const Edit edit = find_edit(read_scene(file, {{"light", "5"}}), read_scene(file, {{"light", "8"}}));
    EXPECT_EQ(edit.changes, Words{"light changed: lamp: radiance (5, 5, 5) -> (8, 8, 8)"});
    EXPECT_TRUE(find_edit(read_scene(file), read_scene(file, {{"light", "5.0"}})).nothing());
}

TEST_F(FindEdit, Moved) {
    const Edit edit = found(base, with({{"x=\"0.5\"", "x=\"-0.25\""}}));
    EXPECT_EQ(edit.changes, Words{"moved: box: by (-0.75, 0, 0)"});
    EXPECT_EQ(changes_of(edit.new_shapes, 1), shape_change::moved);
    EXPECT_TRUE(edit.new_shapes[1].dynamic());
    EXPECT_FALSE(edit.new_shapes[1].dyed());
    EXPECT_EQ(edit.n_dynamic(), 1u);
    EXPECT_EQ(edit.n_ghosts(), 1u);
    // Old and new place overlap: still a move.
    EXPECT_EQ(words({{"x=\"0.5\"", "x=\"0.55\""}}), Words{"moved: box: by (0.05, 0, 0)"});
    EXPECT_EQ(words({{"x=\"-0.5\"", "x=\"-0.5\" y=\"0.1\""}}), Words{"moved: ball: by (0, 0.1, 0)"});
}

TEST_F(FindEdit, TurnedAboutItsOwnCentre) {
    EXPECT_EQ(words({{"<translate x=\"0.5\"", "<rotate z=\"1\" angle=\"30\"/><translate x=\"0.5\""}}),
              Words{"moved: box: turned by 30 degrees about (0, 0, 1) through its centre"});
    EXPECT_EQ(words({{"<translate x=\"0.5\"", "<rotate x=\"1\" angle=\"180\"/><translate x=\"0.7\""}}),
              Words{"moved: box: turned by 180 degrees about (1, 0, 0) through its centre, and by (0.2, 0, 0)"});
}

TEST_F(FindEdit, AScrewIsToldByItsAxis) {
    const Matrix4d m = Matrix4d::translation(1, 2, 3) * Matrix4d::rotation({0, 0, 1}, pi_double / 2) *
                       Matrix4d::translation(-1, -2, 0);
    EXPECT_EQ(motion_words(m, {9, 9, 9}, false),
              "turned by 90 degrees about (0, 0, 1) through (1, 2, 0), and by (0, 0, 3)");
}

TEST_F(FindEdit, SeveralMovers) {
    const Edit edit = found(base, with({{"x=\"0.5\"", "x=\"0.4\""},
                                        {"x=\"-0.5\"", "x=\"-0.6\""},
                                        {"<translate z=\"2\"/>", "<translate z=\"1.5\"/>"}}));
    EXPECT_EQ(edit.changes, (Words{"moved: box, ball: by (-0.1, 0, 0)", "moved: lamp (a light): by (0, 0, -0.5)"}));
    EXPECT_EQ(edit.n_dynamic(), 3u);
    EXPECT_EQ(edit.n_emitters(), 1u);
}

TEST_F(FindEdit, AddedAndRemoved) {
    const std::string more =
        with({{"<shape type=\"sphere\"", "<shape type=\"disk\" id=\"plate\"/><shape type=\"sphere\""}});
    Edit edit = found(base, more);
    EXPECT_EQ(edit.changes, Words{"added: plate"});
    EXPECT_EQ(changes_of(edit.new_shapes, 2), shape_change::added);
    EXPECT_EQ(edit.new_shapes[3].partner_idx, 2u);
    EXPECT_EQ(edit.n_dynamic(), 1u);
    EXPECT_EQ(edit.n_ghosts(), 0u);
    edit = found(more, base);
    EXPECT_EQ(edit.changes, Words{"removed: plate"});
    EXPECT_EQ(edit.n_ghosts(), 1u);
}

TEST_F(FindEdit, WhatIsNotRigidIsRemovedAndAdded) {
    EXPECT_EQ(words({{"<scale value=\"0.2\"/>", "<scale value=\"0.3\"/>"}}),
              Words{"removed and added: box: it is moved by more than a rotation and a translation"});
    EXPECT_EQ(words({{"<scale value=\"0.2\"/>", "<scale x=\"-0.2\" y=\"0.2\" z=\"0.2\"/>"}}),
              Words{"removed and added: box: it is moved by more than a rotation and a translation"});
    EXPECT_EQ(words({{"name=\"radius\" value=\"0.2\"", "name=\"radius\" value=\"0.3\""}}),
              Words{"removed and added: ball: it is moved by more than a rotation and a translation"});
    const Edit edit = found(base, with({{"<shape type=\"cube\"", "<shape type=\"disk\""}}));
    EXPECT_EQ(edit.changes, Words{"removed and added: box: cube -> disk"});
    EXPECT_EQ(changes_of(edit.old_shapes, 1), shape_change::removed);
    EXPECT_EQ(changes_of(edit.new_shapes, 1), shape_change::added);
    EXPECT_EQ(edit.new_shapes[1].partner_idx, ShapeEdit::none);
}

TEST_F(FindEdit, AnotherMeshUnderTheSameName) {
    const char* obj = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n";
    write("a.obj", obj);
    write("b.obj", obj);
    write("c.obj", "v 0 0 0\nv 1 0 0\nv 0 2 0\nf 1 2 3\n");
    const auto mesh = [](const std::string& file) {
        return "<shape type='obj' id='m'><string name='filename' value='" + file + "'/></shape>";
    };
    EXPECT_TRUE(found(mesh("a.obj"), mesh("b.obj")).nothing());
    EXPECT_EQ(found(mesh("a.obj"), mesh("c.obj")).changes, Words{"removed and added: m: its shape has changed"});
}

TEST_F(FindEdit, Repainted) {
    const Edit edit = found(base, with({{"0.7 0.7 0.7", "0.2 0.2 0.8"}}));
    EXPECT_EQ(edit.changes, Words{"repainted: floor, ball: reflectance (0.7, 0.7, 0.7) -> (0.2, 0.2, 0.8)"});
    EXPECT_EQ(changes_of(edit.new_shapes, 0), shape_change::repainted);
    EXPECT_TRUE(edit.new_shapes[0].dyed());
    EXPECT_FALSE(edit.new_shapes[0].dynamic());
    EXPECT_EQ(words({{"name=\"alpha\" value=\"0.1\"", "name=\"alpha\" value=\"0.5\""}}),
              Words{"repainted: box: alpha 0.1 -> 0.5"});
    EXPECT_EQ(words({{"<bsdf type=\"diffuse\" id=\"white\"><rgb name=\"reflectance\" value=\"0.7 0.7 0.7\"/></bsdf>",
                      "<bsdf type=\"twosided\" id=\"white\"><bsdf type=\"roughconductor\"><string name=\"material\" "
                      "value=\"Au\"/></bsdf></bsdf>"}}),
              Words{"repainted: floor, ball: diffuse -> twosided"});
    // Moved and repainted at once.
    const Edit two = found(
        base, with({{"x=\"0.5\"", "x=\"0.4\""}, {"name=\"alpha\" value=\"0.1\"", "name=\"alpha\" value=\"0.5\""}}));
    EXPECT_EQ(changes_of(two.new_shapes, 1), shape_change::moved | shape_change::repainted);
}

TEST_F(FindEdit, ATextureIsItsContent) {
    const auto texture = [](const std::string& file) {
        return "<shape type='rectangle' id='floor'><bsdf type='diffuse'><texture type='bitmap' "
               "name='reflectance'><string name='filename' value='" +
               file + "'/></texture></bsdf></shape>";
    };
    const std::filesystem::path patches = std::filesystem::path(LOOM_SOURCE_DIR) / "scenes/textures/patches.png";
    std::filesystem::copy_file(patches, path("a.png"));
    std::filesystem::copy_file(patches, path("b.png"));
    EXPECT_TRUE(found(texture("a.png"), texture("b.png")).nothing());
    write("c/a.png", "");
    std::filesystem::copy_file(patches, path("c/a.png"), std::filesystem::copy_options::overwrite_existing);
    std::ofstream(path("c/a.png"), std::ios::app) << "more";
    const Edit edit = find_edit(described("old.xml", texture("a.png")), described("new.xml", texture("c/a.png")));
    EXPECT_EQ(edit.changes, Words{"repainted: floor: reflectance: a.png: other content"});
}

TEST_F(FindEdit, Lights) {
    EXPECT_EQ(words({{"value=\"5 5 5\"", "value=\"9 5 5\""}}),
              Words{"light changed: lamp: radiance (5, 5, 5) -> (9, 5, 5)"});
    EXPECT_EQ(words({{"name=\"intensity\" value=\"1 1 1\"", "name=\"intensity\" value=\"2 2 2\""}}),
              Words{"light changed: bulb: intensity (1, 1, 1) -> (2, 2, 2)"});
    const Edit edit = found(base, with({{"x=\"1\" z=\"1\"", "x=\"1\" z=\"2\""}}));
    EXPECT_EQ(edit.changes, Words{"light changed: bulb: position (1, 0, 1) -> (1, 0, 2)"});
    EXPECT_EQ(edit.n_emitters(), 1u);
    EXPECT_FALSE(edit.new_emitters[0].changed);
    EXPECT_TRUE(edit.new_emitters[1].changed);
    EXPECT_EQ(words({{"<emitter type=\"point\"", "<emitter type=\"point\" id=\"second\"/><emitter type=\"point\""}}),
              Words{"light added: second"});
    EXPECT_EQ(words({{"<emitter type=\"area\"><rgb name=\"radiance\" value=\"5 5 5\"/></emitter>", ""}}),
              (Words{"repainted: lamp: diffuse -> the default",
                     "light removed: lamp"}));  // without BSDF an emitter is black, a shape grey
    EXPECT_EQ(
        words({{"type=\"point\" id=\"bulb\"", "type=\"point\" id=\"torch\""}, {"value=\"1 1 1\"", "value=\"3 1 1\""}}),
        (Words{"light removed: bulb", "light added: torch"}));
}

TEST_F(FindEdit, HiddenLights) {
    const std::string shown = base,
                      hidden = std::string(base) +
                               "<integrator type='path'><boolean name='hide_emitters' value='true'/></integrator>";
    const auto refusal = [&](const std::string& before, const std::string& after) {
        return error_of([&] { find_edit(described("old.xml", before), described("new.xml", after)); });
    };
    EXPECT_NE(refusal(shown, hidden).find("hide_emitters is true, not false as in the old scene"), std::string::npos)
        << refusal(shown, hidden);
    const std::string brighter = with({{"value=\"5 5 5\"", "value=\"9 5 5\""}}, hidden);
    EXPECT_NE(
        refusal(hidden, brighter).find("an edit of a light with an area is not supported yet where hide_emitters"),
        std::string::npos);
    EXPECT_EQ(find_edit(described("old.xml", hidden),
                        described("new.xml",
                                  with({{"name=\"intensity\" value=\"1 1 1\"", "name=\"intensity\" value=\"2 2 2\""}},
                                       hidden)))
                  .n_emitters(),
              1u);
}

TEST_F(FindEdit, Sky) {
    EXPECT_EQ(words({{"0.1 0.1 0.1", "0.3 0.3 0.3"}})[0].substr(0, 12), "sky changed:");
    const Edit edit =
        found(base, with({{"<emitter type=\"constant\"><rgb name=\"radiance\" value=\"0.1 0.1 0.1\"/></emitter>",
                           "<emitter type=\"sunsky\" id=\"day\"/>"}}));
    EXPECT_EQ(edit.changes, Words{"sky changed: day: constant -> sunsky"});
    EXPECT_EQ(edit.new_emitters[2].partner_idx, 2u);
}

// Without ids: the same content first, then the same form elsewhere, in order.
TEST_F(FindEdit, WithoutIds) {
    const auto cube = [](double x, const char* red = "0.5") {
        return "<shape type='cube'><transform name='to_world'><translate x='" + std::to_string(x) +
               "'/></transform><bsdf type='diffuse'><rgb name='reflectance' value='" + red +
               " 0.5 0.5'/></bsdf></shape>\n";
    };
    Edit edit = found(cube(0) + cube(3) + cube(6), cube(-3) + cube(0) + cube(3) + cube(7));
    // The last cube of the old scene is paired with the first that has no partner; one is left over.
    EXPECT_EQ(edit.new_shapes[1].partner_idx, 0u);
    EXPECT_EQ(edit.new_shapes[2].partner_idx, 1u);
    EXPECT_EQ(edit.new_shapes[0].partner_idx, 2u);
    EXPECT_EQ(edit.new_shapes[3].changes, shape_change::added);
    EXPECT_EQ(edit.changes, (Words{"moved: the cube at new.xml:2:1: by (-9, 0, 0)", "added: the cube at new.xml:5:1"}));
    edit = found(cube(0) + cube(3), cube(3, "0.9") + cube(0));
    EXPECT_EQ(edit.new_shapes[0].partner_idx, 1u);
    EXPECT_EQ(edit.new_shapes[0].changes, shape_change::repainted);
}

TEST_F(FindEdit, WhatCannotBeAResidualIsRefusedWithBothPlaces) {
    const auto scene = [](const std::string& sensor, const std::string& integrator = "") {
        return "<scene version=\"3.0.0\">\n" + integrator + "\n<sensor type=\"perspective\">\n" + sensor +
               "\n</sensor></scene>\n";
    };
    const auto refusal = [&](const std::string& a, const std::string& b) {
        const auto before = write("old.xml", a), after = write("new.xml", b);
        const std::string message = error_of([&] { find_edit(read_scene(before), read_scene(after)); });
        return message.substr(0, message.find(": a residual needs"));
    };
    const auto camera = [](const std::string& x) {
        return "<transform name='to_world'><translate x='" + x + "'/></transform>";
    };
    const auto film = [](const std::string& w, const std::string& h, const std::string& filter) {
        return "<film type='hdrfilm'><integer name='width' value='" + w + "'/><integer name='height' value='" + h +
               "'/>" + filter + "</film>";
    };
    const auto depth = [](const std::string& d) {
        return "<integrator type='path'><integer name='max_depth' value='" + d + "'/></integrator>";
    };
    EXPECT_EQ(refusal(scene(camera("0")), scene(camera("1"))),
              "new.xml:4:1: the camera's position or direction is not the same as in the old scene, at old.xml:4:1");
    EXPECT_EQ(refusal(scene("<float name='fov' value='40'/>"), scene("<float name='fov' value='50'/>")),
              "new.xml:4:26: the camera's field of view is not the same as in the old scene, at old.xml:4:26");
    EXPECT_EQ(refusal(scene(film("8", "8", "")), scene(film("9", "8", ""))),
              "new.xml:4:51: the film's width is 9, not 8 as in the old scene, at old.xml:4:51");
    EXPECT_EQ(refusal(scene(film("8", "8", "")), scene(film("8", "9", ""))),
              "new.xml:4:85: the film's height is 9, not 8 as in the old scene, at old.xml:4:85");
    EXPECT_EQ(refusal(scene(film("8", "8", "<rfilter type='box'/>")), scene(film("8", "8", "<rfilter type='tent'/>"))),
              "new.xml:4:89: the pixel filter is not the same as in the old scene, at old.xml:4:89");
    EXPECT_EQ(refusal(scene("", depth("4")), scene("", depth("5"))),
              "new.xml:2:58: max_depth is 5, not 4 as in the old scene, at old.xml:2:58");
    EXPECT_EQ(refusal(scene("", depth("4")), scene("")),
              "new.xml:1:1: max_depth is -1, not 4 as in the old scene, at old.xml:2:58");
    // Two spellings of the same value are equal.
    EXPECT_EQ(refusal(scene(camera("0")), scene("")), "no error");
    EXPECT_EQ(refusal(scene(film("768", "576", "<rfilter type='gaussian'/>")), scene("")), "no error");
    EXPECT_EQ(refusal(scene("", depth("-1")), scene("")), "no error");
}

}  // namespace
}  // namespace loom::residual
