// The command line of every stage: exit codes, range checks, the text that reaches the outputs, progress.

#include <gtest/gtest.h>

#include <cstdio>
#include <filesystem>
#include <fstream>
#include <stdexcept>
#include <thread>

#include "formats/io/error.h"
#include "stages/core/app/command.h"

namespace loom::app {
namespace {

enum class Rule { albedo, throughput };

struct Options {
    std::string scene, output;
    std::vector<std::string> defines;
    std::uint64_t seed = 0;
    int spp = 4;
    int threads = 0;
    double exposure = 0;
    std::optional<int> max_depth;
    bool plan = false;
    Rule rule = Rule::albedo;
};

/// A command with every kind of option, run on the given words; its output is kept.
struct Tried {
    Options options;
    int code = -1;
    std::string out, err, command;

    template <class Body>
    Tried(std::vector<std::string> words, Body body) {
        Command command_line{"try: a stage for the tests"};
        command_line.file("scene", options.scene, "scene file").required();
        command_line.output("-o,--output", options.output, "graph to write");
        command_line.option("-D,--define", options.defines, "name=value");
        command_line.option("--seed", options.seed, "seed");
        command_line.option("--spp", options.spp, "samples", Range<int>{1, 65536});
        command_line.option("--exposure", options.exposure, "exposure", Range<double>{-20, 20, "EV"});
        command_line.option("--max-depth", options.max_depth, "depth", Range<int>{-1, 1000});
        command_line.flag("--plan", options.plan, "plan");
        command_line.choice<Rule>("--roulette", options.rule, "rule",
                                  {{"albedo", Rule::albedo}, {"throughput", Rule::throughput}});
        command_line.threads(options.threads);
        words.insert(words.begin(), "./loom-try");
        std::vector<char*> argv;
        for (std::string& word : words) argv.push_back(word.data());
        testing::internal::CaptureStdout();
        testing::internal::CaptureStderr();
        code =
            command_line.execute(static_cast<int>(argv.size()), argv.data(), [&] { return body(command_line.report); });
        err = testing::internal::GetCapturedStderr();
        out = testing::internal::GetCapturedStdout();
        command = command_line.report.command();
    }
    explicit Tried(const std::vector<std::string>& words) : Tried(words, [](Report&) {}) {}
};

class App : public testing::Test {
  protected:
    void SetUp() override {
        folder = std::filesystem::temp_directory_path() / ("loom-app-" + std::to_string(getpid()));
        std::filesystem::create_directories(folder);
        scene = folder / "a scene.xml";
        std::ofstream(scene) << "<scene/>";
    }
    void TearDown() override { std::filesystem::remove_all(folder); }

