// Costs along the chain of parents, of files that may be gone.

#include "stages/compare/chain.h"

#include <gtest/gtest.h>

#include "tests/formats/tiny_graph.h"

namespace loom::compare {
namespace {

using testing::input_error_of;
using testing::ScratchFolder;

Cost cost(const std::string& stage, double cpu_s, std::vector<std::string> parents) {
    Cost c;
    c.stage = stage;
    c.cpu_s = cpu_s;
    c.wall_s = 2 * cpu_s;
    c.rays = 10;
    c.peak_memory_bytes = std::uint64_t(1000 * cpu_s);
    c.parents = std::move(parents);
    return c;
}

//   a.h5 ─┬─ b.h5 ─┬─ c.exr ─ image.exr      a.h5 is reached twice, and counted once.
//         └────────┘
TEST(Chain, ADiamondCountsOnce) {
    const ScratchFolder folder;
    std::filesystem::create_directory(folder / "sub");
    write_cost(cost("loom-trace", 1, {}), folder / "sub/a.h5");
    write_cost(cost("loom-cluster", 2, {"a.h5"}), folder / "sub/b.h5");
    write_cost(cost("loom-gather", 4, {"a.h5", "../sub/b.h5"}), folder / "sub/c.exr");
    write_cost(cost("loom-merge", 8, {"sub/c.exr", "sub/../sub/c.exr"}), folder / "image.exr");
    const auto stages = chain_cost(folder / "image.exr");
    ASSERT_EQ(stages.size(), 4u);
    EXPECT_EQ(stages[0].cost.stage, "loom-trace");
    EXPECT_EQ(stages[3].cost.stage, "loom-merge");
    const StageCost total = total_of(stages);
    EXPECT_EQ(total.n_files, 4u);
    EXPECT_EQ(total.cost.cpu_s, 15);
    EXPECT_EQ(total.cost.wall_s, 30);
    EXPECT_EQ(total.cost.rays, 40u);
    EXPECT_EQ(total.cost.peak_memory_bytes, 8000u);
}

TEST(Chain, FilesOfOneStageAddUp) {
    const ScratchFolder folder;
    write_cost(cost("loom-trace", 1, {}), folder / "a.exr");
    write_cost(cost("loom-trace", 3, {}), folder / "b.exr");
    write_cost(cost("loom-merge", 1, {"a.exr", "b.exr"}), folder / "image.exr");
    const auto stages = chain_cost(folder / "image.exr");
    ASSERT_EQ(stages.size(), 2u);
    EXPECT_EQ(stages[0].n_files, 2u);
    EXPECT_EQ(stages[0].cost.cpu_s, 4);
    EXPECT_EQ(stages[0].cost.peak_memory_bytes, 3000u);
}

TEST(Chain, AMissingCostIsNamed) {
    const ScratchFolder folder;
    write_cost(cost("loom-merge", 1, {"a.exr"}), folder / "image.exr");
    EXPECT_EQ(input_error_of([&] { chain_cost(folder / "image.exr"); }),
              (folder / "a.exr.cost.json").native() + ": no such file (a parent of " + (folder / "image.exr").native() +
                  "); make " + (folder / "a.exr").native() + " again");
}

TEST(Chain, ALoopIsRefused) {
    const ScratchFolder folder;
    write_cost(cost("loom-merge", 1, {"b.exr"}), folder / "a.exr");
    write_cost(cost("loom-merge", 1, {"a.exr"}), folder / "b.exr");
    EXPECT_NE(input_error_of([&] { chain_cost(folder / "a.exr"); }).find("among its own parents"), std::string::npos);
}

}  // namespace
}  // namespace loom::compare
