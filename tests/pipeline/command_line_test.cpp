// Interface of each stage: help, exit codes, and no files left by a failure.

#include "tests/pipeline/process.h"

namespace loom::pipeline {
namespace {

const std::string box = "scenes/cornell-box.xml -D resx=16 -D resy=16 ";

class CommandLine : public PipelineTest {
  protected:
    /// Runs a stage that must fail: its exit code, a message, nothing on stdout, no new file.
    void expect_failure(int code, const std::string& command) const {
        const std::vector<std::string> before = files();
        const Outcome outcome = sh(command);
        EXPECT_EQ(outcome.code, code) << command << "\n" << outcome.err;
        EXPECT_EQ(outcome.out, "") << command;
        EXPECT_NE(outcome.err.find("error: "), std::string::npos) << command << "\n" << outcome.err;
        EXPECT_EQ(files(), before) << command;
    }
    std::string in(const std::string& name) const { return (folder / name).string(); }
};

TEST_F(CommandLine, help_and_version) {
    for (const char* name : {"trace", "cluster", "refine", "gather", "merge", "denoise", "inspect", "compare", "chart",
                             "transient", "frames", "residual"}) {
        const Outcome help = sh(stage(name) + " --help");
        EXPECT_EQ(help.code, 0) << name;
        EXPECT_NE(help.out.find("--quiet"), std::string::npos) << name;
        const Outcome version = sh(stage(name) + " --version");
        EXPECT_EQ(version.code, 0) << name;
        EXPECT_EQ(version.out.find("loom-" + std::string(name) + " "), 0u) << version.out;
    }
}

TEST_F(CommandLine, wrong_command_lines_are_2) {
    const std::string o = " -o " + in("x.h5"), image = " -o " + in("x.exr");
    expect_failure(2, stage("trace"));
    expect_failure(2, stage("cluster"));
    expect_failure(2, stage("refine"));
    expect_failure(2, stage("gather"));
    expect_failure(2, stage("merge"));
    expect_failure(2, stage("denoise"));
    expect_failure(2, stage("inspect"));
    expect_failure(2, stage("compare"));
    expect_failure(2, stage("chart"));
    expect_failure(2, stage("compare") + " missing.exr other.exr");
    expect_failure(2, stage("compare") + " --cost missing.exr");
    expect_failure(2, stage("chart") + " missing.tsv -o " + in("x.svg"));
    expect_failure(2, stage("trace") + " missing.xml" + o);
    expect_failure(2, stage("cluster") + " missing.h5" + o);
    expect_failure(2, stage("gather") + " missing.h5" + image);
    expect_failure(2, stage("merge") + " missing.exr" + image);
    expect_failure(2, stage("denoise") + " missing.exr" + image);
    expect_failure(2, stage("denoise") + " tests/fixtures/image_1.0.exr");
    expect_failure(2, stage("denoise") + " tests/fixtures/image_1.0.exr --method none" + image);
    expect_failure(2, stage("denoise") + " tests/fixtures/image_1.0.exr --oidn /no/such/folder" + image);
    expect_failure(2, stage("inspect") + " missing.h5");
    expect_failure(2, stage("trace") + " " + box + o + " --unknown");
    expect_failure(2, stage("trace") + " " + box);
    expect_failure(2, stage("trace") + " " + box + " -o " + in("x.txt"));
    expect_failure(2, stage("trace") + " " + box + " -o " + in("no/folder/x.h5"));
    expect_failure(2, stage("trace") + " " + box + o + " --spp 0");
    expect_failure(2, stage("trace") + " " + box + o + " --sampler none");
    expect_failure(2, stage("trace") + " " + box + o + " -D nobody=1");
    expect_failure(2, stage("inspect") + " --scene scenes/cornell-box.xml --stamp " + in("no/folder/x.stamp"));
}

// OpenImageIO and its 150 libraries cost 0.3 s of every process that loads them.
TEST_F(CommandLine, only_textures_load_their_library) {
    const auto libraries = [&](const std::string& scene) {
        const Outcome outcome = sh("LD_DEBUG=libs " + stage("trace") + " " + scene + " --plan");
        EXPECT_EQ(outcome.code, 0);
        return outcome.err;
    };
    EXPECT_EQ(libraries(box).find("libOpenImageIO"), std::string::npos);
    EXPECT_NE(libraries("scenes/textured.xml").find("libOpenImageIO"), std::string::npos);
}

TEST_F(CommandLine, foreign_inputs_are_2) {
    std::ofstream(folder / "text.h5") << "this is no HDF5 file\n";
    std::ofstream(folder / "empty.h5") << "";
    std::ofstream(folder / "text.exr") << "nor is this an EXR\n";
    std::ofstream(folder / "text.xml") << "not <xml\n";
    for (const char* graph : {"text.h5", "empty.h5"}) {
        expect_failure(2, stage("gather") + " " + in(graph) + " -o " + in("x.exr"));
        expect_failure(2, stage("cluster") + " " + in(graph) + " -o " + in("x.h5"));
        expect_failure(2, stage("inspect") + " " + in(graph));
    }
    expect_failure(2, stage("merge") + " " + in("text.exr") + " -o " + in("x.exr"));
    expect_failure(2, stage("denoise") + " " + in("text.exr") + " -o " + in("x.exr"));
    expect_failure(2, stage("inspect") + " " + in("text.exr"));
    expect_failure(2, stage("trace") + " " + in("text.xml") + " -o " + in("x.h5"));
}

TEST_F(CommandLine, truncated_graph_is_2) {
    ASSERT_EQ(sh(stage("trace") + " " + box + "-o " + in("whole.h5")).code, 0);
    const std::string whole = bytes_of(folder / "whole.h5");
    for (const double part : {0.02, 0.5, 0.999}) {
        std::ofstream(folder / "cut.h5", std::ios::binary)
            << whole.substr(0, static_cast<std::size_t>(part * static_cast<double>(whole.size())));
        expect_failure(2, stage("gather") + " " + in("cut.h5") + " -o " + in("x.exr"));
    }
}

// A file-size limit stands in for a full disk: the write fails half-way.
TEST_F(CommandLine, failed_write_leaves_nothing) {
    const std::string limited = "trap '' XFSZ; ulimit -f 8; ";
    expect_failure(3, limited + stage("trace") + " " + box + "--spp 16 -o " + in("x.h5"));
    expect_failure(3, limited + stage("trace") + " scenes/cornell-box.xml --spp 1 -o " + in("x.exr"));
}

// Detected mutation: exit 0 after a help that could not be written.
TEST_F(CommandLine, answers_that_cannot_be_written_are_3) {
    ASSERT_EQ(sh(stage("trace") + " " + box + "-o " + in("x.exr")).code, 0);
    for (const std::string& command :
         {stage("inspect") + " " + in("x.exr"), stage("inspect") + " " + in("x.exr") + " --json",
          stage("trace") + " --help", stage("trace") + " --version", stage("trace") + " " + box + "--plan"}) {
        const Outcome outcome = sh(command + " > /dev/full");
        EXPECT_EQ(outcome.code, 3) << command;
        EXPECT_NE(outcome.err.find("cannot write to the standard output"), std::string::npos) << outcome.err;
    }
}

// Radiance that is finite, with a variance that is not.
TEST_F(CommandLine, outputs_with_values_that_are_not_finite_are_3_and_kept) {
    std::ofstream(folder / "bright.xml")
        << "<scene version='3.0.0'><sensor type='perspective'><film type='hdrfilm'><integer name='width' value='4'/>"
           "<integer name='height' value='4'/></film></sensor><emitter type='constant'><rgb name='radiance' "
           "value='1e30'/></emitter>"
           "<shape type='sphere'><point name='center' x='0' y='0' z='5'/></shape></scene>";
    const Outcome outcome = sh(stage("trace") + " " + in("bright.xml") + " --spp 4 -o " + in("x.exr"));
    EXPECT_EQ(outcome.code, 3);
    EXPECT_NE(outcome.err.find("VarMean.R, the first in pixel"), std::string::npos) << outcome.err;
    EXPECT_EQ(files(), (std::vector<std::string>{"bright.xml", "x.not-finite.exr"}));
    EXPECT_EQ(sh(stage("trace") + " " + in("bright.xml") + " --spp 4 --passes 2 -o " + in("y%.exr")).code, 3);
    EXPECT_TRUE(fs::exists(folder / "y0.not-finite.exr") && fs::exists(folder / "y1.not-finite.exr"));
}

TEST_F(CommandLine, outputs_do_not_depend_on_place_or_threads) {
    fs::create_directories(folder / "else where");
    ASSERT_EQ(sh(stage("trace") + " " + box + "--spp 3 --threads 1 -o " + in("a.h5")).code, 0);
    ASSERT_EQ(sh(stage("trace") + " " + box + "--spp 3 --threads 2 --quiet -o '" + in("else where/b.h5") + "'").code,
              0);
    EXPECT_TRUE(bytes_of(folder / "a.h5") == bytes_of(folder / "else where/b.h5"));
    const std::string scene = "'" LOOM_SOURCE_DIR "/scenes/cornell-box.xml' -D resx=16 -D resy=16 ";
    ASSERT_EQ(sh(stage("trace") + " " + scene + "--spp 3 -o " + in("c.h5")).code, 0);
    EXPECT_TRUE(bytes_of(folder / "a.h5") == bytes_of(folder / "c.h5"));
    for (const int threads : {1, 2}) {
        const std::string n = std::to_string(threads);
        ASSERT_EQ(sh(stage("trace") + " " + box + "--spp 3 --threads " + n + " -o " + in("p" + n + ".exr")).code, 0);
        ASSERT_EQ(sh(stage("gather") + " " + in("a.h5") + " --threads " + n + " -o " + in("g" + n + ".exr")).code, 0);
    }
    EXPECT_TRUE(bytes_of(folder / "p1.exr") == bytes_of(folder / "p2.exr"));
    EXPECT_TRUE(bytes_of(folder / "g1.exr") == bytes_of(folder / "g2.exr"));
}

TEST_F(CommandLine, clusters_do_not_depend_on_place_or_threads) {
    ASSERT_EQ(sh(stage("trace") + " " + box + "--spp 4 -o " + in("g.h5")).code, 0);
    for (const char* method : {"balanced", "centres"}) {
        const std::string cluster = stage("cluster") + " " + in("g.h5") + " --method " + method;
        const Outcome one = sh(cluster + " --threads 1 -o " + in("a.h5"));
        ASSERT_EQ(one.code, 0) << one.err;
        EXPECT_NE(one.err.find("size: mean"), std::string::npos) << one.err;
        ASSERT_EQ(sh(cluster + " --threads 2 --quiet -o " + in("b.h5")).code, 0);
        EXPECT_TRUE(bytes_of(folder / "a.h5") == bytes_of(folder / "b.h5"));
        EXPECT_EQ(sh(stage("inspect") + " " + in("a.h5") + " --graph " + in("g.h5")).code, 0);
        EXPECT_NE(sh(cluster + " --plan").out, "");
        expect_failure(2, cluster + " --max-size 8 -o " + in("c.h5"));
    }
    expect_failure(2, stage("inspect") + " " + in("g.h5") + " --graph " + in("nothing.h5"));
    ASSERT_EQ(sh(stage("trace") + " " + box + "--spp 4 --seed 1 -o " + in("other.h5")).code, 0);
    expect_failure(2, stage("inspect") + " " + in("a.h5") + " --graph " + in("other.h5"));
    expect_failure(2, stage("cluster") + " " + in("a.h5") + " -o " + in("c.h5"));  // clusters of clusters
}

TEST_F(CommandLine, plan_and_replay_answer_and_write_nothing) {
    const std::vector<std::string> before = files();
    const Outcome plan = sh(stage("trace") + " " + box + "--plan -o " + in("x.h5"));
    EXPECT_EQ(plan.code, 0) << plan.err;
    EXPECT_NE(plan.out, "");
    const Outcome replay = sh(stage("trace") + " " + box + "--replay 8,8,0");
    EXPECT_EQ(replay.code, 0) << replay.err;
    EXPECT_NE(replay.out, "");
    EXPECT_EQ(files(), before);
}

}  // namespace
}  // namespace loom::pipeline
