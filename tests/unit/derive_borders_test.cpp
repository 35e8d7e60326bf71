// Borders that move and that loom-derive does not sample: it names them where a scene has them.

#include <gtest/gtest.h>

#include "stages/derive/boundary.h"
#include "tests/unit/derive_scenes.h"

namespace loom {
namespace {

using namespace derive;

/// A floor, a ball and a block that cut it, a plate at rest, an area light.
/// in:      bsdf  of the plate
std::unique_ptr<Scene> scene_with(const std::string& bsdf, int max_depth = 4) {
    testing::InlineScene s;
    s.sensor =
        R"(type="perspective"><transform name="to_world"><lookat origin="0, -4, 2" target="0, 0, 0" up="0, 0, 1"/></transform>)";
    s.max_depth = max_depth;
    s.width = s.height = 4;
    s.body = fmt::format(R"(
<shape type="rectangle" id="floor"><transform name="to_world"><scale value="2"/></transform></shape>
<shape type="sphere" id="ball"><point name="center" x="1" z="0.2"/><float name="radius" value="0.4"/></shape>
<shape type="cube" id="block"><transform name="to_world"><scale value="0.3"/><translate x="-1" z="0.1"/></transform></shape>
<shape type="rectangle" id="plate"><transform name="to_world"><scale value="0.3"/><translate z="1"/></transform>{}</shape>
<shape type="rectangle" id="lamp"><transform name="to_world"><scale value="0.3"/><rotate x="1" angle="180"/><translate z="3"/></transform><emitter type="area"/></shape>)",
                         bsdf);
    return testing::load_inline(s);
}
SceneTangents moved(const Scene& scene, std::uint32_t shape) {
    SceneTangents t(scene);
    t.shapes[shape].push_back({testing::add_parameter(t, "x"), testing::rigid_motion({}, {1, 0, 0})});
    return t;
}
constexpr std::uint32_t ball = 1, block = 2, plate = 3, lamp = 4;
constexpr const char* of_ball = "lines where ball and floor cut each other";
constexpr const char* of_texture = "borders within textures (nearest, checkerboard, masks)";

TEST(DeriveBorders, ThatAreNotSampledAreNamed) {
    const auto plain = scene_with(""),
               checked = scene_with(R"(<bsdf type="diffuse"><texture type="checkerboard" name="reflectance"/></bsdf>)");
    const PathGraph graph =
        testing::trace_graph(*plain, testing::path_options(*plain, 1), 1, 0, testing::derive_columns);
    const auto missed = [&](const Scene& scene, const SceneTangents& t, Attachment attachment) {
        return required_parts(scene, graph, t, {}, attachment).not_sampled;
    };
    // Points keep their places: only what moves counts. The block's line is sampled.
    EXPECT_EQ(missed(*plain, moved(*plain, ball), Attachment::surface), of_ball);
    EXPECT_EQ(missed(*plain, moved(*plain, block), Attachment::surface), "");
    EXPECT_EQ(missed(*plain, moved(*plain, plate), Attachment::surface), "");
    EXPECT_EQ(missed(*checked, moved(*checked, block), Attachment::surface), "");
    EXPECT_EQ(missed(*checked, moved(*checked, plate), Attachment::surface), of_texture);
    EXPECT_EQ(missed(*checked, moved(*checked, ball), Attachment::surface), of_ball);
    // They slide over all.
    const std::string both = std::string(of_texture) + ", " + of_ball;
    EXPECT_EQ(missed(*plain, moved(*plain, block), Attachment::automatic), of_ball);
    EXPECT_EQ(missed(*checked, moved(*checked, block), Attachment::automatic), both);
    SceneTangents camera(*checked);
    camera.camera.push_back({testing::add_parameter(camera, "x"), testing::rigid_motion({}, {1, 0, 0})});
    EXPECT_EQ(missed(*checked, camera, Attachment::surface), both);
    // Nothing moves.
    EXPECT_EQ(missed(*checked, SceneTangents(*checked), Attachment::automatic), "");
}

TEST(DeriveBorders, AnEmitterThatIsCutNeedsTheIndirectPart) {
    const auto scene = scene_with("", 2);
    const PathGraph graph =
        testing::trace_graph(*scene, testing::path_options(*scene, 1), 1, 0, testing::derive_columns);
    EXPECT_FALSE(required_parts(*scene, graph, moved(*scene, block), {}).indirect);
    EXPECT_FALSE(required_parts(*scene, graph, moved(*scene, lamp), {}).indirect);
    scene->shapes[block].emitter_idx = 0;
    EXPECT_TRUE(required_parts(*scene, graph, moved(*scene, block), {}).indirect);
    EXPECT_FALSE(required_parts(*scene, graph, moved(*scene, plate), {}).indirect);
}

}  // namespace
}  // namespace loom
