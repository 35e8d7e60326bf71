// Every way in which a path graph can be wrong has its own message, naming the file and the dataset.

#include <gtest/gtest.h>
#include <hdf5.h>

#include <array>

#include "formats/io/hdf5_handle.h"
#include "formats/path_graph.h"
#include "formats/survey.h"
#include "tests/formats/tiny_graph.h"

/// HDF5 itself leaks when it refuses damaged metadata.
extern "C" const char* __lsan_default_suppressions() {
    return "leak:libhdf5";
}

namespace loom {
namespace {

using testing::file_bytes;
using testing::input_error_of;
using testing::ScratchFolder;
using testing::tiny_graph;
using testing::tiny_graph_with_misses;
using testing::write_bytes;

class BadFiles : public ::testing::Test {
  protected:
    void SetUp() override { write_path_graph(tiny_graph(), file()); }
    std::filesystem::path file() const { return folder_ / "g.h5"; }
    std::string message() const {
        return input_error_of([&] { read_path_graph(file()); });
    }
    /// The message without the name of the file, which must be at its beginning.
    std::string complaint() const {
        const std::string text = message(), head = file().native() + ": ";
        return text.starts_with(head) ? text.substr(head.size()) : "does not name the file: " + text;
    }
    /// Runs `body` on the open file.
    void edit(const std::function<void(hid_t)>& body) const {
        const Hdf5Handle open(H5Fopen(file().c_str(), H5F_ACC_RDWR, H5P_DEFAULT), H5Fclose);
        ASSERT_TRUE(open);
        body(open.get());
    }
    /// Replaces a dataset by zeros of another type or shape.
    void replace(const char* name, hid_t type, std::vector<hsize_t> dims) const {
        edit([&](hid_t open) {
            H5Ldelete(open, name, H5P_DEFAULT);
            const Hdf5Handle space(H5Screate_simple(static_cast<int>(dims.size()), dims.data(), nullptr), H5Sclose);
            const Hdf5Handle made(H5Dcreate2(open, name, type, space.get(), H5P_DEFAULT, H5P_DEFAULT, H5P_DEFAULT),
                                  H5Dclose);
            ASSERT_TRUE(made);
        });
    }
    /// Rewrites the file from a graph changed by `body`, by a writer that trusts it.
    void rewrite(const std::function<void(PathGraph&)>& body) const {
        PathGraph graph = tiny_graph();
        body(graph);
        try {
            write_path_graph(graph, file());
        } catch (const NonfiniteError&) {
            std::filesystem::rename(not_finite_name(file()), file());
        }
    }
    ScratchFolder folder_;
};

TEST_F(BadFiles, Missing) {
    std::filesystem::remove(file());
    EXPECT_EQ(complaint(), "no such file");
}

TEST_F(BadFiles, Directory) {
    std::filesystem::remove(file());
    std::filesystem::create_directory(file());
    EXPECT_EQ(complaint(), "is a directory, not a file");
}

TEST_F(BadFiles, Empty) {
    write_bytes(file(), "");
    EXPECT_EQ(complaint(), "the file is empty");
}

TEST_F(BadFiles, NotHdf5) {
    write_bytes(file(), "a text of somebody else");
    EXPECT_EQ(complaint(), "is not an HDF5 file (or is cut off in its first bytes)");
}

TEST_F(BadFiles, ForeignHdf5) {
    edit([](hid_t open) { H5Adelete(open, "filetype"); });
    EXPECT_EQ(complaint(), "is an HDF5 file of another program (no attribute filetype), expected a path_graph");
}

TEST_F(BadFiles, WrongFiletype) {
    edit([](hid_t open) {
        const Hdf5Handle type = text_type(8);
        const Hdf5Handle space(H5Screate(H5S_SCALAR), H5Sclose);
        H5Adelete(open, "filetype");
        const Hdf5Handle made(H5Acreate2(open, "filetype", type.get(), space.get(), H5P_DEFAULT, H5P_DEFAULT),
                              H5Aclose);
        H5Awrite(made.get(), type.get(), "clusters");
    });
    EXPECT_EQ(complaint(), "is a clusters, expected a path_graph");
}

TEST_F(BadFiles, OtherMajorVersion) {
    edit([](hid_t open) {
        const std::int32_t version[] = {3, 0};
        const Hdf5Handle attribute(H5Aopen(open, "version", H5P_DEFAULT), H5Aclose);
        H5Awrite(attribute.get(), H5T_NATIVE_INT32, version);
    });
    EXPECT_EQ(complaint(), "path_graph version 3.0, this build reads 1.x to 2.x");
}

TEST_F(BadFiles, NewerMinorVersionReads) {
    edit([](hid_t open) {
        const std::int32_t version[] = {1, 9};
        const Hdf5Handle attribute(H5Aopen(open, "version", H5P_DEFAULT), H5Aclose);
        H5Awrite(attribute.get(), H5T_NATIVE_INT32, version);
    });
    EXPECT_EQ(message(), "nothing was thrown");
}

TEST_F(BadFiles, MissingDataset) {
    edit([](hid_t open) { H5Ldelete(open, "vertices/p", H5P_DEFAULT); });
    EXPECT_EQ(complaint(), "there is no dataset vertices/p");
}

TEST_F(BadFiles, MissingGroup) {
    edit([](hid_t open) { H5Ldelete(open, "vertices", H5P_DEFAULT); });
    EXPECT_EQ(complaint(), "there is no dataset vertices/p");
}

TEST_F(BadFiles, GroupInPlaceOfDataset) {
    edit([](hid_t open) {
        H5Ldelete(open, "vertices/p", H5P_DEFAULT);
        H5Gclose(H5Gcreate2(open, "vertices/p", H5P_DEFAULT, H5P_DEFAULT, H5P_DEFAULT));
    });
    EXPECT_EQ(complaint(), "vertices/p: not a dataset, or damaged");
}

// HDF5 would convert without a word: a float 1.5 read as an integer is 1.
TEST_F(BadFiles, WrongType) {
    replace("vertices/p", H5T_IEEE_F64LE, {6, 3});
    EXPECT_EQ(complaint(), "vertices/p: type is float64, expected float32");
    replace("vertices/p", H5T_IEEE_F32BE, {6, 3});
    EXPECT_EQ(complaint(), "vertices/p: type is big-endian float32, expected float32");
}

TEST_F(BadFiles, WrongTypeOfValue) {
    replace("sensor/width", H5T_STD_I32LE, {1});
    EXPECT_EQ(complaint(), "sensor/width: type is int32, expected uint32");
}

TEST_F(BadFiles, WrongRank) {
    replace("vertices/p", H5T_IEEE_F32LE, {18});
    EXPECT_EQ(complaint(), "vertices/p: rank is 1, expected 2");
}

TEST_F(BadFiles, WrongWidth) {
    replace("vertices/p", H5T_IEEE_F32LE, {6, 4});
    EXPECT_EQ(complaint(), "vertices/p: width is 4, expected 3");
}

TEST_F(BadFiles, WrongShapeOfValue) {
    replace("sensor/origin", H5T_IEEE_F64LE, {4});
    EXPECT_EQ(complaint(), "sensor/origin: shape is 4, expected 3");
}

TEST_F(BadFiles, WrongLength) {
    replace("vertices/wo", H5T_IEEE_F32LE, {5, 3});
    EXPECT_EQ(complaint(), "vertices/wo: was never written");
    edit([](hid_t open) {
        const Hdf5Handle dataset(H5Dopen2(open, "vertices/wo", H5P_DEFAULT), H5Dclose);
        const std::vector<float> zeros(15);
        H5Dwrite(dataset.get(), H5T_IEEE_F32LE, H5S_ALL, H5S_ALL, H5P_DEFAULT, zeros.data());
    });
    EXPECT_EQ(complaint(), "vertices/wo: has rows for 5 of axis vertex, but vertices/p has 6");
}

TEST_F(BadFiles, AbsurdLength) {
    replace("vertices/wo", H5T_IEEE_F32LE, {hsize_t{1} << 60, 3});
    EXPECT_NE(message(), "nothing was thrown");
}

TEST_F(BadFiles, BrokenOffsets) {
    rewrite([](PathGraph& g) { g.paths.first_vertex = {1, 2, 2, 3, 6}; });
    EXPECT_EQ(complaint(), "paths/first_vertex: starts at 1, not at 0");
    rewrite([](PathGraph& g) { g.paths.first_vertex = {0, 3, 2, 3, 6}; });
    EXPECT_EQ(complaint(), "paths/first_vertex: decreases from 3 to 2 at row 2");
    rewrite([](PathGraph& g) { g.paths.first_vertex = {0, 2, 2, 3, 5}; });
    EXPECT_EQ(complaint(), "paths/first_vertex: ends at 5, but there are 6 vertices");
    rewrite([](PathGraph& g) { g.paths.first_vertex = {0, 2, 2, 3, std::uint64_t{1} << 62}; });
    EXPECT_EQ(complaint(), "paths/first_vertex: ends at 4611686018427387904, but there are 6 vertices");
    rewrite([](PathGraph& g) { g.sensor.width = 3; });
    EXPECT_EQ(complaint(), "paths/first_vertex: has 4 paths, but the sensor has 3 x 1 pixels of 2 samples");
}

TEST_F(BadFiles, IndexOutOfRange) {
    rewrite([](PathGraph& g) { g.vertices.material = {0, 1, 2, 1, 1, 0}; });
    EXPECT_EQ(complaint(), "vertices/material: row 2 is 2, but there are 2 materials");
    rewrite([](PathGraph& g) { g.vertices.shape = {0, 1, 2, 3, 1, 2}; });
    EXPECT_EQ(complaint(), "vertices/shape: row 3 is 3, but there are 3 shapes");
    rewrite([](PathGraph& g) { g.light_edges.vertex = {0, 0, 1, 6}; });
    EXPECT_EQ(complaint(), "light_edges/vertex: row 3 is 6, but there are 6 vertices");
    rewrite([](PathGraph& g) { g.light_edges.emitter = {0, 0, 9, 0}; });
    EXPECT_EQ(complaint(), "light_edges/emitter: row 2 is 9, but there are 2 emitters");
}

// A reader would look the parameter up past the end of an empty column.
TEST_F(BadFiles, TexturedParameterWithoutColumn) {
    rewrite([](PathGraph& g) { g.vertices.diffuse = Column<Half>(); });
    EXPECT_EQ(complaint(), "materials/textured: row 1 leaves a parameter to vertices/diffuse, which is not there");
}

TEST_F(BadFiles, NanWhereForbidden) {
    constexpr float nan = std::numeric_limits<float>::quiet_NaN();
    rewrite([](PathGraph& g) { g.vertices.pdf_w = {0.3f, nan, 0.1f, 0.5f, 0.2f, 0.0f}; });
    EXPECT_EQ(complaint(), "vertices/pdf_w: row 1 is NaN or infinite");
    rewrite([](PathGraph& g) {
        std::vector<Half> alpha(12, half_from_float(0.1f));
        alpha[7] = half_from_float(std::numeric_limits<float>::infinity());
        g.vertices.alpha = alpha;
    });
    EXPECT_EQ(complaint(), "vertices/alpha: row 3 is NaN or infinite");
    rewrite([](PathGraph& g) { g.sensor.origin[1] = nan; });
    EXPECT_EQ(complaint(), "sensor/origin: row 0 is NaN or infinite");
}

// An estimate may be NaN: it is counted, not refused.
TEST_F(BadFiles, NanInRadianceReads) {
    rewrite([](PathGraph& g) {
        std::vector<float> Le(12, 0.0f);
        Le[4] = std::numeric_limits<float>::quiet_NaN();
        g.paths.Le = Le;
    });
    EXPECT_EQ(message(), "nothing was thrown");
}

TEST_F(BadFiles, InvariantsOfVerticesAndEdges) {
    rewrite([](PathGraph& g) {
        std::vector<std::uint16_t> flags(g.vertices.flags.begin(), g.vertices.flags.end());
        flags[0] = flags_with_ending(3, Ending::roulette);
        g.vertices.flags = flags;
    });
    EXPECT_EQ(complaint(), "vertices/flags: row 0 is not continued, but is not the last of path 0");
    rewrite([](PathGraph& g) {
        std::vector<std::uint16_t> flags(g.vertices.flags.begin(), g.vertices.flags.end());
        flags[5] = 3;
        g.vertices.flags = flags;
    });
    EXPECT_EQ(complaint(), "vertices/flags: row 5 is not continued and has ending 0");
    rewrite([](PathGraph& g) { g.vertices.wo = std::vector<float>(18, 1.0f); });
    EXPECT_EQ(complaint(), "vertices/wo: row 0 is not a unit vector");
    rewrite([](PathGraph& g) { g.vertices.q = {1, 1, 2, 1, 1, 1}; });
    EXPECT_EQ(complaint(), "vertices/q: row 2 is 2, not in [0, 1]");
    rewrite([](PathGraph& g) { g.light_edges.vertex = {0, 1, 0, 5}; });
    EXPECT_EQ(complaint(), "light_edges/vertex: row 2 is not in order (by vertex, then technique)");
    rewrite([](PathGraph& g) { g.light_edges.technique = {1, 0, 1, 0}; });
    EXPECT_EQ(complaint(), "light_edges/vertex: row 1 is not in order (by vertex, then technique)");
    rewrite([](PathGraph& g) { g.light_edges.technique = {0, 2, 1, 0}; });
    EXPECT_EQ(complaint(), "light_edges/technique: row 1 is 2, not 0 or 1");
    rewrite([](PathGraph& g) { g.light_edges.pdf_nee_w = {3, 2, -1, 1}; });
    EXPECT_EQ(complaint(), "light_edges/pdf_nee_w or pdf_bsdf_w: row 2 is negative");
}

TEST_F(BadFiles, InvariantsOfMisses) {
    const auto with = [&](auto&& change) {
        rewrite([&](PathGraph& g) {
            g = tiny_graph_with_misses();
            change(g.misses);
        });
        return complaint();
    };
    EXPECT_EQ(with([](auto& m) { m.vertex = {1, 2, 6}; }), "misses/vertex: row 2 is 6, but there are 6 vertices");
    EXPECT_EQ(with([](auto& m) { m.emitter = {0, 2, 0}; }), "misses/emitter: row 1 is 2, but there are 2 emitters");
    EXPECT_EQ(with([](auto& m) { m.emitter = {}; }), "misses: some of its columns are there, some are not");
    EXPECT_EQ(with([](auto& m) {
                  m.vertex = {2, 1, 4};
              }),
              "misses/vertex: row 1 is not in order (by vertex, then technique)");
    EXPECT_EQ(with([](auto& m) {
                  m.vertex = {1, 1, 4};
              }),
              "misses/vertex: row 1 is not in order (by vertex, then technique)");
    EXPECT_EQ(with([](auto& m) { m.technique = {0, 0, 2}; }), "misses/technique: row 2 is 2, not 0 or 1");
    EXPECT_EQ(with([](auto& m) { m.y = {0, 2, 0, 1, 0.2f, 0.2f, -0.3f, 0.5f, 0, 0.6f, 0.8f, 0}; }),
              "misses/y: row 1 has w = 0.5, not 0 or 1");
}

// A check of structure verifies what keeps readers of few rows inside the file, and no more.
TEST_F(BadFiles, StructureIsCheckedAlone) {
    const auto structure = [&] { return input_error_of([&] { read_path_graph(file(), Check::structure); }); };
    rewrite([](PathGraph& g) { g.vertices.wo = std::vector<float>(18, std::numeric_limits<float>::quiet_NaN()); });
    EXPECT_NE(message(), "nothing was thrown");
    EXPECT_EQ(structure(), "nothing was thrown");
    rewrite([](PathGraph& g) { g.light_edges.vertex = {0, 1, 0, 5}; });
    EXPECT_NE(structure(), "nothing was thrown");
    rewrite([](PathGraph& g) { g.vertices.shape = {0, 1, 2, 0, 3, 2}; });
    EXPECT_NE(structure(), "nothing was thrown");
    rewrite([](PathGraph& g) { g.paths.first_vertex = {0, 2, 1, 3, 6}; });
    EXPECT_NE(structure(), "nothing was thrown");
}

// A download that stopped, a disk that was full: whatever the length, an InputError and never a crash.
TEST_F(BadFiles, TruncatedAnywhere) {
    const std::string whole = file_bytes(file());
    for (std::size_t n = 0; n < whole.size(); n += n < 4096 ? 13 : 97) {
        write_bytes(file(), std::string_view(whole).substr(0, n));
        EXPECT_NE(message(), "nothing was thrown") << n << " of " << whole.size() << " bytes";
        EXPECT_NE(input_error_of([&] { survey_file(file()); }), "nothing was thrown") << n;
    }
}

// Metadata carry checksums: a flipped byte there is noticed; one in the data may not be, but must not crash.
TEST_F(BadFiles, DamagedBytesNeverCrash) {
    const std::string whole = file_bytes(file());
    std::size_t n_noticed = 0, n_tried = 0;
    for (std::size_t at = 0; at < whole.size(); at += 101, ++n_tried) {
        std::string damaged = whole;
        damaged[at] = static_cast<char>(damaged[at] ^ 0xa5);
        write_bytes(file(), damaged);
        n_noticed += message() == "nothing was thrown" ? 0 : 1;
    }
    EXPECT_GT(n_noticed, n_tried / 2);
}

TEST_F(BadFiles, PackedDatasetsRead) {
    const PathGraph graph = tiny_graph();
    edit([&](hid_t open) {
        H5Ldelete(open, "vertices/p", H5P_DEFAULT);
        const std::array<hsize_t, 2> dims{6, 3}, chunk{4, 3};
        const Hdf5Handle space(H5Screate_simple(2, dims.data(), nullptr), H5Sclose);
        const Hdf5Handle creation(H5Pcreate(H5P_DATASET_CREATE), H5Pclose);
        H5Pset_chunk(creation.get(), 2, chunk.data());
        H5Pset_deflate(creation.get(), 1);
        const Hdf5Handle made(
            H5Dcreate2(open, "vertices/p", H5T_IEEE_F32LE, space.get(), H5P_DEFAULT, creation.get(), H5P_DEFAULT),
            H5Dclose);
        H5Dwrite(made.get(), H5T_IEEE_F32LE, H5S_ALL, H5S_ALL, H5P_DEFAULT, graph.vertices.p.data());
    });
    const PathGraph read = read_path_graph(file());
    EXPECT_TRUE(std::equal(read.vertices.p.begin(), read.vertices.p.end(), graph.vertices.p.begin()));
}

}  // namespace
}  // namespace loom