    std::filesystem::path folder;
    std::string scene;
};

TEST_F(App, exit_codes) {
    EXPECT_EQ(Tried({scene}).code, 0);
    EXPECT_EQ(Tried({scene}, [](Report&) { return 1; }).code, 1);
    EXPECT_EQ(Tried({scene}, [](Report&) { throw InputError("bad"); }).code, 2);
    EXPECT_EQ(Tried({scene}, [](Report&) { throw std::runtime_error("odd"); }).code, 3);
    EXPECT_EQ(Tried({scene}, [](Report&) { throw std::bad_alloc(); }).code, 3);
    EXPECT_EQ(Tried({"--help"}).code, 0);
    EXPECT_EQ(Tried({"--version"}).code, 0);
}

TEST_F(App, wrong_command_lines_are_2_and_run_nothing) {
    const std::vector<std::vector<std::string>> wrong = {
        {},
        {scene, "--unknown"},
        {scene, "second"},
        {scene, "--spp"},
        {scene, "--spp", "0"},
        {scene, "--spp", "65537"},
        {scene, "--spp", "4x"},
        {scene, "--spp", "4.0"},
        {scene, "--spp", ""},
        {scene, "--spp", "99999999999999999999"},
        {scene, "--spp", "4", "--spp", "8"},
        {scene, "--seed", "-1"},
        {scene, "--exposure", "nan"},
        {scene, "--exposure", "inf"},
        {scene, "--exposure", "1,5"},
        {scene, "--roulette", "none"},
        {scene, "--threads", "-2"},
        {folder / "missing.xml"},
        {folder},
        {scene, "-o", folder / "nowhere" / "x.h5"},
        {scene, "-o", folder},
    };
    for (const auto& words : wrong) {
        bool ran = false;
        const Tried run(words, [&](Report&) { ran = true; });
        EXPECT_EQ(run.code, 2) << testing::PrintToString(words);
        EXPECT_FALSE(ran) << testing::PrintToString(words);
        EXPECT_EQ(run.out, "") << testing::PrintToString(words);
        EXPECT_NE(run.err.find("loom-try: error: "), std::string::npos) << run.err;
        EXPECT_LT(run.err.size(), 400u) << run.err;
    }
}

TEST_F(App, messages_name_the_flag_and_the_range) {
    EXPECT_NE(Tried({scene, "--spp", "0"}).err.find("--spp: 0 is not in 1 to 65536"), std::string::npos);
    EXPECT_NE(Tried({scene, "--roulette", "none"}).err.find("--roulette: 'none' is not one of albedo|throughput"),
              std::string::npos);
}

TEST_F(App, values_arrive) {
    const Tried run({"-Dresx=4", "-D", "resy=8", scene, "--seed", "18446744073709551615", "--exposure", "-1.5",
                     "--max-depth=7", "--plan", "--roulette", "throughput"});
    ASSERT_EQ(run.code, 0) << run.err;
    EXPECT_EQ(run.options.defines, (std::vector<std::string>{"resx=4", "resy=8"}));
    EXPECT_EQ(run.options.seed, 18446744073709551615u);
    EXPECT_EQ(run.options.exposure, -1.5);
    EXPECT_EQ(run.options.max_depth, 7);
    EXPECT_TRUE(run.options.plan);
    EXPECT_EQ(run.options.rule, Rule::throughput);
}

TEST_F(App, files_take_many) {
    std::vector<std::string> inputs;
    std::string output;
    Command command{"join: a stage with many inputs"};
    command.files("inputs", inputs, "inputs").required();
    command.output("-o,--output", output, "output");
    std::vector<std::string> words = {"loom-join", scene, scene, scene, "-o", folder / "x.exr", "--quiet"};
    std::vector<char*> argv;
    for (std::string& word : words) argv.push_back(word.data());
    EXPECT_EQ(command.execute(static_cast<int>(argv.size()), argv.data(), [] {}), 0);
    EXPECT_EQ(inputs.size(), 3u);
    EXPECT_EQ(output, folder / "x.exr");
}

// The text goes into the output: options of location or speed must not, or equal inputs would give different bytes.
TEST_F(App, command_text_has_defaults_but_no_place) {
    EXPECT_EQ(Tried({scene, "--threads", "2", "-o", folder / "x.h5", "--quiet"}).command,
              "loom-try 'a scene.xml' --seed 0 --spp 4 --exposure 0 --roulette albedo");
    EXPECT_EQ(Tried({scene, "--max-depth", "3", "--plan", "-Dmap=/data/sky.exr", "-D", "size=0.1"}).command,
              "loom-try 'a scene.xml' --define map=sky.exr --define size=0.1 --seed 0 --spp 4 --exposure 0 "
              "--max-depth 3 --plan --roulette albedo");
}

TEST_F(App, options_are_printed_unless_quiet) {
    const Tried loud({scene, "--threads", "2"}, [](Report& report) { report.done("{} paths", 12); });
    EXPECT_NE(loud.err.find("--spp 4"), std::string::npos);
    EXPECT_NE(loud.err.find("--threads 2"), std::string::npos);
    EXPECT_NE(loud.err.find("done: 12 paths in "), std::string::npos);
    const Tried quiet({scene, "--quiet"}, [](Report& report) {
        report.info("said");
        Progress progress(report, "work", 100);
        progress.add(100);
        report.answer("42\n");
        report.done("{} paths", 12);
    });
    EXPECT_EQ(quiet.err, "");
    EXPECT_EQ(quiet.out, "42\n");
    EXPECT_NE(Tried({scene, "--quiet"}, [](Report& report) { report.warn("odd"); }).err.find("warning: odd"),
              std::string::npos);
}

std::vector<std::string> lines_of(const std::string& text) {
    std::vector<std::string> lines;
    for (std::size_t at = 0; at < text.size(); at = text.find('\n', at) + 1)
        lines.push_back(text.substr(at, text.find('\n', at) - at));
    return lines;
}

TEST_F(App, progress_prints_each_tenth_once_from_any_thread) {
    testing::internal::CaptureStderr();
    {
        Report report("loom-try");
        Progress progress(report, "work", 100003);
        std::vector<std::thread> threads;
        for (int t = 0; t < 4; ++t)
            threads.emplace_back([&, t] {
                for (int i = t; i < 100003; i += 4) progress.add();
            });
        for (std::thread& thread : threads) thread.join();
        EXPECT_EQ(progress.done(), 100003u);
    }
    const std::vector<std::string> lines = lines_of(testing::internal::GetCapturedStderr());
    // A slow thread may find its tenth already printed by a faster one; none is printed twice or out of order.
    ASSERT_GE(lines.size(), 2u);
    ASSERT_LE(lines.size(), 10u);
    int last = 0;
    for (const std::string& line : lines) {
        int tenth = 0;
        ASSERT_EQ(std::sscanf(line.c_str(), "loom-try: work %d %%", &tenth), 1) << line;
        EXPECT_GT(tenth, last);
        last = tenth;
    }
    EXPECT_EQ(last, 100);
}

TEST_F(App, progress_of_few_or_large_steps) {
    testing::internal::CaptureStderr();
    {
        Report report("loom-try");
        Progress three(report, "three", 3);
        for (int i = 0; i < 3; ++i) three.add();
        Progress none(report, "none", 0);
        Progress at_once(report, "once", UINT64_MAX / 2);
        at_once.add(UINT64_MAX / 2);
    }
    const std::vector<std::string> lines = lines_of(testing::internal::GetCapturedStderr());
    ASSERT_EQ(lines.size(), 4u);
    EXPECT_TRUE(lines[0].starts_with("loom-try: three 30 %"));
    EXPECT_TRUE(lines[1].starts_with("loom-try: three 60 %"));
    EXPECT_TRUE(lines[2].starts_with("loom-try: three 100 %"));
    EXPECT_TRUE(lines[3].starts_with("loom-try: once 100 %"));
}

TEST_F(App, usage_counts) {
    Report report;
    volatile double sum = 0;
    for (int i = 0; i < 20'000'000; ++i) sum = sum + i;
    const Usage used = report.usage();
    EXPECT_GT(used.wall_s, 0);
    EXPECT_GT(used.cpu_s, 0);
    EXPECT_GT(used.peak_memory_bytes, 1u << 20);
    EXPECT_LT(used.peak_memory_bytes, std::uint64_t{1} << 40);
    EXPECT_EQ(report.cost().stage, "loom");
    EXPECT_GE(report.cost().wall_s, used.wall_s);
}

// Detected mutation: every occurrence replaced.
TEST_F(App, commands_of_parts) {
    const std::string command = "loom-cluster a.h5 b.h5 --k 8 --seed 3";
    EXPECT_EQ(command_of_part(command, {{" a.h5 b.h5", " b.h5"}, {" --seed 3", " --seed 4"}, {" --with c.h5", ""}}),
              "loom-cluster b.h5 --k 8 --seed 4");
    EXPECT_EQ(command_of_part("loom-x 1 1", {{" 1", ""}}), "loom-x 1");
}

TEST_F(App, texts) {
    EXPECT_EQ(duration_text(0.05), "50 ms");
    EXPECT_EQ(duration_text(12.34), "12.3 s");
    EXPECT_EQ(duration_text(245), "4 min 05 s");
    EXPECT_EQ(duration_text(7800), "2 h 10 min");
    EXPECT_EQ(bytes_text(512), "512 B");
    EXPECT_EQ(bytes_text(3565158), "3.4 MiB");
    EXPECT_EQ(shell_word("plain-1.0_x=2"), "plain-1.0_x=2");
    EXPECT_EQ(shell_word("it's"), "'it'\\''s'");
    EXPECT_EQ(shell_word(""), "''");
}

}  // namespace
}  // namespace loom::app
