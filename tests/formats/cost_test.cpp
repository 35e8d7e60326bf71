#include "formats/io/cost.h"

#include <gtest/gtest.h>

#include "formats/io/json.h"
#include "tests/formats/tiny_graph.h"

namespace loom {
namespace {

using testing::file_bytes;
using testing::input_error_of;
using testing::ScratchFolder;
using testing::write_bytes;

Cost some_cost() {
    return {"loom-trace",
            1.25,
            2.4999999999999996,
            0xffffffffffffffffu,
            921600,
            123456789,
            5,
            {"a \"b\"\\\n\x01.exr", "../c.h5"},
            {"scene.xml"},
            0.125,
            "loom-trace scene.xml --spp 4",
            "on: all; off: nothing"};
}

TEST(Cost, ReadsBack) {
    const ScratchFolder folder;
    write_cost(some_cost(), folder / "x.h5");
    EXPECT_TRUE(std::filesystem::exists(folder / "x.h5.cost.json"));
    EXPECT_EQ(read_cost(folder / "x.h5"), some_cost());
}

// A base name alone would lose parents that lie in another folder, as the passes of a picture do.
TEST(Cost, ParentsAreFoundFromTheFolderOfTheOutput) {
    EXPECT_EQ(parent_of("out/image.exr", "out/pt/pass-0.exr"), "pt/pass-0.exr");
    EXPECT_EQ(parent_of("out/image.exr", "out/graph.h5"), "graph.h5");
    EXPECT_EQ(parent_of("image.exr", "./graph.h5"), "graph.h5");
    EXPECT_EQ(parent_of("out/x/../image.exr", "old/image.exr"), "../old/image.exr");
    EXPECT_EQ(parent_of("/a/b/image.exr", "/a/c/graph.h5"), "../c/graph.h5");
}

TEST(Cost, NoParents) {
    const ScratchFolder folder;
    write_cost({}, folder / "x.h5");
    EXPECT_EQ(read_cost(folder / "x.h5"), Cost{});
}

// Files from before a cost named its command and plan.
TEST(Cost, CommandAndPlanMayBeMissing) {
    const ScratchFolder folder;
    write_bytes(
        cost_path(folder / "x.h5"),
        "{\"stage\": \"s\", \"wall_s\": 1, \"cpu_s\": 2, \"rays\": 3, \"samples\": 4, \"peak_memory_bytes\": 5, "
        "\"bytes_written\": 6, \"parents\": [], \"sources\": []}");
    const Cost cost = read_cost(folder / "x.h5");
    EXPECT_EQ(cost.bytes_written, 6u);
    EXPECT_EQ(cost.command + cost.plan, "");
}

TEST(Cost, BadFilesSayWhatIsWrong) {
    const ScratchFolder folder;
    const auto file = cost_path(folder / "x.h5");
    const auto message = [&] { return input_error_of([&] { read_cost(folder / "x.h5"); }); };
    EXPECT_EQ(message(), file.native() + ": no such file");
    write_bytes(file, "{\n\"stage\": \"x\",\n");
    EXPECT_EQ(message(), file.native() + ":3: expected \"");
    write_bytes(file, "{\"stage\": 3}");
    EXPECT_EQ(message(), file.native() + ": \"stage\" is missing or of another type");
    write_bytes(file, "{\"stage\": \"x\", \"wall_s\": 1, \"cpu_s\": 1, \"rays\": -1}");
    EXPECT_EQ(message(), file.native() + ": \"rays\" is -1, which is no such number");
}

TEST(Json, TruncatedAnywhere) {
    const ScratchFolder folder;
    write_cost(some_cost(), folder / "x.h5");
    const std::string whole = file_bytes(cost_path(folder / "x.h5"));
    for (std::size_t n = 0; n + 2 < whole.size(); ++n) {
        EXPECT_NE(input_error_of([&] { parse_json(std::string_view(whole).substr(0, n), "x"); }), "nothing was thrown");
    }
    EXPECT_NE(input_error_of([] { parse_json(std::string(100'000, '['), "x"); }), "nothing was thrown");
}

}  // namespace
}  // namespace loom
