// `make image` from scene to image: its files, what it remakes and when. A kill at any moment does not change the final
// result.

#include "formats/image.h"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <utility>

#include "tests/pipeline/process.h"

namespace loom::pipeline {
namespace {

const std::string small = "SCENE=scenes/cornell-box.xml DEFINES='resx=24 resy=16' ";

class MakeImage : public PipelineTest {
  protected:
    /// Runs a make that must succeed; its one line on stdout is the path of the image.
    fs::path image(const std::string& out, const std::string& variables, const std::string& prefix = "") {
        const Outcome outcome = sh(prefix + still(out, variables) + " image");
        EXPECT_EQ(outcome.code, 0) << outcome.err;
        EXPECT_EQ(outcome.out, (folder / out / "image.exr").string() + "\n");
        return folder / out / "image.exr";
    }
    /// Whether make has nothing to do.
    bool up_to_date(const std::string& out, const std::string& variables) {
        return sh(still(out, variables) + " -q " + (folder / out / "image.exr").string()).code == 0;
    }
    /// Every pixel within `relative` of its value, and the image mean within 1e-5.
    static void expect_close(const fs::path& a_path, const fs::path& b_path, float relative) {
        const Image a = read_image(a_path), b = read_image(b_path);
        ASSERT_EQ(a.width, b.width);
        ASSERT_EQ(a.height, b.height);
        for (const char* channel : {"R", "G", "B"}) {
            const auto x = a.find(channel), y = b.find(channel);
            ASSERT_EQ(x.size(), y.size());
            double sum_x = 0, sum_y = 0;
            for (std::size_t i = 0; i < x.size(); ++i) {
                EXPECT_NEAR(x[i], y[i], relative * std::max(std::abs(x[i]), 1e-3f)) << channel << " " << i;
                sum_x += x[i];
                sum_y += y[i];
            }
            EXPECT_NEAR(sum_x, sum_y, 1e-5 * sum_x) << channel;
        }
    }
};

TEST_F(MakeImage, front_door_prints_only_the_path) {
    const Outcome outcome = sh("make -s image BUILD='" + fs::path(LOOM_BIN_DIR).parent_path().string() + "' " + small +
                               "SPP=1 OUT=" + (folder / "x").string());
    EXPECT_EQ(outcome.code, 0) << outcome.err;
    EXPECT_EQ(outcome.out, (folder / "x/image.exr").string() + "\n");
}

TEST_F(MakeImage, leaves_picture_preview_and_graph_and_then_does_nothing) {
    const std::string variables = small + "SPP=2 PASSES=2";
    const fs::path exr = image("x", variables);
    const Image picture = read_image(exr);
    EXPECT_EQ(picture.width, 24u);
    EXPECT_EQ(picture.height, 16u);
    EXPECT_EQ(picture.samples, 4u);
    EXPECT_EQ(count_nonfinite(picture), 0u);
    EXPECT_TRUE(fs::exists(folder / "x/image.png"));
    EXPECT_TRUE(fs::exists(folder / "x/pathgraph/pass-1.h5"));
    EXPECT_FALSE(fs::exists(folder / "x/pathgraph/pass-0.h5"));  // gathered and gone

    EXPECT_TRUE(up_to_date("x", variables));
    EXPECT_TRUE(up_to_date("x", variables + " THREADS=1"));
    EXPECT_FALSE(up_to_date("x", variables + " SEED=7"));
    EXPECT_FALSE(up_to_date("x", small + "SPP=3 PASSES=2"));
    EXPECT_FALSE(up_to_date("x", small + "SPP=2 PASSES=3"));
    EXPECT_FALSE(up_to_date("x", variables + " METHOD=pt"));

    const std::string before = bytes_of(exr);
    const auto time = fs::last_write_time(exr);
    image("x", variables);
    EXPECT_EQ(fs::last_write_time(exr), time);
    image("x", small + "SPP=3 PASSES=2");
    EXPECT_FALSE(before == bytes_of(exr));
    image("x", variables);
    EXPECT_TRUE(before == bytes_of(exr));
}

TEST_F(MakeImage, more_passes_keep_the_finished_ones) {
    image("x", small + "SPP=1 PASSES=2");
    const auto time = fs::last_write_time(folder / "x/pathgraph/pass-0.exr");
    const std::string added = bytes_of(image("x", small + "SPP=1 PASSES=3"));
    EXPECT_EQ(fs::last_write_time(folder / "x/pathgraph/pass-0.exr"), time);
    EXPECT_TRUE(added == bytes_of(image("y", small + "SPP=1 PASSES=3")));
}

// The number of further direct-light samples that pay is estimated, with the same result each time; zero leaves nothing
// to blend.
TEST_F(MakeImage, direct_light_is_planned_from_the_passes) {
    int paid = 0, free = 0;
    for (const char* scene : {"cornell-box", "environment-map"}) {
        const std::string variables =
                              fmt::format("SCENE=scenes/{}.xml DEFINES='resx=24 resy=16' SPP=2 PASSES=4", scene),
                          name = scene;
        const fs::path exr = image(name + "-1", variables + " THREADS=1"),
                       again = image(name + "-2", variables + " THREADS=2");
        EXPECT_TRUE(bytes_of(exr) == bytes_of(again)) << scene;
        EXPECT_TRUE(up_to_date(name + "-1", variables));
        const fs::path work = folder / (name + "-1") / "pathgraph";
        const std::string samples = bytes_of(work / "direct.samples");
        (samples == "0\n" ? free : paid) += 1;
        EXPECT_EQ(fs::file_size(work / "direct.exr") == 0, samples == "0\n") << scene;
        if (samples != "0\n") {
            EXPECT_EQ(std::to_string(read_image(work / "direct.exr").samples) + "\n", samples);
        }
        // A requested number is used.
        image(name + "-1", variables + " DIRECT=6");
        EXPECT_EQ(read_image(work / "direct.exr").samples, 6u);
        EXPECT_FALSE(bytes_of(exr) == bytes_of(again)) << scene;
    }
    EXPECT_EQ(paid, 1);
    EXPECT_EQ(free, 1);
    const Outcome few =
        sh(stage("merge") + " --plan-direct " + (folder / "cornell-box-1/pathgraph/pass-0.exr").string());
    EXPECT_EQ(few.code, 2);
    EXPECT_NE(few.err.find("only a blend uses direct light; give 4 or more parts"), std::string::npos) << few.err;
}

TEST_F(MakeImage, wrong_variables_are_refused) {
    for (const char* wrong : {"METHOD=none", "SPP=0", "SPP=x", "PASSES=0", "PASSES=1.5", "SCENE=missing.xml",
                              "OUT='two words'", "DEFINES=nobody=1"}) {
        const Outcome outcome = sh(still("x", "SCENE=scenes/cornell-box.xml " + std::string(wrong)) + " image");
        EXPECT_EQ(outcome.code, 2) << wrong << "\n" << outcome.err;
        EXPECT_EQ(outcome.out, "") << wrong;
        EXPECT_FALSE(fs::exists(folder / "x/image.exr")) << wrong;
    }
}

// The two methods trace the same paths; only where they are summed up differs. The tracer computes with what the
// graph stores, so what is left is the rounding of directions taken to world space and back, which the narrowest
// lobes of glossy-box amplify.
TEST_F(MakeImage, graph_and_path_tracing_agree) {
    const std::vector<std::pair<std::string, float>> scenes = {
        {"cornell-box", 1e-5f}, {"all-emitters", 5e-5f}, {"glossy-box", 3e-4f}};
    for (const auto& [scene, relative] : scenes) {
        SCOPED_TRACE(scene);
        const std::string variables = "SCENE=scenes/" + scene + ".xml DEFINES='resx=24 resy=16' SPP=4 PASSES=2 METHOD=";
        expect_close(image(scene + "-graph", variables + "graph"), image(scene + "-pt", variables + "pt"), relative);
    }
}

TEST_F(MakeImage, passes_add_up_to_one_run) {
    expect_close(image("two", small + "METHOD=pt SPP=4 PASSES=2"), image("one", small + "METHOD=pt SPP=8"), 1e-5f);
}

TEST_F(MakeImage, parallel_make_gives_the_same_bytes) {
    const std::string variables = small + "SPP=1 PASSES=4";
    const std::string alone = bytes_of(image("a", variables));
    EXPECT_TRUE(alone == bytes_of(image("b", variables + " -j4 THREADS=1")));
}

// Each stage is killed some time after its start, again and again. At any point, make continues from the complete
// files.
TEST_F(MakeImage, killed_stages_change_nothing) {
    const std::string variables = "SCENE=scenes/cornell-box.xml DEFINES='resx=128 resy=128' SPP=4 PASSES=2";
    const std::string undisturbed = bytes_of(image("whole", variables));
    for (const char* seconds : {"0.01", "0.03", "0.06", "0.1", "0.2", "0.4"}) {
        const Outcome killed =
            sh(still("x", variables) + " LAUNCH='timeout -s KILL " + std::string(seconds) + "' image");
        EXPECT_TRUE(killed.code == 0 || !fs::exists(folder / "x/image.exr")) << seconds;
    }
    EXPECT_TRUE(undisturbed == bytes_of(image("x", variables)));
}

// A kill in the middle of a batch leaves some of its files out, or as they were before a parameter changed.
TEST_F(MakeImage, goes_on_from_a_part_of_a_batch) {
    const std::string variables = small + "SPP=1 PASSES=3";
    const std::string undisturbed = bytes_of(image("whole", variables));
    for (const std::string broken : {"clusters.h5", "h5"})
        for (const bool old : {false, true}) {
            const std::string out = broken + (old ? "-old" : "-missing");
            fs::remove(image(out, variables + " KEEP=1"));
            const fs::path passes = folder / out / "pathgraph";
            for (const std::string pass : {"pass-0.", "pass-1.", "pass-2."}) {
                for (const char* later : {"exr", "radiance.h5"}) fs::remove(passes / (pass + later));
                if (broken == "h5") fs::remove(passes / (pass + "clusters.h5"));
            }
            const fs::path last = passes / ("pass-2." + broken);
            if (old) {
                fs::last_write_time(last, fs::last_write_time(last) - std::chrono::hours(1));
            } else {
                fs::remove(last);
            }
            EXPECT_TRUE(undisturbed == bytes_of(image(out, variables))) << out;
            EXPECT_TRUE(up_to_date(out, variables)) << out;
            EXPECT_FALSE(fs::exists(passes / "pass-0.h5")) << out;
        }
}

TEST_F(MakeImage, killed_make_changes_nothing) {
    const std::string variables = "SCENE=scenes/cornell-box.xml DEFINES='resx=128 resy=128' SPP=4 PASSES=2";
    const std::string undisturbed = bytes_of(image("whole", variables));
    for (const char* seconds : {"0.05", "0.15", "0.3", "0.5"}) {
        // Kill the whole process group, as when a terminal or a batch job ends; `wait` collects it.
        sh("setsid " + still("x", variables) + " image & sleep " + seconds + "; kill -9 -$!; wait; true");
    }
    EXPECT_TRUE(undisturbed == bytes_of(image("x", variables)));
}

}  // namespace
}  // namespace loom::pipeline
