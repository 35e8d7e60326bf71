#include "formats/radiance.h"

#include <gtest/gtest.h>

#include <limits>

#include "formats/path_graph.h"
#include "tests/formats/field_bytes.h"
#include "tests/formats/tiny_clusters.h"
#include "tests/formats/tiny_graph.h"
#include "tests/formats/tiny_radiance.h"

namespace loom {
namespace {

using testing::expect_equal;
using testing::file_bytes;
using testing::input_error_of;
using testing::ScratchFolder;
using testing::tiny_radiance;

TEST(Radiance, ReadsBackBitForBit) {
    const ScratchFolder folder;
    write_radiance(tiny_radiance(), folder / "r.h5");
    expect_equal(tiny_radiance(), read_radiance(folder / "r.h5"));
}

TEST(Radiance, RewritingWhatWasReadGivesEqualBytes) {
    const ScratchFolder folder;
    write_radiance(tiny_radiance(), folder / "a.h5");
    write_radiance(read_radiance(folder / "a.h5"), folder / "b.h5");
    EXPECT_TRUE(file_bytes(folder / "a.h5") == file_bytes(folder / "b.h5"));
}

// A graph of a camera that looks into the void, refined in no steps.
TEST(Radiance, NoVertexAndNoIterationAreLegal) {
    const ScratchFolder folder;
    Radiance none;
    write_radiance(none, folder / "r.h5");
    const Radiance back = read_radiance(folder / "r.h5");
    EXPECT_EQ(back.L.size(), 0u);
    EXPECT_EQ(back.residual.size(), 0u);
    EXPECT_TRUE(back.direct.empty());
}

// NaN and infinity occur as residuals of an iteration from zero and as radiance of a broken scene; they are kept, never
// dropped.
TEST(Radiance, NanAndInfinitySurvive) {
    const ScratchFolder folder;
    Radiance r = tiny_radiance();
    std::vector<float> L(r.L.begin(), r.L.end());
    L[4] = std::numeric_limits<float>::infinity();
    L[5] = std::numeric_limits<float>::quiet_NaN();
    r.L = L;
    testing::write_nonfinite(folder / "r.h5", [&] { write_radiance(r, folder / "r.h5"); });
    expect_equal(r, read_radiance(folder / "r.h5"));
}

TEST(Radiance, FixtureOfVersion_1_0_Reads) {
    expect_equal(tiny_radiance(), read_radiance("tests/fixtures/radiance_1.0.h5"));
}

TEST(Radiance, BrokenOnesAreRefusedByDataset) {
    const ScratchFolder folder;
    const std::string file = folder / "r.h5";
    const auto complaint = [&](const std::function<void(Radiance&)>& change) {
        Radiance r = tiny_radiance();
        change(r);
        write_radiance(r, file);
        const std::string text = input_error_of([&] { read_radiance(file); }), head = file + ": ";
        return text.starts_with(head) ? text.substr(head.size()) : "does not name the file: " + text;
    };
    EXPECT_EQ(complaint([](Radiance& r) { r.settings.method = "magic"; }),
              "settings/method: is magic, expected fixed-point or west");
    EXPECT_EQ(complaint([](Radiance& r) { r.settings.clamp = "hard"; }),
              "settings/clamp: is hard, expected none, column or cluster");
    EXPECT_EQ(complaint([](Radiance& r) { r.graph_vertices = 5; }),
              "vertices/L: has 6 rows, but the graph has 5 vertices");
    EXPECT_EQ(complaint([](Radiance& r) { r.settings.reuse = "light"; }),
              "settings/reuse: is light, expected directions or points");
    EXPECT_EQ(complaint([](Radiance& r) { r.settings.start = "noon"; }),
              "settings/start: is noon, expected paths or zero");
}

TEST(Radiance, AGraphOrClustersAreNoRadiance) {
    const ScratchFolder folder;
    write_path_graph(testing::tiny_graph(), folder / "g.h5");
    write_clusters(testing::tiny_clusters(), folder / "c.h5");
    EXPECT_NE(input_error_of([&] { read_radiance(folder / "g.h5"); }).find("is a path_graph, expected a radiance"),
              std::string::npos);
    EXPECT_NE(input_error_of([&] { read_radiance(folder / "c.h5"); }).find("is a clusters, expected a radiance"),
              std::string::npos);
}

TEST(Radiance, TruncatedAnywhere) {
    const ScratchFolder folder;
    write_radiance(tiny_radiance(), folder / "r.h5");
    const std::string whole = file_bytes(folder / "r.h5");
    for (std::size_t n = 0; n < whole.size(); n += n < 4096 ? 13 : 97) {
        testing::write_bytes(folder / "r.h5", std::string_view(whole).substr(0, n));
        EXPECT_NE(input_error_of([&] { read_radiance(folder / "r.h5"); }), "nothing was thrown") << n;
    }
}

// Rows of another graph would be read as if they were this one's, and rows that are not there as well.
TEST(Radiance, OfAnotherGraphIsRefused) {
    const PathGraph graph = testing::tiny_graph();
    const Radiance radiance = tiny_radiance();
    const auto complaint = [&](const PathGraph& g, const Radiance& r, const InputId& id) {
        return input_error_of([&] { require_radiance_of(g, id, r, "r.h5"); });
    };
    EXPECT_EQ(complaint(graph, radiance, {"g.h5", "fedcba9876543210"}), "nothing was thrown");
    EXPECT_EQ(complaint(graph, radiance, {"g.h5", "0000000000000001"}),
              "r.h5: made from tiny graph.h5 (content fedcba9876543210), not from g.h5 (content "
              "0000000000000001); run: loom-refine g.h5 CLUSTERS -o r.h5");
    EXPECT_NE(complaint(testing::large_graph(5), radiance, {"g.h5", "fedcba9876543210"}), "nothing was thrown");
    Radiance fewer_paths = tiny_radiance();
    fewer_paths.direct = std::vector<float>(9, 0.5f);
    EXPECT_EQ(complaint(graph, fewer_paths, {"g.h5", "fedcba9876543210"}),
              "r.h5: paths/direct has 3 rows, but the graph has 4 paths");
    Radiance silent = tiny_radiance();
    silent.direct = Column<float>();
    EXPECT_EQ(complaint(graph, silent, {"g.h5", "fedcba9876543210"}),
              "r.h5: paths/direct has 0 rows, but the graph has 4 paths");
}

}  // namespace
}  // namespace loom
