#include "stages/inspect/inspect.h"

#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "formats/clusters.h"
#include "formats/io/cost.h"
#include "formats/io/json.h"
#include "tests/formats/tiny_clusters.h"
#include "tests/formats/tiny_graph.h"
#include "tests/formats/tiny_image.h"

namespace loom {
namespace {

using testing::input_error_of;
using testing::ScratchFolder;
using testing::tiny_graph;

bool holds(const std::string& text, std::string_view part) {
    return text.find(part) != std::string::npos;
}

TEST(Inspect, TableOfAGraph) {
    const ScratchFolder folder;
    const std::string file = folder / "g.h5";
    write_path_graph(tiny_graph(), file);
    Cost cost;
    cost.stage = "loom-test";
    cost.wall_s = 1.5, cost.cpu_s = 3;
    cost.rays = 100, cost.samples = 4;
    cost.peak_memory_bytes = 1 << 20, cost.bytes_written = 1;
    write_cost(cost, file);
    const std::string text = inspect::text_of(survey_file(file), file);
    EXPECT_TRUE(holds(text, "path_graph 1.2")) << text;
    EXPECT_TRUE(holds(text, "4 paths, 6 vertices (1.5 per path), 4 light edges (0.667 per vertex)")) << text;
    EXPECT_TRUE(holds(text, "endings: 1 escaped, 1 roulette, 0 invalid sample, 1 max depth, 0 hit emitter")) << text;
    EXPECT_TRUE(holds(text, "0123456789abcdef tiny scene.xml")) << text;
    EXPECT_TRUE(holds(text, "textures on; roulette on; no dielectrics")) << text;
    EXPECT_TRUE(holds(text, "100 rays")) << text;
    EXPECT_TRUE(holds(text, "vertices/alpha")) << text;
}

TEST(Inspect, JsonOfAGraphParses) {
    const ScratchFolder folder;
    const std::string file = folder / "g.h5";
    write_path_graph(tiny_graph(), file);
    const nlohmann::json json = parse_json(inspect::json_of(survey_file(file), file), "json");
    EXPECT_EQ(json.at("path_graph").at("n_vertices"), 6);
    EXPECT_EQ(json.at("path_graph").at("bytes_per_vertex").at("vertices/p"), 12);
    EXPECT_GT(json.at("datasets").size(), 60u);
}

// Clusters of one, two and two vertices. Vertices are 0.1 m apart along x: {0, 2} and {3, 1} have a radius of 0.1 m,
// and so a mean distance of 4/5 of that.
TEST(Inspect, ClustersHaveSizesAndWithTheirGraphRadii) {
    const ScratchFolder folder;
    const std::string graph = folder / "g.h5", file = folder / "c.h5";
    write_path_graph(tiny_graph(), graph);
    Clusters clusters = testing::tiny_clusters();
    clusters.graph = identify(graph).hash;
    write_clusters(clusters, file);
    const std::string text = inspect::text_of(survey_file(file), file);
    EXPECT_TRUE(holds(text, "3 clusters of 5 vertices; size: mean 1.67, weighted by size 1.80, min 1, median 2"))
        << text;
    const std::string more = inspect::text_of(survey_file(file), file, graph);
    EXPECT_TRUE(holds(more, "distance to the centroid: mean 0.08 m, median radius 0.1 m")) << more;
    EXPECT_TRUE(holds(more, "26 degrees off: 0.00 %, opposed: 0.00 % (of 5 members)")) << more;
    const nlohmann::json json = parse_json(inspect::json_of(survey_file(file), file, graph), "json");
    EXPECT_EQ(json.at("clusters").at("size_max"), 2);
    write_path_graph(testing::large_graph(6), graph);
    EXPECT_TRUE(
        holds(input_error_of([&] { inspect::text_of(survey_file(file), file, graph); }), "made from tiny graph.h5"));
}

TEST(Inspect, StatisticsAreOfTheFiniteNumbers) {
    const ScratchFolder folder;
    PathGraph graph = tiny_graph();
    graph.paths.Le = {
        1, 2, 3, 4, 5, 6, 7, 8, std::numeric_limits<float>::quiet_NaN(), 0, 0, std::numeric_limits<float>::infinity()};
    testing::write_nonfinite(folder / "g.h5", [&] { write_path_graph(graph, folder / "g.h5"); });
    for (const auto& dataset : survey_file(folder / "g.h5").datasets) {
        if (dataset.name != "paths/Le") continue;
        EXPECT_EQ(dataset.statistics.n, 12u);
        EXPECT_EQ(dataset.statistics.n_nan, 1u);
        EXPECT_EQ(dataset.statistics.n_inf, 1u);
        EXPECT_EQ(dataset.statistics.min, 0.0);
        EXPECT_EQ(dataset.statistics.mean, 3.6);
        EXPECT_EQ(dataset.statistics.max, 8.0);
    }
}

TEST(Inspect, ImagesAreSurveyedToo) {
    const ScratchFolder folder;
    const std::string file = folder / "x.exr";
    write_image(testing::tiny_image(), file);
    const Survey survey = survey_file(file);
    EXPECT_EQ(survey.attribute("samples"), "16");
    EXPECT_EQ(survey.datasets.size(), 13u);
    EXPECT_TRUE(holds(inspect::text_of(survey, file), "image 1.2"));
    EXPECT_NO_THROW(parse_json(inspect::json_of(survey, file), "json"));
}

TEST(Inspect, PathByPixelAndSample) {
    const PathGraph graph = tiny_graph();
    const std::string text = inspect::path_text(graph, "1:0,9");
    EXPECT_TRUE(text.starts_with("path 3: pixel 1:0 (index 1), sample 9, 3 vertices")) << text;
    EXPECT_EQ(text, inspect::path_text(graph, "1,9"));
    EXPECT_TRUE(holds(text, "next event on lamp at (0, 2, 0) m")) << text;
    EXPECT_TRUE(holds(text, "ending: max depth")) << text;
    EXPECT_TRUE(holds(inspect::path_text(graph, "1,8"), "no vertex"));
}

TEST(Inspect, PathThatIsNotThere) {
    const PathGraph graph = tiny_graph();
    const auto message = [&](const char* which) { return input_error_of([&] { inspect::path_text(graph, which); }); };
    EXPECT_EQ(message("2:0,8"), "--path 2:0,8: the image has 2 x 1 pixels");
    EXPECT_EQ(message("2,8"), "--path 2,8: the image has 2 pixels");
    EXPECT_EQ(message("0,10"), "--path 0,10: the file has samples 8 to 9");
    EXPECT_EQ(message("0,7"), "--path 0,7: the file has samples 8 to 9");
    EXPECT_EQ(message("north"), "--path north: expected PIXEL,SAMPLE, for example 320:180,0 or 115520,0");
    EXPECT_EQ(message("1:x,8"), "--path 1:x,8: expected PIXEL,SAMPLE, for example 320:180,0 or 115520,0");
}

TEST(Inspect, StepsOfTheRefinementAsATable) {
    Radiance radiance;
    radiance.residual = {0.5, 0.0625};
    radiance.image_change = {0.25, 0.03125};
    EXPECT_EQ(inspect::iterations_tsv(radiance),
              "iteration\tresidual\timage_change\n1\t0.5\t0.25\n2\t0.0625\t0.03125\n");
}

// Three paths have vertices: lines of 3, 2 and 4 points with the eye; three light points are finite.
TEST(Inspect, ObjHasPathsAsLines) {
    const std::string text = inspect::obj_text(tiny_graph(), 100);
    EXPECT_TRUE(holds(text, "l 1 2 3\n")) << text;
    EXPECT_TRUE(holds(text, "l 4 5\n")) << text;
    EXPECT_TRUE(holds(text, "l 6 7 8 9\n")) << text;
    std::size_t n_lights = 0;
    for (auto at = text.find("l -2 -1"); at != std::string::npos; at = text.find("l -2 -1", at + 1)) ++n_lights;
    EXPECT_EQ(n_lights, 3u);
}

}  // namespace
}  // namespace loom
