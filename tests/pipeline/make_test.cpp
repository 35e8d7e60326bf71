// Dependencies and checks of make: contents of files at any times, names with any character, values of variables that
// are checked before a shell gets them, missing packages.

#include <fmt/format.h>

#include <regex>
#include <set>
#include <sstream>
#include <utility>

#include "tests/pipeline/process.h"

namespace loom::pipeline {
namespace {

using std::chrono::hours;

std::string build_folder() {
    return fs::path(LOOM_BIN_DIR).parent_path().string();
}

/// A sky, and a mesh before it.
std::string scene_of(const std::string& mesh, const std::string& more = "") {
    return R"(<scene version="3.0.0"><sensor type="perspective"><film type="hdrfilm"><integer name="width" value="8"/>
<integer name="height" value="8"/></film></sensor><emitter type="constant"/>)" +
           more + R"(<shape type="obj"><string name="filename" value=")" + mesh + R"("/></shape></scene>)";
}
std::string triangle(double size) {
    return fmt::format("v {0} {0} 3\nv -{0} {0} 3\nv 0 -{0} 3\nf 1 2 3\n", size);
}

class Make : public PipelineTest {
  protected:
    void write(const std::string& name, const std::string& text) const {
        std::ofstream(folder / name, std::ios::binary) << text;
    }
    std::string in(const std::string& name) const { return (folder / name).string(); }
    /// A write, and the modification time that the file had before.
    void write_unseen(const std::string& name, const std::string& text) const {
        const auto time = fs::last_write_time(folder / name);
        write(name, text);
        fs::last_write_time(folder / name, time);
    }
};

class MakeContents : public Make {
  protected:
    void SetUp() override {
        Make::SetUp();
        write("a.obj", triangle(1));
        write("part.xml",
              R"(<scene version="3.0.0"><emitter type="point"><rgb name="intensity" value="1"/></emitter></scene>)");
        write("s.xml", scene_of("a.obj", R"(<include filename="part.xml"/>)"));
    }
    std::string still_of(const std::string& out) const { return still(out, "METHOD=pt SPP=1 SCENE=" + in("s.xml")); }
    /// Makes the image; whether it was traced again.
    bool traces() const {
        const Outcome outcome = sh(still_of("x") + " image");
        EXPECT_EQ(outcome.code, 0) << outcome.err;
        return outcome.err.find("loom-trace: ") != std::string::npos;
    }
    std::string image() const { return bytes_of(folder / "x/image.exr"); }
    /// Returns the folder that an empty OUT gives.
    std::string anew() const {
        fs::remove_all(folder / "anew");
        EXPECT_EQ(sh(still_of("anew") + " image").code, 0);
        return bytes_of(folder / "anew/image.exr");
    }
};

TEST_F(MakeContents, decide_and_times_do_not) {
    EXPECT_TRUE(traces());
    const std::string first = image();
    EXPECT_FALSE(traces());

    // Times alone.
    for (const char* file : {"a.obj", "part.xml", "s.xml"}) {
        fs::last_write_time(folder / file, fs::file_time_type::clock::now() + hours(1));
        EXPECT_FALSE(traces()) << file;
    }
    // A mesh of the same size and time.
    write_unseen("a.obj", triangle(2));
    EXPECT_TRUE(traces());
    EXPECT_FALSE(image() == first);
    EXPECT_TRUE(image() == anew());
    // An older file moved into place, and the first one back.
    write("older.obj", triangle(1));
    fs::last_write_time(folder / "older.obj", fs::file_time_type::clock::now() - hours(10000));
    fs::rename(folder / "older.obj", folder / "a.obj");
    EXPECT_TRUE(traces());
    EXPECT_TRUE(image() == first);
    // A link that points elsewhere.
    write("wide.obj", triangle(3));
    fs::last_write_time(folder / "wide.obj", fs::file_time_type::clock::now() - hours(10000));
    fs::rename(folder / "a.obj", folder / "first.obj");
    fs::create_symlink("first.obj", folder / "a.obj");
    EXPECT_FALSE(traces());
    fs::remove(folder / "a.obj");
    fs::create_symlink("wide.obj", folder / "a.obj");
    EXPECT_TRUE(traces());
    EXPECT_TRUE(image() == anew());
    // An included file, and the scene itself.
    write_unseen("part.xml",
                 R"(<scene version="3.0.0"><emitter type="point"><rgb name="intensity" value="9"/></emitter></scene>)");
    EXPECT_TRUE(traces());
    write_unseen("s.xml", scene_of("first.obj"));
    EXPECT_TRUE(traces());
    EXPECT_TRUE(image() == anew());
    // A file that is gone is the scene's error.
    fs::remove(folder / "first.obj");
    const Outcome gone = sh(still_of("x") + " image");
    EXPECT_EQ(gone.code, 2);
    EXPECT_NE(gone.err.find("s.xml:"), std::string::npos) << gone.err;
    EXPECT_NE(gone.err.find("first.obj"), std::string::npos) << gone.err;
}

// The graphs of finished passes are deleted; their inputs are still dependencies.
TEST_F(MakeContents, of_path_graphs_cubes_and_edits) {
    const std::string picture = "SPP=1 PASSES=1 SCENE=" + in("s.xml");
    const std::string graph = still("g", picture) + " " + in("g/image.exr");
    const std::string cube = "make -s -f pipelines/transient.mk BUILD=" + build_folder() +
                             " PASSES=1 SPP=1 KEEP=0 BINS=4 START=0 WIDTH=1 PULSE=table TRANSIENT='--pulse-table " +
                             in("pulse.txt") + "' SCENE=" + in("s.xml") + " OUT=" + in("c") + " " + in("c/cube.h5");
    const std::string edit = "make -s -f pipelines/edit.mk BUILD=" + build_folder() +
                             " METHOD=correlated SPP=2 BASE_SPP=2 OLD=" + in("s.xml") + " NEW=" + in("new.xml") +
                             " BASE=" + in("base") + " OUT=" + in("e") + " " + in("e/new.exr");
    const std::string chain = "make -s -f pipelines/edit.mk BUILD=" + build_folder() +
                              " METHOD=correlated SPP=2 OLD=" + in("new.xml") + " NEW=" + in("s.xml") +
                              " OLD_IMAGE=" + shell_word(in("before it.exr")) + " BASE=" + in("base") +
                              " OUT=" + in("f") + " " + in("f/new.exr");
    const auto stale = [&](const std::string& make) { return sh(make + " -q").code != 0; };
    write("pulse.txt", "0 1\n1 1\n");
    write("b.obj", triangle(1.5));
    write("new.xml", scene_of("b.obj"));
    for (const std::string& make : {graph, cube, edit}) {
        const Outcome outcome = sh(make);
        EXPECT_EQ(outcome.code, 0) << make << "\n" << outcome.err;
        EXPECT_FALSE(stale(make)) << make;
    }
    fs::copy_file(folder / "e/new.exr", folder / "before it.exr");
    const Outcome chained = sh(chain);
    EXPECT_EQ(chained.code, 0) << chained.err;
    EXPECT_FALSE(stale(chain));

    write_unseen("pulse.txt", "0 1\n2 1\n");
    EXPECT_TRUE(stale(cube));
    EXPECT_FALSE(stale(edit));
    EXPECT_EQ(sh(edit + " SEED=1").code, 0);
    const auto time = fs::last_write_time(folder / "before it.exr");
    fs::copy_file(folder / "e/new.exr", folder / "before it.exr", fs::copy_options::overwrite_existing);
    fs::last_write_time(folder / "before it.exr", time);
    EXPECT_TRUE(stale(chain));
    EXPECT_EQ(sh(edit).code, 0);
    write_unseen("b.obj", triangle(1.6));
    EXPECT_TRUE(stale(edit));
    EXPECT_FALSE(stale(graph));
    write_unseen("a.obj", triangle(1.1));
    for (const std::string& make : {graph, cube, edit}) EXPECT_TRUE(stale(make)) << make;
}

// The stamp itself: written when contents are others, in any folder, and by no check.
TEST_F(MakeContents, are_in_a_stamp) {
    const std::string stamp = stage("inspect") + " --quiet --stamp " + in("x.stamp") + " --scene " + in("s.xml");
    EXPECT_EQ(sh(stamp + " --check").code, 1);
    EXPECT_FALSE(fs::exists(folder / "x.stamp"));
    EXPECT_EQ(sh(stamp).code, 0);
    const std::string text = bytes_of(folder / "x.stamp");
    for (const char* name : {"s.xml", "part.xml", "a.obj"})
        EXPECT_NE(text.find(in(name) + "\n"), std::string::npos) << text;
    EXPECT_EQ(sh(stamp + " --check").code, 0);
    // A stamp that keeps its time is no news to make.
    const auto time = fs::last_write_time(folder / "x.stamp");
    fs::last_write_time(folder / "a.obj", fs::file_time_type::clock::now() - hours(1));
    EXPECT_EQ(sh(stamp).code, 0);
    EXPECT_EQ(fs::last_write_time(folder / "x.stamp"), time);
    EXPECT_FALSE(bytes_of(folder / "x.stamp") == text);  // the time that it saw
    write_unseen("a.obj", triangle(4));
    EXPECT_EQ(sh(stamp + " --check").code, 1);
    EXPECT_EQ(sh(stamp + " " + in("part.xml") + " --check").code, 1);
    // Dependencies of compared files, and of a row of a table.
    fs::copy_file(LOOM_SOURCE_DIR "/tests/fixtures/image_1.0.exr", folder / "r.exr");
    const std::string chart = "make -s -f pipelines/chart.mk BUILD=" + build_folder() + " OUT=" + in("chart") +
                              " REFERENCE=" + in("r.exr") + " SCENE=" + in("s.xml") + " " + in("chart/given.stamp");
    const std::string table = "make -s -f pipelines/table.mk BUILD=" + build_folder() + " OUT=" + in("table") +
                              " SCENES=" + in("s.xml") + " " + in("table/s/inputs.stamp");
    for (const std::string& make : {chart, table}) {
        EXPECT_EQ(sh(make).code, 0) << make;
        EXPECT_EQ(sh(make + " -q").code, 0) << make;
    }
    write_unseen("r.exr", bytes_of(folder / "r.exr") + "x");
    write_unseen("part.xml", bytes_of(folder / "part.xml") + " ");
    for (const std::string& make : {chart, table}) EXPECT_EQ(sh(make + " -q").code, 1) << make;
    // A damaged stamp lists nothing.
    write("x.stamp", text.substr(0, text.size() / 2));
    EXPECT_EQ(sh(stamp + " --check").code, 1);
    EXPECT_EQ(sh(stage("inspect") + " --stamp " + in("x.stamp")).code, 2);
    EXPECT_EQ(sh(stage("inspect") + " " + in("s.xml") + " --check").code, 2);
}

// A scene comes from anywhere: what its files are called is never make's or a shell's.
TEST_F(Make, names_are_names) {
    const std::string odd = "a:b;c#d%e=f \"g\" 'h' `touch PWNED` *?[i]~\\j&k|l>m<n(o){p}!\t\xc3\xa4\xff";
    const std::string run = "\n\ttouch PWNED\nall: ;touch PWNED\n";
    const auto attribute = [](const std::string& text) {
        const std::pair<char, const char*> entities[] = {{'&', "&amp;"},  {'<', "&lt;"},   {'>', "&gt;"},
                                                         {'"', "&quot;"}, {'\n', "&#10;"}, {'\t', "&#9;"}};
        std::string out;
        for (const char c : text) {
            const auto entity =
                std::find_if(std::begin(entities), std::end(entities), [&](const auto& e) { return e.first == c; });
            out += entity == std::end(entities) ? std::string(1, c) : entity->second;
        }
        return out;
    };
    // XML is UTF-8; the name of the scene itself need not be.
    const std::string valid = odd.substr(0, odd.size() - 1);
    fs::create_directories(folder / "textures");
    write("textures/" + valid + run + ".ppm", "P6\n1 1\n255\n\x80\x80\x80");
    write(valid + ".obj", "v 1 1 3\nv -1 1 3\nv 0 -1 3\nvt 0 0\nf 1/1 2/1 3/1\n");
    std::string text = scene_of(attribute(valid) + ".obj");
    text.replace(
        text.find("</shape>"), 0,
        R"(<bsdf type="diffuse"><texture type="bitmap" name="reflectance"><string name="filename" value="textures/)" +
            attribute(valid + run) + R"(.ppm"/></texture></bsdf>)");
    for (const std::string& name : {odd, std::string("-x y  z")}) {
        write(name + ".xml", text);
        const std::string make = "cd " + shell_word(folder.string()) +
                                 " && make -s -C '" LOOM_SOURCE_DIR "' -f pipelines/still.mk BUILD=" + build_folder() +
                                 " METHOD=pt SPP=1 OUT=" + in("x") + " SCENE=" + shell_word(in(name + ".xml"));
        for (int run_idx = 0; run_idx < 2; ++run_idx) {
            const Outcome outcome = sh(make + " image");
            EXPECT_EQ(outcome.code, 0) << outcome.err;
            EXPECT_EQ(outcome.out, in("x/image.exr") + "\n");
        }
        EXPECT_EQ(sh(make + " -q " + in("x/image.exr")).code, 0);
    }
    for (const fs::path& place : {folder, folder / "textures", fs::path(LOOM_SOURCE_DIR)})
        EXPECT_FALSE(fs::remove(place / "PWNED")) << place;
    // A newline cannot be in a line of make; a character with a meaning in make cannot be in a target.
    for (const auto& [variables, sign] :
         {std::pair{"SCENE='a\nb.xml'", "newline"}, std::pair{"SCENE='a$$b.xml'", "$"}, std::pair{"OUT=out/a:b", ":"},
          std::pair{"OUT='a#b'", "#"}, std::pair{"OUT=a%b", "%"}, std::pair{"OUT='a;b'", ";"},
          std::pair{"OUT=a=b", "="}, std::pair{"OUT='a b'", "blanks"}}) {
        const Outcome outcome = sh("make -s -f pipelines/still.mk " + std::string(variables));
        EXPECT_EQ(outcome.code, 2) << variables;
        EXPECT_NE(
            outcome.err.find(std::string("must not have ") + (std::string(sign) == "newline" ? "a newline" : sign)),
            std::string::npos)
            << outcome.err;
    }
}

