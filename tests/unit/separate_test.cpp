// Separation of cluster members: of different media, and occluded from each other.
#include <gtest/gtest.h>

#include "stages/cluster/cluster.h"
#include "tests/traced_graph.h"

namespace loom {
namespace {

using testing::load_inline;
using testing::path_options;
using testing::trace_graph;

const std::string grey = R"(<bsdf type="twosided"><bsdf type="diffuse"/></bsdf>)";
const std::string above =
    R"(type="orthographic"><transform name="to_world"><lookat origin="0, 0, 5" target="0, 0, 0" up="0, 1, 0"/></transform>)";
const std::string sky = R"(<emitter type="constant"/>)";
const std::string floor = R"(<shape type="rectangle">)" + grey + "</shape>";

/// Clusters that hold two members for which differ(a, b).
template <class Differ>
std::size_t mixed(const Clusters& clusters, Differ differ) {
    std::size_t n = 0;
    for (std::size_t c = 0; c < clusters.n_clusters(); ++c)
        for (std::uint32_t i = clusters.first[c] + 1; i < clusters.first[c + 1]; ++i)
            if (differ(clusters.member[clusters.first[c]], clusters.member[i])) {
                ++n;
                break;
            }
    return n;
}

Clusters clusters_of(const PathGraph& graph, const Scene* scene, int threads = 0) {
    cluster::ClusterOptions options;
    options.k = 32;
    options.scene = scene;
    options.threads = threads;
    return cluster::make_clusters(graph, options);
}

// A wall of 1 mm on a floor: the floor left of it and right of it is one plane of one normal.
TEST(Separation, WallsOnAFloor) {
    const auto scene = load_inline(
        {above,
         floor +
             R"(<shape type="cube"><transform name="to_world"><scale x="0.0005" z="0.5"/><translate z="0.5"/></transform>)" +
             grey + "</shape>" + sky,
         32, 32, 3});
    const PathGraph graph = trace_graph(*scene, path_options(*scene, 1), 2);
    const auto across = [&](std::uint32_t a, std::uint32_t b) {
        return graph.vertices.p[3 * a] * graph.vertices.p[3 * b] < 0 &&
               std::min(graph.vertices.p[3 * a + 2], graph.vertices.p[3 * b + 2]) < 0.4f;
    };
    EXPECT_GE(mixed(clusters_of(graph, nullptr), across), 5u);
    const Clusters apart = clusters_of(graph, scene.get());
    EXPECT_EQ(mixed(apart, across), 0u);
    EXPECT_GE(apart.separation.occluded[0], 5u);
    EXPECT_EQ(apart.problem(), "");
    EXPECT_EQ(apart.n_members(), clusters_of(graph, nullptr).n_members());
    for (const int threads : {1, 2}) {
        const Clusters again = clusters_of(graph, scene.get(), threads);
        EXPECT_TRUE(std::equal(apart.member.begin(), apart.member.end(), again.member.begin(), again.member.end()));
        EXPECT_TRUE(std::equal(apart.first.begin(), apart.first.end(), again.first.begin(), again.first.end()));
    }
}

// Two sheets, one above the other, closer than clusters are wide.
TEST(Separation, SheetsAboveOneAnother) {
    const auto scene = load_inline(
        {R"(type="perspective"><transform name="to_world"><lookat origin="0, -4, 1" target="0, 0, 0" up="0, 0, 1"/></transform>)",
         floor + R"(<shape type="rectangle"><transform name="to_world"><translate z="0.02"/></transform>)" + grey +
             "</shape>" + sky,
         32, 32, 4});
    const PathGraph graph = trace_graph(*scene, path_options(*scene, 2), 8);
    const auto across = [&](std::uint32_t a, std::uint32_t b) {
        return std::abs(graph.vertices.p[3 * a + 2] - graph.vertices.p[3 * b + 2]) > 0.01f;
    };
    const Clusters apart = clusters_of(graph, scene.get());
    EXPECT_EQ(mixed(apart, across), 0u);
}

// Smooth surfaces from outside stay together: a plane completely, a ball nearly.
TEST(Separation, PlanesAndBallsStayWhole) {
    const auto plane = load_inline({above, floor + sky, 32, 32, 3});
    const PathGraph on_plane = trace_graph(*plane, path_options(*plane, 3), 2);
    EXPECT_EQ(clusters_of(on_plane, plane.get()).n_clusters(), clusters_of(on_plane, nullptr).n_clusters());
    EXPECT_EQ(clusters_of(on_plane, plane.get()).separation.occluded[0], 0u);

    const auto ball = load_inline({above, R"(<shape type="sphere">)" + grey + "</shape>" + sky, 32, 32, 3});
    const PathGraph on_ball = trace_graph(*ball, path_options(*ball, 4), 2);
    EXPECT_LT(clusters_of(on_ball, ball.get()).separation.occluded[0], on_ball.n_vertices() / 100);
}

// The faces of a pane, from one side: one is visible through air, the other through glass. No scene is needed for that.
// Detected mutations: media not compared; only the medium across.
TEST(Separation, MediaOfAPane) {
    const auto scene = load_inline({above,
                                    R"(<shape type="cube"><transform name="to_world"><scale z="0.002"/></transform>
<bsdf type="roughdielectric"><float name="alpha" value="0.2"/></bsdf></shape>)" +
                                        sky,
                                    32, 32, 6});
    const PathGraph graph = trace_graph(*scene, path_options(*scene, 5), 4);
    ASSERT_FALSE(graph.vertices.eta.empty());
    const Clusters clusters = clusters_of(graph, nullptr);
    EXPECT_EQ(mixed(clusters,
                    [&](std::uint32_t a, std::uint32_t b) { return graph.vertices.eta[a] != graph.vertices.eta[b]; }),
              0u);
    EXPECT_GT(clusters.separation.other_media[0], 100u);
    EXPECT_TRUE(clusters.separation.occluded.empty());  // not tested
}

// Light that a thin pane traps comes back to one place many times. No scene is needed to see it.
TEST(Separation, PathsThatComeBack) {
    const auto scene = load_inline({above,
                                    R"(<shape type="cube"><transform name="to_world"><scale z="0.005"/></transform>
<bsdf type="roughdielectric"><float name="alpha" value="0.2"/></bsdf></shape>)" +
                                        sky,
                                    32, 32, -1});
    const PathGraph graph = trace_graph(*scene, path_options(*scene, 6), 4);
    std::vector<std::uint32_t> path(graph.n_vertices());
    for (std::uint32_t i = 0; i < graph.n_paths(); ++i)
        for (std::uint64_t j = graph.paths.first_vertex[i]; j < graph.paths.first_vertex[i + 1]; ++j) path[j] = i;
    const Clusters clusters = clusters_of(graph, nullptr);
    for (std::size_t c = 0; c < clusters.n_clusters(); ++c)
        for (std::uint32_t i = clusters.first[c] + 1; i < clusters.first[c + 1]; ++i)
            ASSERT_NE(path[clusters.member[i - 1]], path[clusters.member[i]]) << c;
    EXPECT_GT(clusters.separation.same_path[0], 100u);
    EXPECT_EQ(clusters.problem(), "");

    // Two graphs in the same cells: the same graph twice is the same clusters twice, whose paths are not one.
    cluster::ClusterOptions options;
    options.k = 32;
    const auto twice = cluster::make_joint_clusters(graph, graph, options);
    EXPECT_TRUE(std::equal(twice.first.member.begin(), twice.first.member.end(), twice.second.member.begin(),
                           twice.second.member.end()));
    EXPECT_GT(twice.first.n_members(), 4 * twice.first.n_clusters());
}

TEST(Separation, AnotherSceneIsRefused) {
    const auto scene = load_inline({above, floor + sky, 8, 8, 3}),
               other = load_inline({above, floor + floor + sky, 8, 8, 3});
    const PathGraph graph = trace_graph(*scene, path_options(*scene, 1), 1);
    EXPECT_THROW(require_scene_of(graph, "g.h5", *other, "other.xml"), std::exception);
}

}  // namespace
}  // namespace loom
