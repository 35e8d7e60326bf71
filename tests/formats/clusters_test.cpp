#include "formats/clusters.h"

#include <gtest/gtest.h>

#include "formats/path_graph.h"
#include "tests/formats/field_bytes.h"
#include "tests/formats/tiny_clusters.h"
#include "tests/formats/tiny_graph.h"

namespace loom {
namespace {

using testing::expect_equal;
using testing::file_bytes;
using testing::input_error_of;
using testing::ScratchFolder;
using testing::tiny_clusters;

TEST(Clusters, ReadBackBitForBit) {
    const ScratchFolder folder;
    write_clusters(tiny_clusters(), folder / "c.h5");
    expect_equal(tiny_clusters(), read_clusters(folder / "c.h5"));
}

TEST(Clusters, RewritingWhatWasReadGivesEqualBytes) {
    const ScratchFolder folder;
    write_clusters(tiny_clusters(), folder / "a.h5");
    write_clusters(read_clusters(folder / "a.h5"), folder / "b.h5");
    EXPECT_TRUE(file_bytes(folder / "a.h5") == file_bytes(folder / "b.h5"));
}

// A graph of mirrors: nothing shares.
TEST(Clusters, NoClusterIsLegal) {
    const ScratchFolder folder;
    Clusters none;
    none.first = {0};
    write_clusters(none, folder / "c.h5");
    EXPECT_EQ(read_clusters(folder / "c.h5").n_clusters(), 0u);
}

TEST(Clusters, FixtureOfVersion_1_0_Reads) {
    expect_equal(tiny_clusters(), read_clusters("tests/fixtures/clusters_1.0.h5"));
}

TEST(Clusters, BrokenOnesAreRefusedByDataset) {
    const ScratchFolder folder;
    const std::string file = folder / "c.h5";
    const auto complaint = [&](const std::function<void(Clusters&)>& change) {
        Clusters c = tiny_clusters();
        change(c);
        write_clusters(c, file);
        const std::string text = input_error_of([&] { read_clusters(file); }), head = file + ": ";
        return text.starts_with(head) ? text.substr(head.size()) : "does not name the file: " + text;
    };
    EXPECT_EQ(complaint([](Clusters& c) { c.first = {1, 2, 3, 5}; }), "clusters/first: starts at 1, not at 0");
    EXPECT_EQ(complaint([](Clusters& c) {
                  c.first = {0, 1, 3, 4};
              }),
              "clusters/first: ends at 4, but there are 5 members");
    EXPECT_EQ(complaint([](Clusters& c) {
                  c.first = {0, 3, 1, 5};
              }),
              "clusters/first: does not grow from 3 to 1 at row 2");
    EXPECT_EQ(complaint([](Clusters& c) {
                  c.first = {0, 3, 3, 5};
              }),
              "clusters/first: does not grow from 3 to 3 at row 2");
    EXPECT_EQ(complaint([](Clusters& c) {
                  c.first = {0, 5};
              }),
              "clusters/first: row 0 has 5 members, but settings/max_size is 4");
    EXPECT_EQ(complaint([](Clusters& c) {
                  c.member = {5, 0, 2, 6, 1};
              }),
              "clusters/member: row 3 is 6, but there are 6 vertices");
    EXPECT_EQ(complaint([](Clusters& c) { c.member = {5, 0, 2, 3, 0}; }), "clusters/member: row 4 repeats vertex 0");
    EXPECT_EQ(complaint([](Clusters& c) { c.graph_vertices = 4; }),
              "clusters/member: has 5 rows, but there are 4 vertices");
    EXPECT_EQ(complaint([](Clusters& c) { c.settings.method = "grid"; }),
              "settings/method: is grid, expected balanced or centres");
    EXPECT_EQ(complaint([](Clusters& c) { c.settings.k = 0; }), "settings/k: is 0");
    EXPECT_EQ(complaint([](Clusters& c) { c.settings.normal_weight = -1; }), "settings/normal_weight: is negative");
    EXPECT_EQ(complaint([](Clusters& c) { c.settings.length_scale = 0; }), "settings/length_scale: is not positive");
}

TEST(Clusters, AGraphIsNoClusters) {
    const ScratchFolder folder;
    write_path_graph(testing::tiny_graph(), folder / "g.h5");
    EXPECT_NE(input_error_of([&] { read_clusters(folder / "g.h5"); }).find("is a path_graph, expected a clusters"),
              std::string::npos);
}

TEST(Clusters, TruncatedAnywhere) {
    const ScratchFolder folder;
    write_clusters(tiny_clusters(), folder / "c.h5");
    const std::string whole = file_bytes(folder / "c.h5");
    for (std::size_t n = 0; n < whole.size(); n += n < 4096 ? 13 : 97) {
        testing::write_bytes(folder / "c.h5", std::string_view(whole).substr(0, n));
        EXPECT_NE(input_error_of([&] { read_clusters(folder / "c.h5"); }), "nothing was thrown") << n;
    }
}

// Rows of another graph would be read as if they were this one's.
TEST(Clusters, OfAnotherGraphAreRefused) {
    const PathGraph graph = testing::tiny_graph();
    const Clusters clusters = tiny_clusters();
    const auto complaint = [&](const PathGraph& g, const InputId& id) {
        return input_error_of([&] { require_clusters_of(g, id, clusters, "c.h5"); });
    };
    EXPECT_EQ(complaint(graph, {"g.h5", "fedcba9876543210"}), "nothing was thrown");
    EXPECT_EQ(complaint(graph, {"g.h5", "0000000000000001"}),
              "c.h5: made from tiny graph.h5 (content fedcba9876543210), not from g.h5 (content "
              "0000000000000001); run: loom-cluster g.h5 -o c.h5");
    EXPECT_NE(complaint(testing::large_graph(5), {"g.h5", "fedcba9876543210"}), "nothing was thrown");
}

}  // namespace
}  // namespace loom