// Every variable that a makefile of the project has from outside is in pipelines/variables.mk, which is included before
// any is used.
class MakeVariables : public Make {
  protected:
    static std::vector<std::string> makefiles() {
        std::vector<std::string> names{"Makefile"};
        for (const auto& entry : fs::directory_iterator(LOOM_SOURCE_DIR "/pipelines"))
            if (entry.path().extension() == ".mk") names.push_back("pipelines/" + entry.path().filename().string());
        std::sort(names.begin(), names.end());
        return names;
    }
    static std::string text_of(const std::string& name) { return bytes_of(fs::path(LOOM_SOURCE_DIR) / name); }
    /// The names of a kind: "files", "wholes", ... ; of all kinds for "kinds".
    std::vector<std::string> listed(const std::string& kind) const {
        write("list.mk", "include pipelines/variables.mk\nall: ; @echo " +
                             (kind == "kinds" ? "$(foreach k,$(kinds),$($(k)))" : "$(" + kind + ")"));
        std::istringstream words(sh("make -s -f " + in("list.mk")).out);
        return {std::istream_iterator<std::string>(words), {}};
    }
};

TEST_F(MakeVariables, are_all_listed_and_checked_first) {
    const std::vector<std::string> all = listed("kinds");
    const std::set<std::string> known(all.begin(), all.end());
    ASSERT_GT(known.size(), 50u);
    // Parts of pipelines, which only these include.
    const std::set<std::string> parts{"pipelines/variables.mk",      "pipelines/words.mk", "pipelines/passes.mk",
                                      "pipelines/cube.mk",           "pipelines/rows.mk",  "pipelines/edit-graph.mk",
                                      "pipelines/animation-cache.mk"};
    const std::set<std::string> of_make{"MAKE", "MAKEFLAGS", "SHELL", "STAGES"};
    const std::regex reference(R"(\$\(([A-Z][A-Z_]*)\))"), documented(R"(^#? *([A-Z_]+) *\??=.*  ## )");
    for (const std::string& name : makefiles()) {
        std::istringstream lines(text_of(name));
        bool checked = parts.contains(name);
        for (std::string line; std::getline(lines, line);) {
            if (line.starts_with("include pipelines/variables.mk")) checked = true;
            std::smatch match;
            if (std::regex_search(line, match, documented)) {
                EXPECT_TRUE(known.contains(match[1])) << name << ": " << line;
            }
            if (line.starts_with("#")) continue;
            for (auto at = std::sregex_iterator(line.begin(), line.end(), reference); at != std::sregex_iterator();
                 ++at) {
                EXPECT_TRUE(checked) << name << ": used before it is checked: " << line;
                EXPECT_TRUE(known.contains((*at)[1]) || of_make.contains((*at)[1])) << name << ": " << line;
            }
        }
        EXPECT_TRUE(checked) << name << " does not include pipelines/variables.mk";
    }
}

