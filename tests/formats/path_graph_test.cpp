#include "formats/path_graph.h"

#include <gtest/gtest.h>
#include <hdf5.h>

#include <array>
#include <cstring>
#include <fstream>
#include <sstream>

#include "formats/io/hdf5_handle.h"
#include "tests/formats/field_bytes.h"
#include "tests/formats/tiny_graph.h"

namespace loom {
namespace {

using testing::expect_equal;
using testing::file_bytes;
using testing::large_graph;
using testing::ScratchFolder;
using testing::tiny_graph;
using testing::tiny_graph_with_misses;
using testing::tiny_graph_with_own_lobes;

// Would catch a column that is written but not read, read into another, or changed on the way.
TEST(PathGraph, ReadsBackBitForBit) {
    const ScratchFolder folder;
    const PathGraph graph = tiny_graph();
    write_path_graph(graph, folder / "g.h5");
    expect_equal(graph, read_path_graph(folder / "g.h5"));
    EXPECT_EQ(folder.n_partial(), 0);
}

TEST(PathGraph, MissesReadBackBitForBit) {
    const ScratchFolder folder;
    const PathGraph graph = tiny_graph_with_misses();
    write_path_graph(graph, folder / "g.h5");
    const PathGraph read = read_path_graph(folder / "g.h5");
    expect_equal(graph, read);
    EXPECT_EQ(read.n_misses(), 3u);
}

/// Version in the file of a graph that was written and read back.
std::array<std::int32_t, 2> version_after_writing(const PathGraph& graph) {
    const ScratchFolder folder;
    write_path_graph(graph, folder / "g.h5");
    expect_equal(graph, read_path_graph(folder / "g.h5"));
    const Hdf5Handle file(H5Fopen((folder / "g.h5").c_str(), H5F_ACC_RDONLY, H5P_DEFAULT), H5Fclose);
    const Hdf5Handle attribute(H5Aopen(file.get(), "version", H5P_DEFAULT), H5Aclose);
    std::array<std::int32_t, 2> version{};
    H5Aread(attribute.get(), H5T_NATIVE_INT32, version.data());
    return version;
}

// A reader of 1.2 would take the material's exponent, index and coat for all its vertices: it must refuse such a graph
// by its version, and go on reading all others.
TEST(PathGraph, OnlyGraphsThatOlderReadersWouldMisreadAreOfVersion2) {
    EXPECT_EQ(version_after_writing(tiny_graph()), (std::array{1, 2}));
    EXPECT_EQ(version_after_writing(tiny_graph_with_own_lobes()), (std::array{2, 0}));
    PathGraph coats = tiny_graph();
    coats.coats = tiny_graph_with_own_lobes().coats;
    EXPECT_EQ(version_after_writing(coats), (std::array{2, 0}));
    for (const std::uint8_t bit : {textured_parameter::exponent, textured_parameter::index}) {
        PathGraph one = tiny_graph_with_own_lobes();
        one.coats = {};
        one.materials.textured = std::vector<std::uint8_t>{bit, 0};
        EXPECT_EQ(version_after_writing(one), (std::array{2, 0}));
    }
}

// Columns that readers of 1.2 and 2.0 do not know, and may leave aside.
TEST(PathGraph, NewColumnsRaiseTheMinorVersion) {
    for (const bool own_lobes : {false, true}) {
        PathGraph graph = own_lobes ? tiny_graph_with_own_lobes() : tiny_graph();
        const std::array without{own_lobes ? 2 : 1, own_lobes ? 0 : 2}, with{without[0], without[1] + 1};
        EXPECT_EQ(version_after_writing(graph), without);
        graph.vertices.primitive = {0, 1, 2, 3, 4, 5};
        EXPECT_EQ(version_after_writing(graph), with);
        graph.vertices.primitive = {};
        graph.vertices.medium = {65535, 0, 1, 0, 65535, 65535};
        graph.light_edges.medium = {65535, 1, 0, 65535};
        EXPECT_EQ(version_after_writing(graph), with);
        graph.vertices.medium = {65535, 0, 2, 0, 65535, 65535};
        EXPECT_EQ(graph.problem(), "vertices/medium: row 2 is 2, but there are 2 materials (65535: outside)");
        graph.vertices.medium = {};
        EXPECT_EQ(graph.problem(), "vertices/medium, light_edges/medium: one of them is missing");
    }
}

TEST(PathGraph, CoatsAndParametersOfVerticesMustBeWhole) {
    PathGraph g = tiny_graph_with_own_lobes();
    EXPECT_EQ(g.problem(), "");
    g.coats.alpha = std::vector{0.5f, 0.1f};
    EXPECT_EQ(g.problem(), "coats/material: row 1 is not in order (by material, then alpha)");
    g.coats.alpha = std::vector{0.1f, 0.5f};
    g.coats.material = std::vector<std::uint16_t>{1, 2};
    EXPECT_EQ(g.problem(), "coats/material: row 1 is 2, but there are 2 materials");
    g = tiny_graph_with_own_lobes();
    g.coats.fdr_int = std::vector<float>{};
    EXPECT_EQ(g.problem(), "coats: some of its columns are there, some are not");
    g = tiny_graph_with_own_lobes();
    g.vertices.exponent = std::vector<float>{};
    EXPECT_EQ(g.problem(), "materials/textured: row 0 leaves a parameter to vertices/exponent, which is not there");
    g = tiny_graph_with_own_lobes();
    g.vertices.k_c = std::vector<Half>{};
    EXPECT_EQ(g.problem(),
              "materials/textured: row 0 leaves a parameter to vertices/eta_c or vertices/k_c, which is not there");
}

TEST(PathGraph, AbsentColumnsStayAbsent) {
    const ScratchFolder folder;
    const PathGraph graph = large_graph(1);
    write_path_graph(graph, folder / "g.h5");
    const PathGraph read = read_path_graph(folder / "g.h5");
    expect_equal(graph, read);
    EXPECT_TRUE(read.vertices.q.empty());
    EXPECT_TRUE(read.light_edges.n.empty());
}

// Would catch object times, uninitialised bytes and anything else that is not the data.
TEST(PathGraph, EqualGraphsGiveEqualBytes) {
    const ScratchFolder folder;
    write_path_graph(tiny_graph(), folder / "a.h5");
    write_path_graph(large_graph(50000), folder / "large_a.h5");
    std::filesystem::create_directory(folder / "other");
    ::sleep(1);  // object times have a resolution of a second
    write_path_graph(tiny_graph(), folder / "other/b.h5");
    write_path_graph(large_graph(50000), folder / "large_b.h5");
    EXPECT_EQ(file_bytes(folder / "a.h5"), file_bytes(folder / "other/b.h5"));
    EXPECT_EQ(file_bytes(folder / "large_a.h5"), file_bytes(folder / "large_b.h5"));
}

TEST(PathGraph, RewritingWhatWasReadGivesEqualBytes) {
    const ScratchFolder folder;
    write_path_graph(tiny_graph(), folder / "a.h5");
    write_path_graph(read_path_graph(folder / "a.h5"), folder / "b.h5");
    EXPECT_EQ(file_bytes(folder / "a.h5"), file_bytes(folder / "b.h5"));
}

/// The columns of one graph, in the order of their declaration.
struct ColumnSpans : FieldVisitor<ColumnSpans> {
    std::vector<std::span<const std::byte>> found;
    template <class T>
    void column_of(const Field&, const Column<T>& column) {
        found.push_back(std::as_bytes(column.values()));
    }
};

/// Cuts them into four pieces of uneven length, the third of them empty.
struct ColumnCutter : FieldVisitor<ColumnCutter> {
    const std::vector<std::span<const std::byte>>& found;
    std::size_t k = 0;
    explicit ColumnCutter(const std::vector<std::span<const std::byte>>& from) : found(from) {}
    template <class T>
    void column_of(const Field&, PiecedColumn<T>& column) {
        auto* data = const_cast<T*>(reinterpret_cast<const T*>(found[k].data()));  // which the writer only reads
        const std::span<T> all(data, found[k++].size() / sizeof(T));
        const std::size_t a = all.size() / 3, b = all.size() - all.size() / 7;
        column.add(all.first(a));
        column.add(all.subspan(a, b - a));
        column.add({});
        column.add(all.subspan(b));
    }
};

// Would catch a piece at a wrong offset, one that is lost, and a file that shows how its columns lay in memory.
TEST(PathGraph, PiecesGiveTheBytesOfTheWhole) {
    const ScratchFolder folder;
    std::array graphs{tiny_graph(), large_graph(50'000)};
    for (PathGraph& graph : graphs) {
        write_path_graph(graph, folder / "whole.h5");
        ColumnSpans columns;
        PathGraph::row_fields(graph, columns);
        PathGraphInPieces pieces;
        ColumnCutter cutter(columns.found);
        PathGraphInPieces::row_fields(pieces, cutter);
        static_cast<PathGraphHeader&>(pieces) = std::move(static_cast<PathGraphHeader&>(graph));
        write_path_graph(pieces, folder / "pieces.h5");
        EXPECT_EQ(file_bytes(folder / "pieces.h5"), file_bytes(folder / "whole.h5"));
    }
}

// Large columns are borrowed from pages of the file: no copy, whole pages.
TEST(PathGraph, LargeColumnsAreMapped) {
    const ScratchFolder folder;
    const PathGraph graph = large_graph(100000);
    write_path_graph(graph, folder / "g.h5");
    const PathGraph read = read_path_graph(folder / "g.h5");
    const auto bytes = read.storage->bytes();
    const auto offset_of = [&](const void* data) { return static_cast<const std::byte*>(data) - bytes.data(); };
    for (const void* data :
         {static_cast<const void*>(read.vertices.p.data()), static_cast<const void*>(read.vertices.diffuse.data()),
          static_cast<const void*>(read.vertices.flags.data())}) {
        ASSERT_GE(offset_of(data), 0);
        ASSERT_LT(offset_of(data), static_cast<std::ptrdiff_t>(bytes.size()));
        EXPECT_EQ(offset_of(data) % 4096, 0);
    }
    expect_equal(graph, read);
}

TEST(PathGraph, ColumnsOutliveTheirGraphWhenMoved) {
    PathGraph a = large_graph(1000);
    const float* data = a.vertices.p.data();
    const PathGraph b = std::move(a);
    EXPECT_EQ(b.vertices.p.data(), data);
    EXPECT_EQ(b.vertices.p.size(), 3000u);
    EXPECT_TRUE(a.vertices.p.empty());  // NOLINT(bugprone-use-after-move): what is left of it is the question
}

TEST(PathGraph, EmptyGraphIsLegal) {
    const ScratchFolder folder;
    PathGraph graph;
    graph.paths.first_vertex = {0};
    write_path_graph(graph, folder / "g.h5");
    const PathGraph read = read_path_graph(folder / "g.h5");
    EXPECT_EQ(read.n_paths(), 0u);
    EXPECT_EQ(read.n_vertices(), 0u);
}

// The budget of the format: about 100 bytes for a vertex of a textured scene with everything on.
TEST(PathGraph, ColumnBytesAreWhatTheFormatSays) {
    std::size_t vertex_bytes = 0, edge_bytes = 0;
    const PathGraph graph = tiny_graph();
    for (const auto& column : column_bytes(graph)) {
        if (column.axis == "vertex") vertex_bytes += column.bytes / column.rows;
        if (column.axis == "edge") edge_bytes += column.bytes / column.rows;
    }
    EXPECT_EQ(vertex_bytes, 85u);
    EXPECT_EQ(edge_bytes, 51u);
}

TEST(PathGraph, WriterRefusesColumnsOfUnequalLength) {
    const ScratchFolder folder;
    PathGraph graph = tiny_graph();
    graph.vertices.shape = {0, 1};
    EXPECT_THROW(write_path_graph(graph, folder / "g.h5"), std::logic_error);
    EXPECT_FALSE(std::filesystem::exists(folder / "g.h5"));
    EXPECT_EQ(folder.n_partial(), 0);
}

// Every older minor version must read; the fixture is the file as that version wrote it.
TEST(PathGraph, FixtureOfVersion_1_0_Reads) {
    expect_equal(tiny_graph(), read_path_graph("tests/fixtures/path_graph_1.0.h5"));
}
TEST(PathGraph, FixtureOfVersion_2_0_Reads) {
    expect_equal(tiny_graph_with_own_lobes(), read_path_graph("tests/fixtures/path_graph_2.0.h5"));
}

}  // namespace
}  // namespace loom
