// `make derive` from scene to cube and images: what runs, with which words, and what a change of a variable remakes.
//
// Programs after loom-trace are scripts that store their words and make their outputs, so that the words can be read
// exactly; the last test runs the stages.

#include <fmt/format.h>

#include <regex>
#include <sstream>

#include "formats/transient_cube.h"
#include "tests/pipeline/process.h"

namespace loom::pipeline {
namespace {

class MakeDerive : public PipelineTest {
  protected:
    void SetUp() override {
        PipelineTest::SetUp();
        const fs::path bin = folder / "build/bin";
        fs::create_directories(bin);
        for (const char* name : {"trace", "inspect"})
            fs::create_symlink(stage(name), bin / (std::string("loom-") + name));
        for (const char* name : {"derive", "transient", "merge", "frames"}) {
            const fs::path file = bin / (std::string("loom-") + name);
            std::ofstream(file) << "#!/bin/sh\nprintf '%s\\n' loom-" << name << " \"$@\" '' >>'" << log().string()
                                << "'\nwhile [ $# -gt 0 ]; do case $1 in -o|--doppler) : >\"$2\"; esac; shift; done\n";
            fs::permissions(file, fs::perms::owner_all);
        }
    }
    fs::path log() const { return folder / "log"; }
    std::string make(const std::string& variables, const std::string& pipeline = "derive") const {
        return fmt::format(
            "make -s -f pipelines/{0}.mk BUILD={1}/build OUT={1}/x SCENE=scenes/edits.xml DEFINES='resx=8 resy=8' "
            "SPP=1 "
            "PASSES=2 {2}",
            pipeline, folder.string(), variables);
    }
    /// Makes the cube and the images.
    /// out:     the words of each script that ran, by lines
    std::vector<std::vector<std::string>> runs(const std::string& variables, const std::string& pipeline = "derive",
                                               const std::string& made = "cube.h5") {
        fs::remove(log());
        const Outcome outcome = sh(make(variables, pipeline));
        EXPECT_EQ(outcome.code, 0) << outcome.err;
        EXPECT_EQ(outcome.out, (folder / "x" / made).string() + "\n");
        traced = outcome.err.find("loom-trace: ") != std::string::npos;
        std::istringstream lines(bytes_of(log()));
        std::vector<std::vector<std::string>> commands(1);
        for (std::string line; std::getline(lines, line);) {
            if (line.empty())
                commands.emplace_back();
            else
                commands.back().push_back(line);
        }
        commands.pop_back();
        return commands;
    }
    /// Names of the scripts that ran, in their order.
    std::string names(const std::string& variables, const std::string& pipeline = "derive") {
        std::string all;
        for (const auto& command : runs(variables, pipeline))
            all += fmt::format("{}{}", all.empty() ? "" : " ", command.at(0).substr(5));
        return all;
    }
    static std::vector<std::string> values(const std::vector<std::string>& words, const std::string& option) {
        std::vector<std::string> found;
        for (std::size_t i = 0; i + 1 < words.size(); ++i)
            if (words[i] == option) found.push_back(words[i + 1]);
        return found;
    }
    bool traced = false;
};

// Detected mutations: one seed for all passes; the derivatives left out of the binning.
TEST_F(MakeDerive, chains_the_stages) {
    const auto commands = runs("WRT='x turn' EFFORT=0.25 PULSE=box LENGTH=0.1 DERIVE=--plan SEED=5 -j2");
    EXPECT_TRUE(traced);
    ASSERT_EQ(commands.size(), 4u);
    std::vector<std::string> seeds;
    for (std::size_t i = 0; i < 2; ++i) {
        const auto& words = commands[i];
        EXPECT_EQ(words[0], "loom-derive");
        EXPECT_EQ(words[1], "scenes/edits.xml");
        EXPECT_EQ(values(words, "-D"), (std::vector<std::string>{"resx=8", "resy=8"}));
        EXPECT_EQ(values(words, "--wrt"), (std::vector<std::string>{"x", "turn"}));
        EXPECT_EQ(values(words, "--effort"), std::vector<std::string>{"0.25"});
        EXPECT_NE(std::find(words.begin(), words.end(), "--plan"), words.end());
        const std::string derivative = values(words, "-o").at(0);
        EXPECT_EQ(words[2], std::regex_replace(derivative, std::regex("derivative.h5$"), "h5"));
        seeds.push_back(values(words, "--seed").at(0));
    }
    EXPECT_NE(seeds[0], seeds[1]);
    const std::string pass = (folder / "x/passes/pass-").string();
    EXPECT_EQ(commands[2],
              (std::vector<std::string>{"loom-transient", pass + "0.h5", pass + "1.h5", "--derivative",
                                        pass + "0.derivative.h5", pass + "1.derivative.h5", "--pulse", "box",
                                        "--pulse-length", "0.1", "-o", (folder / "x/cube.h5").string()}));
    EXPECT_EQ(commands[3][0], "loom-frames");
    EXPECT_NE(std::find(commands[3].begin(), commands[3].end(), "--derivatives"), commands[3].end());
    const std::string trace = bytes_of(folder / "x/passes/trace.parameters");
    for (const char* option : {"--primitives", "--media", "--sampler independent"})
        EXPECT_NE(trace.find(option), std::string::npos) << trace;
}

// Names of parameters are of the scene, which comes from anywhere.
TEST_F(MakeDerive, names_are_names) {
    const std::vector<std::string> odd{
        "shape:ball/pose", "a'b", "a\"b",  "x;touch", "PWNED", "`touch", "PWNED`",      "*", "a#b", "a=b", "%",
        "a|b>c<d&",        "(x)", "a\\nb", "!",       "{a,b}", "[ab]",   "\xc3\xa4\xff"};
    std::string wrt;
    for (const std::string& name : odd) wrt += fmt::format("{}{}", wrt.empty() ? "" : " ", name);
    const auto commands = runs("WRT=" + shell_word(wrt));
    ASSERT_EQ(commands.size(), 4u);
    for (std::size_t i = 0; i < 2; ++i) EXPECT_EQ(values(commands[i], "--wrt"), odd);
    EXPECT_EQ(names("WRT=" + shell_word(wrt)), "");
    for (const fs::path& place : {folder, folder / "x", fs::path(LOOM_SOURCE_DIR)})
        EXPECT_FALSE(fs::remove(place / "PWNED")) << place;
    for (const char* wrong :
         {"", "WRT=", "WRT='a -b'", "WRT='$(shell touch PWNED)'", "WRT='$$(touch PWNED)'", "WRT='a\nb'",
          "WRT=a EFFORT='1;touch PWNED'", "WRT=a EFFORT=much", "WRT=a DERIVE='`touch PWNED`'", "WRT=a SAMPLER='a b'"}) {
        const Outcome outcome = sh(make(wrong));
        EXPECT_EQ(outcome.code, 2) << wrong << "\n" << outcome.err;
        EXPECT_EQ(outcome.out, "") << wrong;
    }
    EXPECT_FALSE(fs::remove(LOOM_SOURCE_DIR "/PWNED"));
}

TEST_F(MakeDerive, remakes_what_depends_on_a_change) {
    const std::string all = "derive derive transient frames";
    EXPECT_EQ(names("WRT='x turn'"), all);
    EXPECT_EQ(names("WRT='x turn'"), "");
    EXPECT_FALSE(traced);
    // Other parameters, their effort, another seed.
    EXPECT_EQ(names("WRT=x"), all);
    EXPECT_FALSE(traced);
    EXPECT_EQ(names("WRT=x EFFORT=1"), all);
    EXPECT_FALSE(traced);
    // Another pulse or window.
    EXPECT_EQ(names("WRT=x EFFORT=1 PULSE=gaussian LENGTH=1"), "transient frames");
    EXPECT_FALSE(traced);
    EXPECT_EQ(names("WRT=x EFFORT=1 PULSE=gaussian LENGTH=1 DRAW="), "frames");
    // One more pass; a derivative that is gone, as after a killed run; other paths.
    EXPECT_EQ(names("WRT=x EFFORT=1 PULSE=gaussian LENGTH=1 DRAW= PASSES=3"), "derive transient frames");
    EXPECT_TRUE(traced);
    fs::remove(folder / "x/passes/pass-1.derivative.h5");
    fs::remove(folder / "x/cube.h5");
    EXPECT_EQ(names("WRT=x EFFORT=1 PULSE=gaussian LENGTH=1 DRAW= PASSES=3"), "derive transient frames");
    EXPECT_FALSE(traced);
    EXPECT_EQ(names("WRT=x SEED=1"), all);
    EXPECT_TRUE(traced);
    // A cube of make transient in the same folder replaces this one, and this one that.
    EXPECT_EQ(names("", "transient"), "transient frames");
    EXPECT_EQ(names("WRT=x SEED=1"), "transient frames");
    EXPECT_EQ(names("", "transient"), "transient frames");
}

TEST_F(MakeDerive, graphs_that_go_are_derived_before) {
    EXPECT_EQ(names("WRT=x KEEP=0"), "derive transient derive transient merge frames");
    for (const char* name : {"pass-0.h5", "pass-0.derivative.h5", "pass-1.h5"})
        EXPECT_FALSE(fs::exists(folder / "x/passes" / name)) << name;
    EXPECT_EQ(names("WRT=x KEEP=0"), "");
    EXPECT_EQ(names("WRT=x KEEP=0 PASSES=3"), "derive transient merge frames");
    EXPECT_EQ(names("WRT=turn KEEP=0 PASSES=1"), "derive transient merge frames");
    EXPECT_TRUE(traced);
}

TEST_F(MakeDerive, results_have_a_folder_of_their_own) {
    const auto printed = [&](const std::string& pipeline) {
        return sh("make -n -f pipelines/" + pipeline +
                  ".mk SCENE=scenes/edits.xml WRT=x BUILD=" + (folder / "build").string())
            .out;
    };
    EXPECT_NE(printed("derive").find("echo out/edits/derive/cube.h5"), std::string::npos);
    EXPECT_NE(printed("transient").find("echo out/edits/cube.h5"), std::string::npos);
}

// Detected mutations: the graph of one pass alone; speeds without their names.
TEST_F(MakeDerive, doppler_takes_all_graphs) {
    const auto commands = runs("WRT='x turn' DOPPLER=1 SPEED='x=2 turn=-1' CHIRP=1e14", "derive", "doppler.h5");
    ASSERT_EQ(commands.size(), 2u);
    EXPECT_EQ(commands[0][0], "loom-derive");
    EXPECT_EQ(values(commands[0], "--speed"), (std::vector<std::string>{"x=2", "turn=-1"}));
    EXPECT_EQ(values(commands[0], "--chirp"), std::vector<std::string>{"1e14"});
    EXPECT_EQ(commands[0][2], (folder / "x/passes/pass-0.h5").string());
    EXPECT_EQ(values(commands[0], "--with"), std::vector<std::string>{(folder / "x/passes/pass-1.h5").string()});
    EXPECT_EQ(commands[1][0], "loom-frames");
    EXPECT_EQ(runs("WRT='x turn' DOPPLER=1 SPEED='x=2 turn=-1' CHIRP=2e14", "derive", "doppler.h5").size(), 2u);
    EXPECT_FALSE(traced);
    EXPECT_NE(sh(make("WRT=x DOPPLER=1 KEEP=0")).code, 0);
}

// The stages themselves. Detected mutation: loom-merge leaves the derivatives of merged cubes at zero.
TEST_F(MakeDerive, front_door_makes_a_cube_with_derivatives_and_their_images) {
    if (!fs::exists(stage("derive"))) GTEST_SKIP() << "loom-derive is not built";
    const std::string run = "make -s derive BUILD='" + fs::path(LOOM_BIN_DIR).parent_path().string() +
                            "' SCENE=scenes/edits.xml WRT='x turn' DEFINES='resx=8 resy=8' SPP=4 PASSES=2 BINS=20 "
                            "START=3 WIDTH=0.5 PULSE=box LENGTH=0.5 OUT=";
    for (const char* out : {"x", "y"}) {
        const Outcome outcome = sh(run + (folder / out).string() + (*out == 'y' ? " KEEP=0" : ""));
        EXPECT_EQ(outcome.code, 0) << outcome.err;
        EXPECT_EQ(outcome.out, (folder / out / "cube.h5").string() + "\n");
    }
    const TransientCube together = read_transient_cube(folder / "x/cube.h5"),
                        merged = read_transient_cube(folder / "y/cube.h5");
    EXPECT_EQ(together.parameters.name, (std::vector<std::string>{"x", "turn"}));
    EXPECT_EQ(merged.parameters.name, together.parameters.name);
    ASSERT_EQ(merged.derivative.bins.size(), together.derivative.bins.size());
    double size = 0;
    for (const float d : together.derivative.bins) size = std::max(size, double(std::abs(d)));
    EXPECT_GT(size, 0);
    for (std::size_t i = 0; i < merged.derivative.bins.size(); ++i)
        EXPECT_NEAR(merged.derivative.bins[i], together.derivative.bins[i], 1e-5 * size) << i;
    for (const char* image : {"strip.png", "derivative-x/strip.png", "derivative-turn/strip.png",
                              "derivative-x/streak-x.png", "derivative-x/streak-y.png", "derivative-x/steady.png",
                              "derivative-x/curves.svg", "derivative-x/frames/frame-0019.png"})
        EXPECT_TRUE(fs::exists(folder / "x" / image)) << image;
}

}  // namespace
}  // namespace loom::pipeline