// Caught: a target without a phrase, a list longer than a screen, a page without variables, a name of a page in a shell.
TEST_F(MakeVariables, help_is_a_screen_and_a_page_per_pipeline) {
    const std::string help = sh("make -s help").out;
    EXPECT_TRUE(std::count(help.begin(), help.end(), '\n') >= 24 && std::count(help.begin(), help.end(), '\n') <= 44)
        << help;
    const std::set<std::string> unlisted{"edit-pictures", "stages"};  // an old spelling; a part of others
    std::istringstream phony(text_of("Makefile"));
    std::string line;
    for (; std::getline(phony, line) && !line.starts_with(".PHONY:");) {
    }
    std::istringstream targets(line.substr(line.find(')') + 1));
    for (std::string target; targets >> target;)
        EXPECT_EQ(help.find("\n  " + target + " ") == std::string::npos, unlisted.contains(target)) << target;

    std::istringstream refused(sh("make -s help-none").err);
    int n_pages = 0;
    for (std::string page; refused >> page;) {
        if (!page.starts_with("help-") || page == "help-none:") continue;
        ++n_pages;
        const Outcome outcome = sh("make -s " + page.substr(0, page.find('.')));
        EXPECT_EQ(outcome.code, 0) << page;
        EXPECT_TRUE(outcome.out.starts_with("Usage: make ")) << page << "\n" << outcome.out;
        EXPECT_NE(help.find("\n  " + page.substr(5, page.find('.') - 5) + " "), std::string::npos) << page;
    }
    EXPECT_EQ(n_pages, 23);
    const std::string image = sh("make -s help-image").out;
    EXPECT_NE(image.find("  METHOD=pathgraph               pathgraph, west, graph, or pt"), std::string::npos) << image;
    for (const char* hostile : {"help-none", "help-%", "help-image;touch PWNED", "help-`touch PWNED`",
                                "help-$(shell touch PWNED)", "help-x' ; touch PWNED '", "help-../LICENSE"})
        EXPECT_EQ(sh("make -s " + shell_word(hostile)).code, 2) << hostile;
    EXPECT_FALSE(fs::remove(LOOM_SOURCE_DIR "/PWNED"));
}

