// Layout of the files for other programs, read through the C interface of HDF5 alone.

#include <gtest/gtest.h>
#include <hdf5.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <csignal>

#include "formats/documentation.h"
#include "formats/io/hdf5_handle.h"
#include "formats/io/output_file.h"
#include "formats/path_graph.h"
#include "tests/formats/tiny_graph.h"

namespace loom {
namespace {

using testing::file_bytes;
using testing::input_error_of;
using testing::ScratchFolder;

TEST(FileLayout, EveryDatasetSaysItsUnitsAndAxesAndIsContiguous) {
    const ScratchFolder folder;
    write_path_graph(testing::tiny_graph(), folder / "g.h5");
    const Hdf5Handle file(H5Fopen((folder / "g.h5").c_str(), H5F_ACC_RDONLY, H5P_DEFAULT), H5Fclose);
    int n_datasets = 0;
    H5Ovisit2(
        file.get(), H5_INDEX_NAME, H5_ITER_INC,
        [](hid_t root, const char* name, const H5O_info_t* info, void* count) -> herr_t {
            if (info->type != H5O_TYPE_DATASET) return 0;
            ++*static_cast<int*>(count);
            const Hdf5Handle dataset(H5Dopen2(root, name, H5P_DEFAULT), H5Dclose);
            const Hdf5Handle creation(H5Dget_create_plist(dataset.get()), H5Pclose);
            const Hdf5Handle space(H5Dget_space(dataset.get()), H5Sclose);
            EXPECT_EQ(H5Pget_layout(creation.get()), H5D_CONTIGUOUS) << name;
            EXPECT_EQ(info->mtime, 0) << name;
            const auto units = text_attribute(dataset.get(), "units");
            const auto axes = text_attribute(dataset.get(), "axes");
            const auto description = text_attribute(dataset.get(), "description");
            EXPECT_TRUE(units && !units->front().empty()) << name;
            EXPECT_TRUE(description && !description->front().empty()) << name;
            EXPECT_TRUE(axes) << name;
            const int rank = H5Sget_simple_extent_ndims(space.get());
            if (axes && rank > 0) {
                const std::string& text = axes->front();
                const bool one_letter_each = text == "xyz" || text == "xy";  // axes of a single small vector
                EXPECT_EQ(one_letter_each ? 1 : 1 + std::count(text.begin(), text.end(), ','), rank) << name;
            }
            return 0;
        },
        &n_datasets, H5O_INFO_ALL);
    EXPECT_GT(n_datasets, 60);
}

TEST(FileLayout, HalvesAreIeeeBinary16) {
    const ScratchFolder folder;
    write_path_graph(testing::tiny_graph(), folder / "g.h5");
    const Hdf5Handle file(H5Fopen((folder / "g.h5").c_str(), H5F_ACC_RDONLY, H5P_DEFAULT), H5Fclose);
    const Hdf5Handle dataset(H5Dopen2(file.get(), "vertices/alpha", H5P_DEFAULT), H5Dclose);
    std::array<float, 12> values{};  // the library's own conversion is the oracle
    ASSERT_GE(H5Dread(dataset.get(), H5T_NATIVE_FLOAT, H5S_ALL, H5S_ALL, H5P_DEFAULT, values.data()), 0);
    for (float value : values) EXPECT_EQ(value, 0.0999755859375f);  // the half nearest to 0.1
}

TEST(FileLayout, FailedWriteLeavesNothing) {
    const ScratchFolder folder;
    const auto old_handler = std::signal(SIGXFSZ, SIG_IGN);
    rlimit old_limit{};
    getrlimit(RLIMIT_FSIZE, &old_limit);
    const rlimit limit{200'000, old_limit.rlim_max};
    setrlimit(RLIMIT_FSIZE, &limit);
    EXPECT_THROW(write_path_graph(testing::large_graph(50'000), folder / "g.h5"), std::runtime_error);
    setrlimit(RLIMIT_FSIZE, &old_limit);
    std::signal(SIGXFSZ, old_handler);
    EXPECT_FALSE(std::filesystem::exists(folder / "g.h5"));
    EXPECT_EQ(folder.n_partial(), 0);
}

TEST(FileLayout, AFailureKeepsTheOldFile) {
    const ScratchFolder folder;
    write_text_file(folder / "a.txt", "old");
    {
        const OutputFile output(folder / "a.txt");
        testing::write_bytes(output.partial(), "half of the n");
    }
    EXPECT_EQ(file_bytes(folder / "a.txt"), "old");
    EXPECT_EQ(folder.n_partial(), 0);
}

/// Starts a process that holds the half-written temporary file of `path` until it is killed.
pid_t writer_of(const std::filesystem::path& path) {
    int ready[2];
    if (::pipe(ready) != 0) return -1;
    const pid_t child = ::fork();
    if (child == 0) {
        const OutputFile output(path);
        testing::write_bytes(output.partial(), "half of");
        if (::write(ready[1], "!", 1) != 1) ::_exit(1);
        for (;;) ::pause();
    }
    char byte = 0;
    EXPECT_EQ(::read(ready[0], &byte, 1), 1);
    ::close(ready[0]);
    ::close(ready[1]);
    return child;
}

// Would catch two writers that share a temporary name, and leftovers that stay for ever.
TEST(FileLayout, TwoWritersDoNotMeetAndTheDeadAreCleanedUp) {
    const ScratchFolder folder;
    const pid_t other = writer_of(folder / "a.txt");
    ASSERT_GT(other, 0);
    write_text_file(folder / "a.txt", "new");
    EXPECT_EQ(file_bytes(folder / "a.txt"), "new");
    EXPECT_EQ(folder.n_partial(), 1) << "that of the living writer";
    ::kill(other, SIGKILL);
    ::waitpid(other, nullptr, 0);
    write_text_file(folder / "b.txt", "of another name");
    EXPECT_EQ(folder.n_partial(), 1);
    write_text_file(folder / "a.txt", "newer");
    EXPECT_EQ(file_bytes(folder / "a.txt"), "newer");
    EXPECT_EQ(folder.n_partial(), 0);
}

TEST(FileLayout, OutputsThatCannotBeAreRefusedEarly) {
    const ScratchFolder folder;
    EXPECT_NE(input_error_of([&] { check_output_path(folder / "none/g.h5"); }).find("there is no folder"),
              std::string::npos);
    EXPECT_NE(input_error_of([&] { check_output_path(folder / ""); }).find("is a directory"), std::string::npos);
}

TEST(Documentation, FormatsMdIsFresh) {
    EXPECT_EQ(file_bytes("formats/FORMATS.md"), formats_markdown())
        << "renew it: loom-inspect --formats --quiet > formats/FORMATS.md";
}

}  // namespace
}  // namespace loom
