// `make animation`: which frames a change of the table, of the scene or of a variable remakes.
#include <fmt/format.h>

#include <algorithm>
#include <regex>
#include <set>

#include "tests/pipeline/process.h"

namespace loom::pipeline {
namespace {

using Numbers = std::set<int>;

class MakeAnimation : public PipelineTest {
  protected:
    std::string table = "f.tsv";

    static std::string row(int number, const std::string& x) { return fmt::format("{}\t{}\t0.3\n", number, x); }
    void write(const std::string& rows, const std::string& head = "frame\tx\ty\n") {
        std::ofstream(folder / table) << head << rows;
    }
    Outcome make(const std::string& variables = "", const std::string& out = "x") const {
        return sh(
            fmt::format("make -s -f pipelines/animation.mk BUILD='{}' OUT='{}' FRAMES={} SPP=2 BASE_SPP=2 "
                        "DEFINES='resx=12 resy=8' {}",
                        fs::path(stage("trace")).parent_path().parent_path().string(), (folder / out).string(),
                        named(table), variables));
    }
    /// Makes the frames.
    /// out:     the numbers of those that were rendered; `traced` says whether the base was made
    Numbers frames(const std::string& variables = "", const std::string& out = "x") {
        const Outcome outcome = make(variables, out);
        EXPECT_EQ(outcome.code, 0) << outcome.err;
        const fs::path movie = folder / out / "movie.mp4";
        EXPECT_EQ(outcome.out, (fs::exists(movie) ? movie : folder / out / "frames").string() + "\n");
        traced = outcome.err.find("loom-trace: done: static") != std::string::npos;
        Numbers numbers;
        const std::regex done("loom-(residual|trace): done: frame-([0-9]+)[.]exr");
        for (std::sregex_iterator m(outcome.err.begin(), outcome.err.end(), done), end; m != end; ++m)
            EXPECT_TRUE(numbers.insert(std::stoi((*m)[2])).second) << (*m)[0];
        return numbers;
    }
    fs::path image(int number, const std::string& out = "x") const {
        return folder / out / fmt::format("images/frame-{:04}.exr", number);
    }
    std::string named(const std::string& name) const { return shell_word((folder / name).string()); }
    bool traced = false;
};

TEST_F(MakeAnimation, remakes_the_frames_that_change) {
    const std::string head = row(0, "-0.5") + row(1, "-0.2"), tail = row(3, "0.3") + row(4, "0.5");
    write(head + row(2, "0") + tail);
    EXPECT_EQ(frames(), Numbers({0, 1, 2, 3, 4}));
    EXPECT_TRUE(traced);
    EXPECT_TRUE(fs::exists(folder / "x/strip.png"));
    EXPECT_TRUE(fs::exists(folder / "x/frames/frame-0004.png"));
    EXPECT_EQ(frames(), Numbers());
    // An edited row, twice; rows in another order; a row that is added, and one that goes.
    write(head + row(2, "0.1") + tail);
    EXPECT_EQ(frames(), Numbers({2}));
    EXPECT_EQ(frames(), Numbers());
    EXPECT_FALSE(traced);
    write(tail + "\n" + row(2, "0.1") + head);
    EXPECT_EQ(frames(), Numbers());
    write(head + row(2, "0.1") + tail + row(108, "0.4"));
    EXPECT_EQ(frames(), Numbers({108}));
    write(head + tail);
    EXPECT_EQ(frames(), Numbers());
    EXPECT_FALSE(traced);
    EXPECT_FALSE(fs::exists(folder / "x/frames/frame-0004.png"));
    // As many frames, of which one is another that is there.
    write(head + row(2, "0.1") + tail);
    EXPECT_EQ(frames(), Numbers());
    const std::string strip = bytes_of(folder / "x/strip.png");
    write(head + tail + row(108, "0.4"));
    EXPECT_EQ(frames(), Numbers());
    EXPECT_NE(bytes_of(folder / "x/strip.png"), strip);
    write(head + tail);
    EXPECT_EQ(frames(), Numbers());
    // A frame without its hash, as after a killed run; one that is gone.
    fs::remove(folder / "x/images/frame-0003.hash");
    fs::remove(image(4));
    EXPECT_EQ(frames(), Numbers({3, 4}));
    // Batches of two graphs, and of one frame, have the same bytes as all made anew.
    EXPECT_EQ(frames("BATCH=1 THREADS=1", "y"), Numbers({0, 1, 3, 4}));
    for (const int number : {0, 1, 3, 4}) EXPECT_EQ(bytes_of(image(number)), bytes_of(image(number, "y"))) << number;
    // Another base, other graphs.
    EXPECT_EQ(frames("BASE_SPP=3"), Numbers({0, 1, 3, 4}));
    EXPECT_TRUE(traced);
    EXPECT_EQ(frames("BASE_SPP=3 GRAPHS=1"), Numbers({0, 1, 3, 4}));
    EXPECT_EQ(frames("BASE_SPP=3 GRAPHS=1 FPS=12"), Numbers());
}

TEST_F(MakeAnimation, traces_frames_by_themselves_and_denoises) {
    const std::string head = row(0, "-0.5"), tail = row(3, "0.3");
    write(head + row(2, "0") + tail);
    EXPECT_EQ(frames("METHOD=pt"), Numbers({0, 2, 3}));
    EXPECT_FALSE(traced);
    EXPECT_EQ(frames("METHOD=pt"), Numbers());
    write(head + row(2, "0.1") + tail);
    EXPECT_EQ(frames("METHOD=pt"), Numbers({2}));
    EXPECT_EQ(frames("METHOD=pt BATCH=1 THREADS=1", "y"), Numbers({0, 2, 3}));
    for (const int number : {0, 2, 3}) EXPECT_EQ(bytes_of(image(number)), bytes_of(image(number, "y"))) << number;
    EXPECT_FALSE(fs::exists(folder / "x/base"));
    const std::string noisy = bytes_of(folder / "x/frames/frame-0002.png");
    EXPECT_EQ(frames("METHOD=pt DENOISE=1"), Numbers());
    EXPECT_TRUE(fs::exists(folder / "x/denoised/frame-0003.exr"));
    EXPECT_NE(bytes_of(folder / "x/frames/frame-0002.png"), noisy);
    // Other samples, another method.
    EXPECT_EQ(frames("METHOD=pt SPP=3"), Numbers({0, 2, 3}));
    EXPECT_EQ(frames(), Numbers({0, 2, 3}));
    EXPECT_TRUE(traced);
    const Outcome wrong = make("METHOD=magic");
    EXPECT_EQ(wrong.code, 2);
    EXPECT_NE(wrong.err.find("expected hybrid or pt"), std::string::npos) << wrong.err;
    // By hand: no number in the name, a graph, both tables.
    const std::string run = "'" + stage("trace") + "' scenes/animated/ball.xml --spp 1 --frames '" +
                            (folder / table).string() + "' -o '" + folder.string();
    for (const auto& [rest, said] : {std::pair("/z.exr'", "needs a %"), std::pair("/z-%.h5'", "one image (.exr)"),
                                     std::pair("/z-%.exr' --passes 2", "one image (.exr)"),
                                     std::pair("/z-%.exr' --only 9:12", "no frame with such a number"),
                                     std::pair("/z-%.exr' --static scenes/animated/ball.tsv", "leave out --static")}) {
        const Outcome outcome = sh(run + rest);
        EXPECT_EQ(outcome.code, 2) << rest;
        EXPECT_NE(outcome.err.find(said), std::string::npos) << outcome.err;
    }
}

TEST_F(MakeAnimation, plans_the_samples_of_what_frames_share) {
    const auto plan = [&](const std::string& name) {
        std::smatch found;
        const std::string text = bytes_of(folder / "x/plan.txt");
        return std::regex_search(text, found, std::regex("(?:^|\n)" + name + ": (.*)")) ? found[1].str() : "";
    };
    std::string rows;
    Numbers all;
    for (int i = 0; i < 40; ++i) rows += row(i, fmt::format("{:.3f}", -0.5 + 0.02 * i)), all.insert(i);
    write(rows);
    EXPECT_EQ(frames("BASE_SPP=auto DEFINES='resx=24 resy=18'"), all);
    EXPECT_TRUE(traced);
    EXPECT_EQ(plan("method"), "hybrid");
    EXPECT_GT(std::stoi(plan("samples of the static image")), 2);
    EXPECT_LE(std::stoi(plan("samples of the static image")), 2 * 40);
    EXPECT_GT(std::stod(plan("gain over path tracing of equal error")), 2);
    EXPECT_EQ(frames("BASE_SPP=auto DEFINES='resx=24 resy=18'"), Numbers());
    // A single frame shares nothing with others.
    write(row(0, "0"));
    EXPECT_EQ(frames("BASE_SPP=auto"), Numbers({0}));
    EXPECT_FALSE(traced);
    EXPECT_EQ(plan("method"), "pt");
    // A plan that says nothing, and make -n without one.
    std::ofstream(folder / "x/plan.txt") << "\n";
    EXPECT_NE(make("BASE_SPP=auto").err.find("remove it"), std::string::npos);
    EXPECT_EQ(make("BASE_SPP=auto -n", "y").code, 0);
    EXPECT_FALSE(fs::exists(folder / "y"));
    EXPECT_EQ(make("BASE_SPP=most").code, 2);
}

TEST_F(MakeAnimation, takes_any_name_of_a_table_and_no_wrong_one) {
    table = "it's a; touch PWNED.tsv";
    write(row(0, "0") + row(1, "0.1"));
    EXPECT_EQ(frames(), Numbers({0, 1}));
    for (const auto& [rows, said] :
         {std::pair(row(0, "0") + row(0, "0.1"), "frame 0 is there twice"), std::pair(row(-1, "0"), "frame '-1'"),
          std::pair(row(0, "$(touch PWNED)"), "x"), std::pair(std::string("0\t1\n"), ":2")}) {
        write(rows);
        const Outcome outcome = make();
        EXPECT_EQ(outcome.code, 2) << rows << outcome.err;
        EXPECT_NE(outcome.err.find(said), std::string::npos) << outcome.err;
        EXPECT_EQ(outcome.out, "");
    }
    for (const char* wrong : {"GRAPHS=0", "BATCH=0", "FPS=many", "SPP='1;touch PWNED'", "DRAW='`touch PWNED`'"})
        EXPECT_EQ(make(wrong).code, 2) << wrong;
    for (const fs::path& place : {folder, fs::path(LOOM_SOURCE_DIR)}) EXPECT_FALSE(fs::exists(place / "PWNED"));
}

TEST_F(MakeAnimation, is_compared_with_a_reference_over_time) {
    write(row(0, "-0.5") + row(1, "-0.2") + row(7, "0.3"));
    frames("METHOD=pt", "a");
    frames("METHOD=pt SEED=5", "reference");
    const auto compare = [&](const std::string& options) {
        return sh(stage("compare") + " --quiet " + options + " --reference " + named("reference/images/frame-%.exr"));
    };
    const std::string a = " ours=" + named("a/images/frame-%.exr");
    const Outcome table = compare("--sequence --tsv" + a);
    ASSERT_EQ(table.code, 0) << table.err;
    EXPECT_TRUE(table.out.starts_with("method\tframe\trelmse\tflicker\tfrozen\t")) << table.out;
    EXPECT_EQ(std::count(table.out.begin(), table.out.end(), '\n'), 4);
    EXPECT_NE(table.out.find("\nours\t7\t"), std::string::npos) << table.out;
    const Outcome same =
        sh(stage("compare") + " --quiet --sequence" + a + " --reference " + named("a/images/frame-%.exr"));
    EXPECT_NE(same.out.find("ours         3  0 "), std::string::npos) << same.out;
    const Outcome spectrum = compare("--spectrum" + a);
    EXPECT_EQ(std::count(spectrum.out.begin(), spectrum.out.end(), '\n'), 3) << spectrum.out;
    // What does not fit.
    fs::remove(image(7, "a"));
    const Outcome missing = compare("--sequence" + a);
    EXPECT_EQ(missing.code, 2);
    EXPECT_NE(missing.err.find("has no frame 7"), std::string::npos) << missing.err;
    EXPECT_EQ(compare("--sequence --json" + a).code, 2);
    EXPECT_EQ(compare("--sequence " + named("a/images/frame-0000.exr")).code, 2);
}

}  // namespace
}  // namespace loom::pipeline