// Each variable with each value, by one shell: a line for each that is let through.
TEST_F(MakeVariables, reach_no_shell_unchecked) {
    write("all.mk",
          "include pipelines/variables.mk\n"
          "all: ; @echo $(foreach k,$(filter-out files name_lists commands,$(kinds)),$(foreach v,$($(k)),$($(v))))\n");
    const std::vector<std::string> hostile = {"1; touch PWNED",  "$(shell touch PWNED)", "`touch PWNED`",
                                              "1\ntouch PWNED",  "a\" ; touch PWNED \"", "a'; touch PWNED '",
                                              "$$(touch PWNED)", "a=1&touch PWNED"};
    const std::vector<std::string> files = listed("files"), commands = listed("commands");
    const std::vector<std::string> names = listed("name_lists");  // of scenes: as names of files
    EXPECT_EQ(commands, std::vector<std::string>{"LAUNCH"});      // a command by design
    std::string script;
    int n_runs = 0;
    for (const std::string& variable : listed("kinds")) {
        if (variable == "LAUNCH" || std::find(files.begin(), files.end(), variable) != files.end()) continue;
        if (std::find(names.begin(), names.end(), variable) != names.end()) continue;
        for (std::size_t i = 0; i < hostile.size(); ++i, ++n_runs)
            script += (i % 2 == 0 ? "make -s -f " + in("all.mk") + " " + shell_word(variable + "=" + hostile[i])
                                  : "env " + shell_word(variable + "=" + hostile[i]) + " make -s -f " + in("all.mk")) +
                      " >/dev/null 2>" + in("said") + "; c=$?; grep -q '^pipelines/variables.mk:[0-9]*: \\*\\*\\* " +
                      variable + "=' " + in("said") + " && [ $c = 2 ] || echo " +
                      shell_word(variable + " " + std::to_string(i)) + " $c\n";
    }
    ASSERT_GT(n_runs, 300);
    write("script", script);
    EXPECT_EQ(sh("sh " + in("script")).out, "");

    // Names of files may have nearly any character, because their uses quote them. Each pipeline refuses unknown
    // values.
    for (const std::string& pipeline : makefiles()) {
        if (pipeline == "Makefile" || listed("kinds").empty()) continue;
        const std::string text = text_of(pipeline);
        if (text.find("include pipelines/variables.mk") == std::string::npos) continue;
        for (const std::string& variable : files) {
            if (text.find("$(" + variable + ")") == std::string::npos) continue;
            for (const std::string& value : hostile) {
                const Outcome outcome = sh("make -s -f " + pipeline + " BUILD=" + build_folder() + " OUT=" + in("out") +
                                           " " + shell_word(variable + "=" + value));
                EXPECT_EQ(outcome.code, 2) << pipeline << " " << variable << "=" << value << "\n" << outcome.err;
            }
        }
        const Outcome slip = sh("make -s -f " + pipeline + " SPPP=4");
        EXPECT_EQ(slip.code, 2) << pipeline;
        EXPECT_NE(slip.err.find("SPPP=4: no variable"), std::string::npos) << slip.err;
    }
    EXPECT_EQ(sh("make -s image trace='touch PWNED;'").code, 2);
    EXPECT_EQ(sh("make -s image CXX='$(shell touch PWNED)'").code, 2);
    EXPECT_EQ(sh("make -s -e help").code, 2);
    EXPECT_FALSE(fs::remove(LOOM_SOURCE_DIR "/PWNED"));
}

