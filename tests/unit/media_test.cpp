// The index of refraction along a path, worked out by hand. Breaks that were watched to fail: leaving pops the
// innermost entry whatever the shape; the outside of the first surface is not kept.

#include "stages/core/transport/media.h"

#include <gtest/gtest.h>

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
    MediumStack media;  // a scene that lies in water: the first surface says so
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

TEST(MediumStack, ShapesCrossedWithoutTheirOppositeDoNoHarm) {
    MediumStack media;  // open surfaces: entered again and again, deeper than the stack is high
    for (std::uint32_t shape = 0; shape < 40; ++shape) media.cross(shape, true, 1.5f, 1.0f);
    EXPECT_EQ(media.index(), 1.5f);
    for (std::uint32_t shape = 0; shape < 40; ++shape) media.cross(shape, false, 1.5f, 1.0f);
    EXPECT_EQ(media.index(), 1.0f);
}

}  // namespace
}  // namespace loom::test
