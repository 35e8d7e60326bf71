// Which way the normals of our own shapes point, mirrored or not, as Mitsuba 3.8 has them (its shading normals; for
// flat meshes of ours the geometric normal is the same). Detected mutations: triangles of a mirrored cube not turned
// round, a mirrored sphere left as it is, flip_normals of a disk ignored, a mirrored sphere's z taken for the cross
// product of its x and y.

#include <gtest/gtest.h>

#include "stages/core/scene/build.h"
#include "tests/unit/scene_folder.h"

namespace loom::test {
namespace {

class Interaction : public SceneFolder {
  protected:
    /// Returns the hit of a ray from (0.2, 0.3, 5) downwards.
    SurfacePoint below(const std::string& shape, const std::string& parameters) {
        const auto scene = load_scene(
            write("scene.xml", text("<shape type='" + shape + "'>" + parameters + "<bsdf type='diffuse'/></shape>")));
        const Ray ray{{0.2f, 0.3f, 5}, {0, 0, -1}};
        const Hit hit = scene->intersect(ray);
        EXPECT_TRUE(hit) << shape;
        return hit ? scene->surface(ray, hit) : SurfacePoint();
    }
    static std::string scaled(const std::string& scale, bool flipped = false) {
        return "<transform name='to_world'><scale " + scale + "/></transform>" +
               (flipped ? "<boolean name='flip_normals' value='true'/>" : "");
    }
};

void expect_normal(const SurfacePoint& at, const Vector3f& n, const std::string& what) {
    // The octahedral code of the graph rounds normals to about 1e-4.
    EXPECT_NEAR(length(Vector3f(at.frame.n) - n), 0, 1e-4) << what;
    EXPECT_NEAR(length(Vector3f(at.ng) - n), 0, 1e-4) << what;
    EXPECT_EQ(at.ns_smooth, at.frame.n) << what;
}

constexpr const char* mirrored_x = "x='-1'";
constexpr const char* mirrored_z = "z='-1'";

TEST_F(Interaction, RectangleAndDiskTurnWithTheirZAxis) {
    for (const char* shape : {"rectangle", "disk"}) {
        expect_normal(below(shape, ""), {0, 0, 1}, shape);
        expect_normal(below(shape, scaled(mirrored_x)), {0, 0, 1}, shape);
        expect_normal(below(shape, scaled("x='-2' y='1.5' z='0.5'")), {0, 0, 1}, shape);
        expect_normal(below(shape, scaled(mirrored_z)), {0, 0, -1}, shape);
        expect_normal(below(shape, scaled(mirrored_x, true)), {0, 0, -1}, shape);
    }
}

TEST_F(Interaction, CubeFacesOutwardsWhateverTheMirror) {
    for (const char* scale : {"x='1'", mirrored_x, mirrored_z, "x='-2' y='1.5' z='0.5'"}) {
        expect_normal(below("cube", scaled(scale)), {0, 0, 1}, scale);
        expect_normal(below("cube", scaled(scale, true)), {0, 0, -1}, scale);
    }
}

TEST_F(Interaction, MirroredSphereFacesInwards) {
    const Vector3f outwards{0.2f, 0.3f, 0.932738f};
    expect_normal(below("sphere", ""), outwards, "");
    expect_normal(below("sphere", scaled("x='1'", true)), -outwards, "flipped");
    for (const char* scale : {mirrored_x, mirrored_z}) {
        expect_normal(below("sphere", scaled(scale)), -outwards, scale);
        expect_normal(below("sphere", scaled(scale, true)), outwards, scale);
    }
}

// Values of Mitsuba 3.8 for the same rays.
TEST_F(Interaction, TextureCoordinates) {
    const auto expect_uv = [](const SurfacePoint& at, float u, float v) {
        EXPECT_NEAR(at.uv.x, u, 1e-5);
        EXPECT_NEAR(at.uv.y, v, 1e-5);
    };
    // Texture coordinates are computed only where they are needed: here by an emitter.
    const std::string lamp = "<emitter type='area'/>";
    expect_uv(below("rectangle", lamp), 0.6f, 0.65f);
    expect_uv(below("rectangle", lamp + scaled(mirrored_x)), 0.4f, 0.65f);
    expect_uv(below("cube", lamp), 0.65f, 0.6f);
    expect_uv(below("cube", lamp + scaled(mirrored_x)), 0.65f, 0.4f);
    expect_uv(below("disk", lamp), 0.360555f, 0.156416f);
    expect_uv(below("disk", lamp + scaled(mirrored_x)), 0.360555f, 0.343584f);
    expect_uv(below("sphere", lamp), 0.156416f, 0.117413f);
    expect_uv(below("sphere", lamp + scaled(mirrored_x)), 0.343584f, 0.117413f);
    expect_uv(below("sphere", lamp + scaled(mirrored_z)), 0.156416f, 0.882587f);
}

}  // namespace
}  // namespace loom::test
