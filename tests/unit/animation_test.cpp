// Frames of an animation: the table, and the static scene that they share.
#include "stages/core/edit/animation.h"

#include <gtest/gtest.h>
#include <unistd.h>

#include <fstream>

#include "formats/io/error.h"
#include "stages/core/scene/build.h"

namespace loom {
namespace {

/// A file that is removed with it.
class TextFile {
  public:
    TextFile(const std::string& name, const std::string& text)
        : path(std::filesystem::temp_directory_path() / (std::to_string(getpid()) + name)) {
        std::ofstream(path) << text;
    }
    ~TextFile() { std::filesystem::remove(path); }
    const std::filesystem::path path;
};

std::string error_of(const auto& f) {
    try {
        f();
    } catch (const InputError& e) {
        return e.what();
    }
    return "";
}

constexpr const char* scene_text = R"(<scene version="3.0.0">
<default name="x" value="0"/><default name="paint" value="0.5"/><default name="power" value="1"/><default name="fov" value="40"/><default name="width" value="4"/>
<sensor type="perspective"><float name="fov" value="$fov"/><film type="hdrfilm"><integer name="width" value="$width"/><integer name="height" value="4"/></film></sensor>
<shape type="rectangle" id="floor"/>
<shape type="sphere" id="ball"><transform name="to_world"><translate x="$x" z="1"/></transform></shape>
<shape type="cube" id="box"><bsdf type="diffuse"><rgb name="reflectance" value="$paint, 0.5, 0.5"/></bsdf></shape>
<shape type="disk" id="lamp"><transform name="to_world"><translate z="3"/></transform><emitter type="area"><rgb name="radiance" value="$power, 1, 1"/></emitter></shape>
<emitter type="constant"/></scene>)";

struct Case {
    TextFile scene, table;
    std::string absent;
    explicit Case(const std::string& rows, std::string absent_value = {}, const std::string& text = scene_text)
        : scene(".xml", text), table(".tsv", rows), absent(std::move(absent_value)) {}

