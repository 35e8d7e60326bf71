// The index of refraction along a path, worked out by hand. Detected mutations: leaving pops the innermost entry
// whatever the shape; the outside of the first surface is not kept.

#include "stages/core/scene/media.h"

#include <gtest/gtest.h>

#include "tests/traced_graph.h"

namespace loom::test {
namespace {

constexpr std::uint32_t glass = 1, water = 2, bubble = 3;

TEST(MediumStack, VacuumBeforeAnySurface) {
    EXPECT_EQ(MediumStack().medium().ior, 1.0f);
}

TEST(MediumStack, NestedObjects) {
    MediumStack media;  // a bubble in a glass ball
    media.cross({glass}, true, 1.5f, 1.0f);
    EXPECT_EQ(media.medium().ior, 1.5f);
    media.cross({bubble}, true, 1.1f, 1.5f);
    EXPECT_EQ(media.medium().ior, 1.1f);
    media.cross({bubble}, false, 1.1f, 1.5f);
    EXPECT_EQ(media.medium().ior, 1.5f);
    media.cross({glass}, false, 1.5f, 1.0f);
    EXPECT_EQ(media.medium().ior, 1.0f);
}

TEST(MediumStack, ImmersedObjectKnowsItsSurroundings) {
    MediumStack media;  // a scene in water: the first surface shows it
    media.cross({glass}, true, 1.5f, 1.33f);
    EXPECT_EQ(media.medium().ior, 1.5f);
    media.cross({glass}, false, 1.5f, 1.33f);
    EXPECT_EQ(media.medium().ior, 1.33f);
}

TEST(MediumStack, OverlappingObjectsCanBeLeftInAnotherOrder) {
    MediumStack media;  // glass dips into water: in by the glass, out of it inside of the water
    media.cross({glass}, true, 1.5f, 1.0f);
    media.cross({water}, true, 1.33f, 1.0f);
    EXPECT_EQ(media.medium().ior, 1.33f);
    media.cross({glass}, false, 1.5f, 1.0f);
    EXPECT_EQ(media.medium().ior, 1.33f);
    media.cross({water}, false, 1.33f, 1.0f);
    EXPECT_EQ(media.medium().ior, 1.0f);
}

TEST(MediumStack, APathThatBeginsInsideLearnsTheOutsideWhenItLeaves) {
    MediumStack media;
    media.cross({water}, false, 1.33f, 1.01f);
    EXPECT_EQ(media.medium().ior, 1.01f);
    media.cross({glass}, true, 1.5f, 1.01f);
    media.cross({glass}, false, 1.5f, 1.01f);
    EXPECT_EQ(media.medium().ior, 1.01f);
}

// Detected mutation: only the shape that was entered can be left.
TEST(MediumStack, AnObjectMadeOfTwoShapesIsLeftByEither) {
    MediumStack media;  // front and back of a pane; a bottle whose inside is another mesh
    EXPECT_TRUE(media.cross({1}, true, 1.5f, 1.0f));
    EXPECT_TRUE(media.cross({2}, false, 1.5f, 1.0f));
    EXPECT_EQ(media.medium().ior, 1.0f);
    EXPECT_FALSE(media.cross({2}, false, 1.5f, 1.0f));
}

TEST(MediumStack, ShapesCrossedWithoutTheirOppositeDoNoHarm) {
    MediumStack media;  // open surfaces: entered again and again, deeper than the stack is high
    for (std::uint32_t shape = 0; shape < 40; ++shape) media.cross({shape}, true, 1.5f, 1.0f);
    EXPECT_EQ(media.medium().ior, 1.5f);
    for (std::uint32_t shape = 0; shape < 40; ++shape) media.cross({shape}, false, 1.5f, 1.0f);
    EXPECT_EQ(media.medium().ior, 1.0f);
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
    return media_at(*testing::load_inline({.sensor = R"(type="perspective">)", .body = body}), p).medium().ior;
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
    EXPECT_EQ(media.entries()[0].shape_idx, 1u);
    EXPECT_EQ(media.medium().ior, 1.5f);
    media.cross({0}, false, 1.5f, 1.25f);
    EXPECT_EQ(media.medium().ior, 1.25f);
    EXPECT_EQ(media_at(*scene, {3, 0, 0}).medium().ior, 1.25f);
    EXPECT_EQ(media_at(*scene, {6, 0, 0}).medium().ior, 1.0f);
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

// A ball of one dielectric in a box of another with the same index: the stack names the material.
TEST(MediumStack, NamesTheMaterialOfTheMedium) {
    MediumStack media;
    EXPECT_EQ(media.medium().material_idx, Medium::outside);
    media.cross({0, 4}, true, 1.5f, 1.0f);
    media.cross({1, 7}, true, 1.5f, 1.5f);
    EXPECT_EQ(media.medium().material_idx, 7);
    media.cross({1, 7}, false, 1.5f, 1.5f);
    EXPECT_EQ(media.medium().material_idx, 4);
    media.cross({0, 4}, false, 1.5f, 1.0f);
    EXPECT_EQ(media.medium().material_idx, Medium::outside);
}

/// A room with a sphere of glass in a box of glass of the same index, all with ids, and a mesh with smooth normals.
std::unique_ptr<Scene> glass_in_glass() {
    return testing::load_inline(
        {.sensor =
             R"(type="perspective"><transform name="to_world"><lookat origin="0, 0, -4" target="0, 0, 0" up="0, 1, 0"/></transform>)",
         .body =
             R"(<shape type="cube"><boolean name="flip_normals" value="true"/><transform name="to_world"><scale value="5"/></transform>
<bsdf type="diffuse"/></shape>
<shape type="cube"><bsdf type="dielectric" id="box"><float name="int_ior" value="1.3"/><float name="ext_ior" value="1"/></bsdf></shape>
<shape type="sphere"><float name="radius" value="0.7"/>
<bsdf type="dielectric" id="ball"><float name="int_ior" value="1.3"/><float name="ext_ior" value="1.3"/></bsdf></shape>
<shape type="rectangle"><transform name="to_world"><rotate x="1" angle="90"/><translate y="4"/></transform><emitter type="area"/></shape>
<emitter type="point"><point name="position" x="3" y="3" z="-3"/></emitter>)",
         .width = 16,
         .height = 16});
}

// Detected mutations: the medium of the segment that leaves stored in place of the one that arrives; the primitive of
// the structure-of-arrays twin left out; media stored without --media.
TEST(OptionalColumns, MediaAndPrimitivesAreThoseOfTheVertices) {
    const auto scene = glass_in_glass();
    const PathOptions path = testing::path_options(*scene, 3);
    const PathGraph plain = testing::trace_graph(*scene, path, 64);
    const PathGraph graph = testing::trace_graph(*scene, path, 64, 0, {.primitives = true, .media = true});
    EXPECT_TRUE(plain.vertices.medium.empty() && plain.light_edges.medium.empty() && plain.vertices.primitive.empty());
    ASSERT_EQ(graph.vertices.medium.size(), graph.n_vertices());
    ASSERT_EQ(graph.light_edges.medium.size(), graph.n_light_edges());
    ASSERT_EQ(graph.n_vertices(), plain.n_vertices());
    const auto& v = graph.vertices;
    int in[3] = {0, 0, 0};  // outside, box, ball
    for (std::size_t i = 0; i < graph.n_paths(); ++i)
        for (std::size_t j = graph.paths.first_vertex[i]; j < graph.paths.first_vertex[i + 1]; ++j) {
            ASSERT_EQ(v.p[3 * j], plain.vertices.p[3 * j]);
            const std::uint16_t medium = v.medium[j];
            const Material* material = medium == Medium::outside ? nullptr : &scene->materials[medium];
            EXPECT_EQ(v.eta[j], material ? material->model.int_ior : 1.0f);
            ++in[!material ? 0 : material->id == "box" ? 1 : 2];
            // The middle of the segment that arrives lies in the medium.
            const bool first = j == graph.paths.first_vertex[i];
            Point3f m(scene->sensor.origin);
            if (!first) m = {v.p[3 * j - 3], v.p[3 * j - 2], v.p[3 * j - 1]};
            for (int c = 0; c < 3; ++c) m[c] = 0.5f * (m[c] + v.p[3 * j + std::size_t(c)]);
            const bool in_ball = length(m - Point3f{}) < 0.7f;
            const bool in_box = std::max({std::abs(m.x), std::abs(m.y), std::abs(m.z)}) < 1;
            EXPECT_EQ(material != nullptr, in_box) << m.x << " " << m.y << " " << m.z;
            if (material && in_box) {
                EXPECT_EQ(material->id, in_ball ? "ball" : "box");
            }
            // The vertex lies in its triangle.
            const Shape& shape = scene->shapes[v.shape[j]];
            if (shape.kind != ShapeKind::mesh) continue;
            const TriangleRecord& t = shape.triangles[v.primitive[j]];
            const Vector3<double> e1(t.e1), e2(t.e2), n = cross(e1, e2);
            const Vector3<double> d(Point3f{v.p[3 * j], v.p[3 * j + 1], v.p[3 * j + 2]} - t.p0);
            const double b1 = dot(cross(d, e2), n) / length2(n), b2 = dot(cross(e1, d), n) / length2(n);
            EXPECT_LT(std::abs(dot(d, n)) / length(n), 1e-5);
            EXPECT_TRUE(b1 > -1e-5 && b2 > -1e-5 && b1 + b2 < 1 + 1e-5) << b1 << " " << b2;
        }
    for (const int n : in) EXPECT_GT(n, 100);
    for (std::size_t k = 0; k < graph.n_light_edges(); ++k) {
        const std::uint16_t medium = graph.light_edges.medium[k];
        EXPECT_EQ(graph.light_edges.eta[k], medium == Medium::outside ? 1.0f : scene->materials[medium].model.int_ior);
    }
}

}  // namespace
}  // namespace loom::test
