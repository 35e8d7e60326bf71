// Stages between a path graph and an image with files that do not belong together: each names both files and the
// command that makes matching ones.

#include "tests/pipeline/process.h"

namespace loom::pipeline {
namespace {

class PathGraphChain : public PipelineTest {
  protected:
    void SetUp() override {
        PipelineTest::SetUp();
        const std::string box = "scenes/cornell-box.xml -D resx=12 -D resy=9 ";
        for (const char* seed : {"1", "2"}) {
            const std::string g = in("g") + seed + ".h5", c = in("c") + seed + ".h5";
            ASSERT_EQ(sh(stage("trace") + " " + box + "--seed " + seed + " -o " + g).code, 0);
            ASSERT_EQ(sh(stage("cluster") + " " + g + " -o " + c).code, 0);
            ASSERT_EQ(sh(stage("refine") + " " + g + " " + c + " -o " + in("r") + seed + ".h5").code, 0);
        }
    }
    std::string in(const std::string& name) const { return (folder / name).string(); }
    /// Exit code 2, the message, and no new file.
    void expect_refused(const std::string& command, const std::string& message) const {
        const auto before = files();
        const Outcome outcome = sh(command);
        EXPECT_EQ(outcome.code, 2) << command << "\n" << outcome.err;
        EXPECT_EQ(outcome.out, "");
        EXPECT_NE(outcome.err.find(message), std::string::npos) << command << "\n" << outcome.err;
        EXPECT_EQ(files(), before) << command;
    }
};

TEST_F(PathGraphChain, files_of_different_graphs_are_refused) {
    const std::string h5 = " -o " + in("x.h5"), exr = " -o " + in("x.exr");
    expect_refused(stage("refine") + " " + in("g1.h5") + " " + in("c2.h5") + h5,
                   in("c2.h5") + ": made from g2.h5 (content ");
    expect_refused(stage("refine") + " " + in("g1.h5") + " " + in("c2.h5") + h5, "not from g1.h5 (content ");
    expect_refused(stage("refine") + " " + in("g1.h5") + " " + in("c2.h5") + h5, "run: loom-cluster g1.h5 -o ");
    expect_refused(stage("gather") + " " + in("g1.h5") + " " + in("r2.h5") + exr,
                   in("r2.h5") + ": made from g2.h5 (content ");
    expect_refused(stage("gather") + " " + in("g1.h5") + " " + in("r2.h5") + exr,
                   "run: loom-refine g1.h5 CLUSTERS -o ");
}

TEST_F(PathGraphChain, files_of_another_kind_are_refused) {
    const std::string h5 = " -o " + in("x.h5"), exr = " -o " + in("x.exr");
    expect_refused(stage("refine") + " " + in("g1.h5") + h5, "clusters: missing (made by loom-cluster)");
    expect_refused(stage("refine") + " " + in("g1.h5") + " " + in("r1.h5") + h5, "is a radiance, expected a clusters");
    expect_refused(stage("refine") + " " + in("c1.h5") + " " + in("c1.h5") + h5,
                   "is a clusters, expected a path_graph");
    expect_refused(stage("gather") + " " + in("g1.h5") + " " + in("c1.h5") + exr, "is a clusters, expected a radiance");
    expect_refused(stage("gather") + " " + in("r1.h5") + " " + in("r1.h5") + exr,
                   "is a radiance, expected a path_graph");
    expect_refused(stage("refine") + " " + in("g1.h5") + " " + in("c1.h5") + " --method west" + h5,
                   "leave out the clusters");
    expect_refused(stage("refine") + " " + in("g1.h5") + " " + in("c1.h5") + " --epsilon 2" + h5, "--epsilon");
}

// Inputs for drawing a subset and for tracing its rays.
TEST_F(PathGraphChain, subsets_ask_for_what_they_need) {
    const std::string gather = stage("gather") + " " + in("g1.h5") + " " + in("r1.h5") + " ",
                      exr = " -o " + in("x.exr");
    const std::string box = " --scene scenes/cornell-box.xml -D resx=12 -D resy=9";
    expect_refused(gather + "--indirect subset" + exr, "clusters: missing; a subset is drawn from them");
    expect_refused(gather + in("c1.h5") + exr, "only subsets need clusters");
    expect_refused(gather + in("c2.h5") + " --direct subset" + exr, in("c2.h5") + ": made from g2.h5 (content ");
    expect_refused(gather + in("c1.h5") + " --indirect subset --occlusion" + exr, "--occlusion: needs --scene");
    expect_refused(gather + in("c1.h5") + " --indirect subset" + box + exr, "only --occlusion needs it");
    expect_refused(gather + in("c1.h5") + " --direct subset --occlusion" + box + exr,
                   "--occlusion: needs --indirect subset");
    expect_refused(gather + in("c1.h5") + " --indirect subset --occlusion" + box + " -D rho=0.5" + exr,
                   "scenes/cornell-box.xml");
    expect_refused(gather + in("c1.h5") + " --indirect subset --occlusion --scene scenes/cornell-box.xml" + exr,
                   "was traced in another scene, or with other -D values");
}

// Clusters that no kernel has lanes for are legal files; refining them must not run over the lanes.
TEST_F(PathGraphChain, too_large_clusters_are_refused) {
    ASSERT_EQ(sh(stage("cluster") + " " + in("g1.h5") + " --k 512 -o " + in("large.h5")).code, 0);
    expect_refused(stage("refine") + " " + in("g1.h5") + " " + in("large.h5") + " -o " + in("x.h5"),
                   "clusters of up to 1024 vertices; at most 256 can be refined");
}

TEST_F(PathGraphChain, bytes_do_not_depend_on_threads_or_place) {
    for (const char* options :
         {"", " --start zero --iterations 3", " --clamp cluster", " --reuse points --clamp none", " --as-printed"}) {
        for (const char* n : {"1", "2"}) {
            const std::string r = in("t") + n + ".h5";
            ASSERT_EQ(
                sh(stage("refine") + " " + in("g1.h5") + " " + in("c1.h5") + options + " --threads " + n + " -o " + r)
                    .code,
                0);
            ASSERT_EQ(sh(stage("gather") + " " + in("g1.h5") + " " + r + " --estimates --threads " + n + " -o " +
                         in("t") + n + ".exr")
                          .code,
                      0);
            if (*n == '1') continue;
            EXPECT_TRUE(bytes_of(folder / "t1.h5") == bytes_of(folder / "t2.h5")) << options;
        }
        for (const char* n : {"1", "2"})
            ASSERT_EQ(sh(stage("gather") + " " + in("g1.h5") + " " + in("t2.h5") + " " + in("c1.h5") +
                         " --direct subset --indirect subset --occlusion --scene scenes/cornell-box.xml -D resx=12 -D "
                         "resy=9 --threads " +
                         n + " -o " + in("s") + n + ".exr")
                          .code,
                      0);
        EXPECT_TRUE(bytes_of(folder / "s1.exr") == bytes_of(folder / "s2.exr")) << options;
        fs::create_directories(folder / "elsewhere");
        fs::copy_file(folder / "t1.h5", folder / "elsewhere/t2.h5", fs::copy_options::overwrite_existing);
        ASSERT_EQ(sh(stage("gather") + " " + in("g1.h5") + " " + in("elsewhere/t2.h5") +
                     " --estimates --threads 1 -o " + in("elsewhere/t2.exr"))
                      .code,
                  0);
        EXPECT_TRUE(bytes_of(folder / "t2.exr") == bytes_of(folder / "elsewhere/t2.exr")) << options;
    }
}

}  // namespace
}  // namespace loom::pipeline
