// The index of refraction along a path, worked out by hand. Detected mutations: leaving pops the innermost entry
// whatever the shape; the outside of the first surface is not kept.

#include "stages/core/scene/media.h"

#include <gtest/gtest.h>

#include "tests/traced_graph.h"

namespace loom::test {
namespace {

constexpr std::uint32_t glass = 1, water = 2, bubble = 3;

TEST(MediumStack, VacuumBeforeAnySurface) {
    EXPECT_EQ(MediumStack().index(), 1.0f);
}

TEST(MediumStack, NestedObjects) {
    MediumStack media;  // a bubble in a glass ball
    media.cross(glass, true, 1.5f, 1.0f);
    EXPECT_EQ(media.index(), 1.5f);
    media.cross(bubble, true, 1.1f, 1.5f);
    EXPECT_EQ(media.index(), 1.1f);
    media.cross(bubble, false, 1.1f, 1.5f);
    EXPECT_EQ(media.index(), 1.5f);
    media.cross(glass, false, 1.5f, 1.0f);
    EXPECT_EQ(media.index(), 1.0f);
}

TEST(MediumStack, ImmersedObjectKnowsItsSurroundings) {
    MediumStack media;  // a scene in water: the first surface shows it
    media.cross(glass, true, 1.5f, 1.33f);
    EXPECT_EQ(media.index(), 1.5f);
    media.cross(glass, false, 1.5f, 1.33f);
    EXPECT_EQ(media.index(), 1.33f);
}

TEST(MediumStack, OverlappingObjectsCanBeLeftInAnotherOrder) {
    MediumStack media;  // glass dips into water: in by the glass, out of it inside of the water
    media.cross(glass, true, 1.5f, 1.0f);
    media.cross(water, true, 1.33f, 1.0f);
    EXPECT_EQ(media.index(), 1.33f);
    media.cross(glass, false, 1.5f, 1.0f);
    EXPECT_EQ(media.index(), 1.33f);
    media.cross(water, false, 1.33f, 1.0f);
    EXPECT_EQ(media.index(), 1.0f);
}

TEST(MediumStack, APathThatBeginsInsideLearnsTheOutsideWhenItLeaves) {
    MediumStack media;
    media.cross(water, false, 1.33f, 1.01f);
    EXPECT_EQ(media.index(), 1.01f);
    media.cross(glass, true, 1.5f, 1.01f);
    media.cross(glass, false, 1.5f, 1.01f);
    EXPECT_EQ(media.index(), 1.01f);
}

// Detected mutation: only the shape that was entered can be left.
TEST(MediumStack, AnObjectMadeOfTwoShapesIsLeftByEither) {
    MediumStack media;  // front and back of a pane; a bottle whose inside is another mesh
    EXPECT_TRUE(media.cross(1, true, 1.5f, 1.0f));
    EXPECT_TRUE(media.cross(2, false, 1.5f, 1.0f));
    EXPECT_EQ(media.index(), 1.0f);
    EXPECT_FALSE(media.cross(2, false, 1.5f, 1.0f));
}

TEST(MediumStack, ShapesCrossedWithoutTheirOppositeDoNoHarm) {
    MediumStack media;  // open surfaces: entered again and again, deeper than the stack is high
    for (std::uint32_t shape = 0; shape < 40; ++shape) media.cross(shape, true, 1.5f, 1.0f);
    EXPECT_EQ(media.index(), 1.5f);
    for (std::uint32_t shape = 0; shape < 40; ++shape) media.cross(shape, false, 1.5f, 1.0f);
    EXPECT_EQ(media.index(), 1.0f);
}

std::string dielectric(const char* shape, double int_ior, double ext_ior = 1) {
    return fmt::format(
        R"(<shape {}<bsdf type="dielectric"><float name="int_ior" value="{}"/><float name="ext_ior" value="{}"/></bsdf></shape>)",
        shape, int_ior, ext_ior);
}
constexpr const char* ball = R"(type="sphere">)";
constexpr const char* box = R"(type="cube"><transform name="to_world"><scale value="5"/></transform>)";
constexpr const char* surface =
    R"(type="rectangle"><transform name="to_world"><scale value="20"/></transform>)";  // of water, in z = 0
constexpr const char* tiles =
    R"(<shape type="cube"><transform name="to_world"><scale value="1"/></transform><boolean name="flip_normals" value="true"/></shape>)";
constexpr const char* basement =
    R"(<shape type="cube"><transform name="to_world"><scale value="1"/><translate z="-3"/></transform></shape>)";

/// Index at a point of a scene of these shapes.
float index_at(const std::string& body, const Point3f& p) {
    return media_at(*testing::load_inline({.sensor = R"(type="perspective">)", .body = body}), p).index();
}

// Detected mutation: every surface entered, with any normal.
TEST(MediaAt, InsideOfAClosedShape) {
    EXPECT_EQ(index_at(dielectric(ball, 1.5), {0.3f, 0.1f, -0.9f}), 1.5f);
    EXPECT_EQ(index_at(dielectric(ball, 1.5), {0.8f, 0.8f, 0}), 1.0f);
    EXPECT_EQ(index_at(dielectric(box, 1.25), {4.99f, 0, 0}), 1.25f);
}

// Detected mutations: the innermost first; an entered shape replaces the one around it.
TEST(MediaAt, NestedShapesCountFromOutsideIn) {
    const std::string both = dielectric(ball, 1.5, 1.25) + dielectric(box, 1.25);
    const auto scene = testing::load_inline({.sensor = R"(type="perspective">)", .body = both});
    MediumStack media = media_at(*scene, {0, 0.2f, 0});
    ASSERT_EQ(media.entries().size(), 2u);
    EXPECT_EQ(media.entries()[0].shape, 1u);
    EXPECT_EQ(media.index(), 1.5f);
    media.cross(0, false, 1.5f, 1.25f);
    EXPECT_EQ(media.index(), 1.25f);
    EXPECT_EQ(media_at(*scene, {3, 0, 0}).index(), 1.25f);
    EXPECT_EQ(media_at(*scene, {6, 0, 0}).index(), 1.0f);
}

// Detected mutation: inside only of shapes that all directions leave.
TEST(MediaAt, AnOpenSurfaceHasItsInsideBehindIt) {
    EXPECT_EQ(index_at(dielectric(surface, 1.25), {1, 2, -0.5f}), 1.25f);
    EXPECT_EQ(index_at(dielectric(surface, 1.25), {1, 2, 0.5f}), 1.0f);
}

// Detected mutations: rays that pass opaque walls; inside only of shapes that all directions leave.
TEST(MediaAt, AnOpaqueWallEndsWhatIsSeen) {
    // A pool that is tiled within the water sees it through its open side alone; a dry basement does not see the lake
    // above.
    EXPECT_EQ(index_at(dielectric(surface, 1.25) + basement, {0, 0, -3}), 1.0f);
    EXPECT_EQ(index_at(dielectric(box, 1.25) + tiles, {0, 0, 3}), 1.25f);
}

// Detected mutations: vacuum outside of all shapes; one direction instead of 64.
TEST(MediaAt, OutsideOfEverythingTheFirstSurfaceTells) {
    EXPECT_EQ(index_at(dielectric(ball, 1.5, 1.25), {0, 0, 3}), 1.25f);
    EXPECT_EQ(index_at("", {0, 0, 3}), 1.0f);
}

// A tank without a lid, from the side: some directions hit its far wall from within. Detected mutation: inside of a
// shape that any direction leaves.
TEST(MediaAt, BesideAnOpenTank) {
    const auto file = testing::scratch_file(".obj");
    std::ofstream(file) << "v -1 -1 -1\nv 1 -1 -1\nv 1 1 -1\nv -1 1 -1\nv -1 -1 1\nv 1 -1 1\nv 1 1 1\nv -1 1 1\n"
                           "f 4 3 2 1\nf 1 2 6 5\nf 2 3 7 6\nf 3 4 8 7\nf 4 1 5 8\n";
    const std::string tank = dielectric(
        fmt::format(R"(type="obj"><string name="filename" value="{}"/><boolean name="face_normals" value="true"/>)",
                    file.string())
            .c_str(),
        1.25);
    EXPECT_EQ(index_at(tank, {1.3f, 0, 1.05f}), 1.0f);
    EXPECT_EQ(index_at(tank, {0, 0, 0.5f}), 1.25f);
    std::filesystem::remove(file);
}

// Detected mutation: only the shape that was entered can be left.
TEST(MediaAt, APaneOfTwoShapesSeenFromBothSides) {
    const std::string pane =
        dielectric(R"(type="rectangle"><transform name="to_world"><translate z="0.01"/></transform>)", 1.5) +
        dielectric(
            R"(type="rectangle"><transform name="to_world"><rotate x="1" angle="180"/><translate z="-0.01"/></transform>)",
            1.5);
    for (const float z : {-2.0f, 2.0f}) EXPECT_EQ(index_at(pane, {0, 0, z}), 1.0f);
}

}  // namespace
}  // namespace loom::test
