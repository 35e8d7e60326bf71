// Every kind of output: a write that fails is an error and leaves no file, whichever of its bytes could not be written;
// values that are not finite are an error that keeps the file under another name. Detected mutation: an EXR file closed
// by its destructor alone.

#include <gtest/gtest.h>
#include <sys/resource.h>

#include <csignal>
#include <filesystem>
#include <functional>
#include <limits>
#include <map>
#include <string>
#include <vector>

#include "formats/clusters.h"
#include "formats/image.h"
#include "formats/io/cost.h"
#include "formats/io/output_file.h"
#include "formats/radiance.h"
#include "formats/tal_capture.h"
#include "formats/transient_cube.h"
#include "tests/formats/tiny_clusters.h"
#include "tests/formats/tiny_graph.h"
#include "tests/formats/tiny_image.h"
#include "tests/formats/tiny_radiance.h"

namespace loom {
namespace {

namespace fs = std::filesystem;
using testing::ScratchFolder;

constexpr float nan = std::numeric_limits<float>::quiet_NaN();

/// No file of this process can grow beyond so many bytes, as on a disk that is nearly full.
class FileSizeLimit {
  public:
    explicit FileSizeLimit(std::uintmax_t bytes) {
        signal_ = std::signal(SIGXFSZ, SIG_IGN);
        getrlimit(RLIMIT_FSIZE, &before_);
        const rlimit limit{bytes, before_.rlim_max};
        setrlimit(RLIMIT_FSIZE, &limit);
    }
    ~FileSizeLimit() {
        setrlimit(RLIMIT_FSIZE, &before_);
        std::signal(SIGXFSZ, signal_);
    }

  private:
    rlimit before_{};
    void (*signal_)(int);
};

void write_cube(const fs::path& file, float value) {
    TransientCubeHeader header;
    header.film = {3, 2, 1};
    header.time = {4, 1.5, 0.25, 0.25, "opl", 1, 1};
    TransientCubeWriter writer(file, header);
    std::vector<float> row(header.row_size()), pixels(9);
    row[5] = value;
    for (std::uint32_t y : {0u, 1u}) writer.write_rows(y, {row, row, pixels, pixels, pixels, pixels});
    writer.commit(Sync::yes);
}

TalCapture tiny_capture(float value) {
    TalCapture c;
    c.n_bins = 5;
    c.sensor_grid = {2, 3, std::vector<float>(18, 0.5f), std::vector<float>(18, 1)};
    c.laser_grid = {1, 1, std::vector<float>(3), std::vector<float>(3)};
    c.H.assign(30, value);
    return c;
}

/// Writers of every kind of output by the name of their file.
std::map<std::string, std::function<void(const fs::path&)>> writers() {
    return {
        {"text.json", [](const fs::path& p) { write_text_file(p, std::string(10000, 'x')); }},
        {"plain.exr", [](const fs::path& p) { write_image(testing::tiny_image(), p); }},
        {"zip.exr", [](const fs::path& p) { write_image(testing::tiny_image(), p, Compression::zip); }},
        {"preview.png", [](const fs::path& p) { write_png(testing::tiny_image(), p); }},
        {"graph.h5", [](const fs::path& p) { write_path_graph(testing::large_graph(5000), p); }},
        {"clusters.h5", [](const fs::path& p) { write_clusters(testing::tiny_clusters(), p); }},
        {"radiance.h5", [](const fs::path& p) { write_radiance(testing::tiny_radiance(), p); }},
        {"cube.h5", [](const fs::path& p) { write_cube(p, 1); }},
        {"tal.hdf5", [](const fs::path& p) { write_tal_capture(tiny_capture(1), p); }},
    };
}

TEST(Outputs, FailedWritesLeaveNothing) {
    const ScratchFolder folder;
    for (const auto& [name, write] : writers()) {
        const fs::path file = folder / name;
        write(file);
        const std::uintmax_t size = fs::file_size(file);
        fs::remove(file);
        for (const std::uintmax_t limit : {std::uintmax_t(0), size / 2, size - 1}) {
            bool failed = false;
            {
                const FileSizeLimit full(limit);
                try {
                    write(file);
                } catch (const std::runtime_error& error) {
                    failed = std::string(error.what()).find(name) != std::string::npos;
                }
            }
            EXPECT_TRUE(failed) << name << " of " << size << " bytes, limit " << limit;
            EXPECT_TRUE(fs::is_empty(folder / "")) << name << ", limit " << limit;
        }
        write(file);  // a failure leaves the process able to write
        fs::remove(file);
    }
}

TEST(Outputs, NonfiniteValuesAreAnErrorThatKeepsTheFile) {
    const ScratchFolder folder;
    Image image = testing::tiny_image();
    image.add("G")[5] = nan;
    image.add("VarMean.R")[2] = std::numeric_limits<float>::infinity();
    PathGraph graph = testing::tiny_graph();
    graph.vertices.pdf_w = {0.3f, nan, 0.1f, 0.5f, nan, 0.0f};
    Radiance radiance = testing::tiny_radiance();
    std::vector<float> L(radiance.L.begin(), radiance.L.end());
    L[4] = nan;
    radiance.L = L;
    const struct {
        std::string name, what;
        std::function<void(const fs::path&)> write;
    } cases[] = {
        {"x.exr", "1 of G, the first in pixel (1, 1); 1 of VarMean.R, the first in pixel (2, 0)",
         [&](const fs::path& p) { write_image(image, p); }},
        {"graph.h5", "2 of vertices/pdf_w", [&](const fs::path& p) { write_path_graph(graph, p); }},
        {"radiance.h5", "1 of vertices/L", [&](const fs::path& p) { write_radiance(radiance, p); }},
        {"cube.h5", "2 of radiance, 2 of var_mean", [](const fs::path& p) { write_cube(p, nan); }},
        {"tal.hdf5", "30 of H", [](const fs::path& p) { write_tal_capture(tiny_capture(nan), p); }},
    };
    for (const auto& c : cases) {
        const fs::path file = folder / c.name, kept = not_finite_name(file);
        try {
            c.write(file);
            ADD_FAILURE() << c.name;
        } catch (const NonfiniteError& error) {
            EXPECT_EQ(error.what(),
                      file.native() + ": values are NaN or infinite (" + c.what + "); kept as " + kept.native());
        }
        EXPECT_FALSE(fs::exists(file));
        EXPECT_TRUE(fs::exists(kept));
    }
    EXPECT_EQ(not_finite_name("a/x.exr"), "a/x.not-finite.exr");
    // The next good output of that name removes it.
    write_image(testing::tiny_image(), folder / "x.exr");
    EXPECT_FALSE(fs::exists(folder / "x.not-finite.exr"));
}

}  // namespace
}  // namespace loom