TEST_F(MakeVariables, keep_what_they_may_be) {
    write("all.mk",
          "include pipelines/variables.mk\nSPP ?= 4\nTRACE ?= --x\nall: ; @printf '%s|' $(call quote,$(SCENE)) $(OUT) "
          "$(SPP) $(SPPS) $(SEED) $(START) $(call quote,$(DEFINES)) $(call quote,$(TRACE)) $(EXPOSURE)\n");
    const auto values = [&](const std::string& variables) {
        return sh("make -s -f " + in("all.mk") + " " + variables).out;
    };
    EXPECT_EQ(
        values(
            R"(SCENE="a  b's \"c\".xml" OUT=out/ä SPP=999999999 SPPS='1 4  16' SEED=0 THREADS=0 START=-1.5e3 DEFINES=' a=1  b=#ff0000,2 ' TRACE='--roulette off' EXPOSURE=-2)"),
        "a  b's \"c\".xml|out/ä|999999999|1|4|16|0|-1.5e3|a=1 b=#ff0000,2|--roulette off|-2|");
    // Nothing is not given, but for texts, of which it is the empty one.
    EXPECT_EQ(values("SCENE=-x.xml OUT= SPP= TRACE="), "./-x.xml|4|||");
    for (const char* wrong : {"OUT=-x", "SPP=0", "SPP=01", "SPP=1.5", "SPP=1000000000", "SPPS='1 0'", "SEED=-1",
                              "SEED=1234567890123456789", "KEEP=yes", "START=one", "DEFINES=a", "DEFINES==1"})
        EXPECT_EQ(sh("make -s -f " + in("all.mk") + " " + wrong).code, 2) << wrong;
}

class MakePackages : public Make {
  protected:
    /// Makes a folder for the front of PATH: the user is not root, sudo fails, these packages are not installed.
    std::string without(const std::string& packages) const {
        fs::create_directories(folder / "fake");
        write("fake/id", "#!/bin/sh\necho 1000\n");
        write("fake/sudo", "#!/bin/sh\necho 'sudo: command not found' >&2; exit 127\n");
        write("fake/apt-get", "#!/bin/sh\necho 'apt-get without root' >&2; exit 100\n");
        write("fake/cmake", "#!/bin/sh\necho 'cmake without packages' >&2; exit 1\n");
        write("fake/dpkg-query", "#!/bin/sh\nshift 2; for p in \"$@\"; do case ' " + packages +
                                     " ' in *\" $p \"*) ;; *) echo \"installed $p\" ;; esac; done\n");
        for (const char* name : {"id", "sudo", "apt-get", "cmake", "dpkg-query"})
            fs::permissions(folder / "fake" / name, fs::perms::owner_all);
        return "PATH=" + in("fake") + ":$PATH ";
    }
};

TEST_F(MakePackages, a_built_tree_needs_none) {
    const std::string path = without("ccache gnuplot-nox ninja-build ffmpeg");
    fs::remove(folder / "fake/cmake");
    const Outcome outcome =
        sh(path + "make -s image BUILD=" + build_folder() + " METHOD=pt SPP=1 DEFINES='resx=8 resy=8' OUT=" + in("x"));
    EXPECT_EQ(outcome.code, 0) << outcome.err;
    EXPECT_EQ(outcome.out, in("x/image.exr") + "\n");
    for (const char* word : {"sudo", "installing", "apt-get"})
        EXPECT_EQ(outcome.err.find(word), std::string::npos) << outcome.err;
}

TEST_F(MakePackages, what_is_missing_is_named) {
    // With and without a configured tree: what is missing, its purpose, and what to do; once.
    const std::string path = without("libembree-dev ccache");
    fs::create_directories(folder / "configured");
    write("configured/build.ninja", "");
    for (const char* tree : {"configured", "new"}) {
        const Outcome outcome = sh(path + "make -s stages JOBS=1 BUILD=" + in(tree) + " </dev/null");
        EXPECT_EQ(outcome.code, 2);
        EXPECT_EQ(outcome.out, "");
        for (const std::string& word : {std::string("libembree-dev"), std::string("rays and meshes"),
                                        std::string("apt-get install libembree-dev"), "cmake -S . -B " + in(tree)})
            EXPECT_NE(outcome.err.find(word), std::string::npos) << word << "\n" << outcome.err;
        EXPECT_EQ(outcome.err.find("command not found"), std::string::npos) << outcome.err;
        EXPECT_EQ(outcome.err.find("rays and meshes"), outcome.err.rfind("rays and meshes")) << outcome.err;
    }
    EXPECT_EQ(sh(path + "sh pipelines/packages.sh install build </dev/null").code, 1);
    // Packages of convenience alone are no reason.
    const Outcome convenience = sh(without("ccache gnuplot-nox") + "sh pipelines/packages.sh install build </dev/null");
    EXPECT_EQ(convenience.code, 0);
    EXPECT_EQ(convenience.out + convenience.err, "");
}

}  // namespace
}  // namespace loom::pipeline