    Frames frames() const { return read_frames(table.path.string(), absent); }
    Animation animation() const { return find_animation(scene.path, {}, "", frames()); }
    std::uint64_t hash() const { return build_scene(animation().still)->content_hash; }
};

TEST(FrameTable, AreReadInTheOrderOfTheFile) {
    const Case c("x\tframe\tpaint\r\n1\t7\t.2\r\n\n-2\t3\t.4\n");
    const Frames frames = c.frames();
    EXPECT_EQ(frames.parameters, (std::vector<std::string>{"x", "paint"}));
    ASSERT_EQ(frames.frames.size(), 2u);
    EXPECT_EQ(frames.frames[0].number, 7u);
    EXPECT_EQ(frames.frames[1].line, 4u);
    EXPECT_EQ(frames.values_of(frames.frames[1], {{"fov", "9"}}),
              (Defines{{"fov", "9"}, {"x", "-2"}, {"paint", ".4"}}));
}

TEST(FrameTable, ErrorsNameLineAndColumn) {
    const auto error = [](const std::string& text) { return error_of([&] { Case(text).frames(); }); };
    EXPECT_NE(error("x\n1\n").find("has no column frame"), std::string::npos);
    EXPECT_NE(error("frame\tx\tx\n0\t1\t1\n").find("column 'x' is there twice"), std::string::npos);
    EXPECT_NE(error("frame\t\n0\t1\n").find("column 2 has no name"), std::string::npos);
    EXPECT_NE(error("frame\tx\n").find("has no rows"), std::string::npos);
    EXPECT_NE(error("").find("has no rows"), std::string::npos);
    EXPECT_NE(error("frame\tx\n0\n").find(":2: has 1 cells, the first line has 2"), std::string::npos);
    EXPECT_NE(error("frame\tx\n0\t\n").find(":2: frame 0: 'x' has no value"), std::string::npos);
    EXPECT_NE(error("frame\tx\n0\t1\n0\t2\n").find(":3: frame 0 is there twice"), std::string::npos);
    for (const char* number : {"a", "-1", "1.5", "1000000", "0x1", " 1", "../1", ""})
        EXPECT_NE(error(std::string("frame\tx\n") + number + "\t2\n").find("expected a number from 0"),
                  std::string::npos)
            << number;
}

TEST(Animation, LeavesOutWhatMoves) {
    const Animation a = Case("frame\tx\n0\t0\n1\t0\n2\t.5\n").animation();
    EXPECT_EQ(a.moving, std::vector<std::string>{"'ball'"});
    EXPECT_TRUE(a.relit.empty());
    EXPECT_EQ(a.describe(), "static: without 'ball'");
    const auto scene = build_scene(a.still);
    ASSERT_EQ(scene->shapes.size(), 3u);
    EXPECT_EQ(scene->shapes[1].id, "box");
    EXPECT_EQ(scene->emitters.size(), 2u);
    EXPECT_FALSE(a.fixed);
}

TEST(Animation, RepaintedShapesMoveAndLightsStay) {
    const Animation a = Case("frame\tpaint\tpower\n0\t.5\t3\n1\t.6\t4\n").animation();
    EXPECT_EQ(a.moving, std::vector<std::string>{"'box'"});
    EXPECT_EQ(a.relit, std::vector<std::string>{"'lamp'"});
    EXPECT_EQ(a.describe(), "static: without 'box'; lights of the first frame: 'lamp'");
    const auto scene = build_scene(a.still);
    ASSERT_EQ(scene->shapes.size(), 3u);
    EXPECT_EQ(scene->emitters[0].radiance.r, 3);
    ASSERT_TRUE(a.fixed);
    EXPECT_EQ(build_scene(*a.fixed)->shapes.size(), 2u);
}

TEST(Animation, NothingDiffers) {
    const Animation a = Case("frame\tx\n0\t1\n1\t1.0\n").animation();
    EXPECT_EQ(a.describe(), "static: nothing differs between the frames");
    EXPECT_EQ(build_scene(a.still)->shapes.size(), 4u);
}

// The same static scene of other frames is the same scene: its files need not be made again.
TEST(Animation, ItsContentAloneIdentifiesTheStaticScene) {
    const std::uint64_t hash = Case("frame\tx\n0\t0\n1\t1\n").hash();
    EXPECT_EQ(Case("frame\tx\n5\t7\n1\t-1\n2\t0\n").hash(), hash);
    EXPECT_EQ(Case("frame\tx\tpaint\n0\t0\t.5\n1\t1\t.5\n").hash(), hash);
    EXPECT_NE(Case("frame\tx\tpaint\n0\t0\t.6\n1\t1\t.6\n").hash(), hash);
    EXPECT_NE(Case("frame\tx\tpaint\n0\t0\t.5\n1\t1\t.6\n").hash(), hash);
    EXPECT_NE(Case("frame\tx\n0\t0\n1\t0\n").hash(), hash);
    EXPECT_NE(Case("frame\tx\tpower\n0\t0\t2\n1\t1\t1\n").hash(), hash);
}

TEST(Animation, EqualFramesHaveEqualHashes) {
    const auto hashes = [](const char* rows) {
        const Animation animation = Case(rows).animation();
        EXPECT_EQ(animation.still.parameters.at("static scene"), animation.still_hash);
        return animation.frame_hashes;
    };
    const auto one = hashes("frame\tx\n0\t0.1\n1\t0.2\n2\t0.10\n");
    EXPECT_EQ(one[0], one[2]);
    EXPECT_NE(one[0], one[1]);
    // Whatever the other rows and columns: what a value changes in the scene counts.
    const auto two = hashes("frame\tpaint\tx\n5\t0.6\t0.3\n6\t0.5\t0.2\n");
    EXPECT_EQ(two[1], one[1]);
    EXPECT_NE(two[0], one[0]);
}

std::size_t n_shapes(const SceneDescription& description) {
    return description.root->children(Category::shape).size();
}

// Detected mutation: all shapes of the frame kept.
TEST(Animation, ShapesOfAbsentParametersAreLeftOut) {
    // Absent at first, in the middle, in the end.
    for (const char* rows : {"frame\tx\n0\tnone\n1\t0\n2\t1\n", "frame\tx\n0\t0\n1\tnone\n2\t1\n",
                             "frame\tx\n0\t0\n1\t1\n2\tnone\n", "frame\tx\n0\t0\n1\t0\n2\tnone\n"}) {
        const Case c(rows, "none");
        const Animation a = c.animation();
        EXPECT_EQ(a.describe(), "static: without 'ball'") << rows;
        EXPECT_EQ(n_shapes(a.still), 3u);
        for (std::size_t i = 0; i < 3; ++i) {
            const bool lacks = !c.frames().absent_in(c.frames().frames[i]).empty();
            EXPECT_EQ(n_shapes(a.frames[i]), lacks ? 3u : 4u) << rows << i;
        }
        // The static scene is that of a ball which moves.
        EXPECT_EQ(a.still_hash, Case("frame\tx\n0\t0\n1\t1\n").animation().still_hash);
    }
    // Absent in all frames: in none, and no shape differs.
    EXPECT_EQ(Case("frame\tx\n0\tnone\n1\tnone\n", "none").animation().describe(),
              "static: nothing differs between the frames");
    // A frame without a parameter's shapes is a scene without them.
    const Animation two = Case("frame\tx\tpaint\n0\t0\t.5\n1\tnone\tnone\n2\t0\tnone\n", "none").animation();
    EXPECT_EQ(two.describe(), "static: without 'ball', 'box'");
    EXPECT_EQ(n_shapes(two.frames[1]), 2u);
    EXPECT_EQ(two.frame_hashes[1], two.still_hash);
}

TEST(Animation, LightsMayBeAbsent) {
    const Animation a = Case("frame\tpower\n0\tnone\n1\t2\n2\t3\n", "none").animation();
    EXPECT_EQ(a.describe(), "lights of the first frame: 'lamp'");
    EXPECT_EQ(n_shapes(a.still), 3u);
    EXPECT_EQ(n_shapes(a.frames[2]), 4u);
}

TEST(Animation, AbsentParametersAreOfShapesAlone) {
    const auto error = [](const std::string& rows) { return error_of([&] { Case(rows, "none").animation(); }); };
    const std::string wrong = error("frame\tfov\n0\t40\n4\tnone\n");
    EXPECT_NE(wrong.find(":3: frame 4: "), std::string::npos) << wrong;
    EXPECT_NE(wrong.find("$fov is absent ('none')"), std::string::npos) << wrong;
    // Another value is one.
    EXPECT_NE(error("frame\tx\n0\t1\n9\tNone\n").find(":3: frame 9: "), std::string::npos);
}

// A mesh that deforms is another file in each frame: removed and added. Without an id as with one.
TEST(Animation, OtherMeshesAreMovingShapes) {
    const auto obj = [](const char* name, double z) {
        return TextFile(name, "v 0 0 " + std::to_string(z) + "\nv 1 0 0\nv 0 1 0\nf 1 2 3\n");
    };
    const TextFile one = obj("one.obj", 0), two = obj("two.obj", 0.5);
    for (const std::string id : {"", " id=\"cloth\""}) {
        std::string text = scene_text;
        text.replace(text.find("<shape type=\"rectangle\""), 0,
                     "<default name=\"mesh\" value=\"x\"/><shape type=\"obj\"" + id +
                         "><string name=\"filename\" value=\"$mesh\"/></shape>");
        const std::string a = one.path.string(), b = two.path.string();
        const Animation animation =
            Case("frame\tmesh\n0\t" + a + "\n1\t" + b + "\n2\t" + a + "\n", "", text).animation();
        EXPECT_EQ(animation.describe(), id.empty() ? "static: without number 1 (obj)" : "static: without 'cloth'");
        EXPECT_EQ(n_shapes(animation.still), 4u);
        EXPECT_EQ(animation.frame_hashes[0], animation.frame_hashes[2]);
        EXPECT_NE(animation.frame_hashes[0], animation.frame_hashes[1]);
        for (const SceneDescription& frame : animation.frames) EXPECT_EQ(n_shapes(frame), 5u);
    }
}

TEST(Animation, CamerasMayMoveWhereThatIsAllowed) {
    const auto found = [](const char* rows) {
        const Case c(rows);
        return find_animation(c.scene.path, {}, "", c.frames(), Cameras::each);
    };
    const char* stands = "frame\tx\n0\t0\n4\t1\n";
    const Animation animation = found("frame\tfov\tx\n0\t40\t0\n4\t41\t1\n"),
                    other = found("frame\tx\tfov\n7\t2\t50\n8\t0\t60\n"), still = found(stands);
    EXPECT_TRUE(animation.camera_moves);
    EXPECT_EQ(animation.describe(), "static: without 'ball'; the camera moves");
    EXPECT_EQ(animation.moving, std::vector<std::string>{"'ball'"});
    // Whatever the cameras, the static scene is the same; one that stands still is a part of it.
    EXPECT_EQ(animation.still_hash, other.still_hash);
    EXPECT_EQ(build_scene(animation.still)->content_hash, build_scene(other.still)->content_hash);
    EXPECT_NE(animation.frame_hashes[0], animation.frame_hashes[1]);
    EXPECT_FALSE(still.camera_moves);
    EXPECT_EQ(still.still_hash, Case(stands).animation().still_hash);
    EXPECT_NE(still.still_hash, animation.still_hash);
    // The static scene from the camera of another frame.
    const SceneDescription aimed = with_camera_of(animation.still, other.still);
    EXPECT_EQ(aimed.root->children(Category::shape).size(), 3u);
    const auto here = build_scene(animation.still), there = build_scene(SceneDescription(aimed));
    EXPECT_EQ(there->sensor.tan_half_fov_x, build_scene(other.still)->sensor.tan_half_fov_x);
    EXPECT_NE(there->sensor.tan_half_fov_x, here->sensor.tan_half_fov_x);
    set_camera(*here, *aimed.root);
    EXPECT_EQ(there->sensor.tan_half_fov_x, here->sensor.tan_half_fov_x);
    EXPECT_NE(error_of([&] {
                  found("frame\tx\twidth\n0\t0\t4\n1\t0\t5\n");
              }).find(":3: frame 1: has another kind of sensor or another film than frame 0"),
              std::string::npos);
}

TEST(Animation, ErrorsNameTheFrame) {
    const auto error = [](const std::string& rows) { return error_of([&] { Case(rows).animation(); }); };
    EXPECT_NE(error("frame\tfov\n0\t40\n4\t41\n").find(":3: frame 4: has another sensor than frame 0"),
              std::string::npos);
    EXPECT_NE(error("frame\tunknown\n0\t1\n").find(":2: frame 0: "), std::string::npos);
    EXPECT_NE(error("frame\tx\n0\t1\n9\tone\n").find(":3: frame 9: "), std::string::npos);
}

}  // namespace
}  // namespace loom
