// `make animation`: which frames a change of the table, of the scene or of a variable remakes.
#include <fmt/format.h>

#include <algorithm>
#include <cstdlib>
#include <regex>
#include <set>
#include <sstream>

#include "formats/image.h"
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
    std::string in(const std::string& name) const { return (folder / name).string(); }
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

// Detected mutation: no shape dropped in the frames' command.
TEST_F(MakeAnimation, shapes_appear_late_and_leave) {
    const std::string head = row(0, "none") + row(1, "-0.2");
    write(head + row(2, "0.3") + row(3, "none"));
    EXPECT_NE(make().err.find(":2: frame 0: "), std::string::npos);
    EXPECT_EQ(frames("ABSENT=none"), Numbers({0, 1, 2, 3}));
    const auto colour = [](const fs::path& file) { return read_image(file).interleaved(""); };
    EXPECT_EQ(colour(image(0)), colour(folder / "x/base/static.exr"));
    EXPECT_EQ(colour(image(3)), colour(image(0)));
    EXPECT_NE(colour(image(1)), colour(image(0)));
    EXPECT_EQ(frames("ABSENT=none METHOD=pt", "y"), Numbers({0, 1, 2, 3}));
    const Outcome alone =
        sh("'" + stage("trace") + "' --quiet scenes/animated/ball.xml -D resx=12 -D resy=8 --spp 2 --static '" +
           (folder / table).string() + "' --absent none -o '" + (folder / "s.exr").string() + "'");
    EXPECT_EQ(alone.code, 0) << alone.err;
    EXPECT_EQ(colour(folder / "s.exr"), colour(folder / "x/base/static.exr"));
    // The ball comes later: one frame is another one, the static scene is not.
    write(head + row(2, "none") + row(3, "none"));
    EXPECT_EQ(frames("ABSENT=none"), Numbers({2}));
    EXPECT_FALSE(traced);
    EXPECT_EQ(colour(image(2)), colour(image(0)));
    EXPECT_EQ(make("ABSENT='no ne'").code, 2);
    EXPECT_EQ(sh("'" + stage("trace") + "' scenes/animated/ball.xml --absent none --spp 2 -o '" +
                 (folder / "z.exr").string() + "'")
                  .code,
              2);
}

// A mesh from another file in each frame, without an id, against path tracing of the frames.
TEST_F(MakeAnimation, a_mesh_deforms) {
    const auto obj = [&](const std::string& name, const std::string& top) {
        std::ofstream(folder / name) << "v -0.5 0.3 0.3\nv 0.1 0.3 0.4\nv " << top << " 0.2\nf 1 2 3\n";
    };
    obj("a.obj", "-0.4 0.9"), obj("b.obj", "0.3 1.4");
    std::string scene = bytes_of(fs::path(LOOM_SOURCE_DIR) / "scenes/animated/ball.xml");
    const std::size_t at = scene.find("<shape type=\"sphere\"");
    scene.replace(at, scene.find("</shape>", at) + 8 - at,
                  "<shape type=\"obj\"><string name=\"filename\" value=\"$mesh\"/><ref id=\"red\"/></shape>");
    scene.replace(scene.find("<default name=\"x\""), 0, "<default name=\"mesh\" value=\"a.obj\"/>");
    std::ofstream(folder / "cloth.xml") << scene;
    write("0\ta.obj\n1\tb.obj\n", "frame\tmesh\n");
    const std::string variables = "SPP=64 BASE_SPP=256 DEFINES='resx=24 resy=18' SCENE=" + named("cloth.xml");
    EXPECT_EQ(frames(variables), Numbers({0, 1}));
    EXPECT_EQ(frames(variables + " METHOD=pt SEED=3 TRACE='--sampler independent'", "y"), Numbers({0, 1}));
    for (const int number : {0, 1}) {
        const Outcome outcome =
            sh("'" + stage("compare") + "' --quiet '" + image(number).string() + "' -r '" +
               image(number, "y").string() + "' --fail-below p_tiles=1e-4 --fail-below p_image=1e-4");
        EXPECT_EQ(outcome.code, 0) << number << outcome.out;
    }
}

TEST_F(MakeAnimation, length_of_paths_counts_for_residuals_and_plan) {
    write(row(0, "-0.5") + row(1, "0.2"));
    EXPECT_EQ(frames("TRACE='--max-depth 2'"), Numbers({0, 1}));
    EXPECT_EQ(make("TRACE=--max-depth=2 BASE_SPP=auto", "y").code, 0);
    EXPECT_NE(bytes_of(folder / "y/plan.parameters").find("--max-depth 2"), std::string::npos);
    // Direct light varies less than all light.
    const auto variance = [&](const std::string& out) {
        const std::string plan = bytes_of(folder / out / "plan.txt");
        return std::stod(plan.substr(plan.find("variance of a path ") + 19));
    };
    EXPECT_EQ(make("BASE_SPP=auto", "z").code, 0);
    EXPECT_LT(variance("y"), 0.9 * variance("z"));
}

// The static image and what moves are denoised apart.
TEST_F(MakeAnimation, denoises_what_moves_apart) {
    write(row(0, "-0.5") + row(1, "0.2"));
    const std::string variables = "DEFINES='resx=48 resy=36' SPP=8 BASE_SPP=256 ";
    EXPECT_EQ(frames(variables + "DENOISE=1"), Numbers({0, 1}));
    EXPECT_TRUE(fs::exists(folder / "x/base/denoised.exr"));
    const std::string reference = in("r.exr"), frame = image(1).string();
    ASSERT_EQ(sh("'" + stage("trace") +
                 "' --quiet scenes/animated/ball.xml -D x=0.2 -D y=0.3 -D resx=48 -D resy=36 --spp 2048 "
                 "--sampler independent --seed 9 -o " +
                 reference)
                  .code,
              0);
    ASSERT_EQ(sh("'" + stage("denoise") + "' --quiet --method filter " + frame + " -o " + in("whole.exr")).code, 0);
    const std::string base = " --base " + in("x/base/static.exr"),
                      clean = " --denoised-base " + in("x/base/denoised.exr"),
                      apart = "'" + stage("denoise") + "' --quiet --method filter " + frame + base;
    ASSERT_EQ(sh(apart + clean + " -o " + in("apart.exr")).code, 0);
    const Image r = read_image(reference);
    const auto error = [&](const std::string& name) {
        const std::vector<float> x = read_image(name).interleaved(""), y = r.interleaved("");
        double sum = 0;
        for (std::size_t i = 0; i < x.size(); ++i) sum += (x[i] - y[i]) * (x[i] - y[i]) / (y[i] * y[i] + 0.01);
        return sum / double(x.size());
    };
    EXPECT_LT(error(in("whole.exr")), 0.7 * error(frame));
    EXPECT_LT(error(in("apart.exr")), 0.7 * error(in("whole.exr")));
    // Denoising the static image here gives the same.
    ASSERT_EQ(sh(apart + " -o " + in("here.exr")).code, 0);
    EXPECT_NEAR(error(in("here.exr")), error(in("apart.exr")), 0.2 * error(in("apart.exr")));
    const Outcome plan = sh(apart + " --plan");
    EXPECT_NE(plan.out.find("the old image and the difference apart"), std::string::npos) << plan.out;
    // What does not fit together.
    const std::string other = " --base " + in("x/base/denoised.exr");
    for (const auto& [command, said] :
         {std::pair("'" + stage("denoise") + "' " + frame + other, "is not made from"),
          std::pair("'" + stage("denoise") + "' " + in("x/base/static.exr") + base, "is no new image from a graph"),
          std::pair("'" + stage("denoise") + "' " + frame + base + " --denoised-base " + in("whole.exr"), ", denoised"),
          std::pair("'" + stage("denoise") + "' " + frame + clean, "needs --base")}) {
        const Outcome outcome = sh(command + " -o " + in("z.exr"));
        EXPECT_EQ(outcome.code, 2) << command;
        EXPECT_NE(outcome.err.find(said), std::string::npos) << outcome.err;
    }
}

TEST_F(MakeAnimation, ends_with_charts_and_a_page) {
    write(row(0, "-0.5") + row(1, "-0.2") + row(12, "0.3"));
    frames("SPP=4");
    for (const char* name : {"frames.svg", "frames.png", "frame-costs.tsv", "report.html"})
        EXPECT_TRUE(fs::exists(folder / "x" / name)) << name;
    std::istringstream costs(bytes_of(folder / "x/frame-costs.tsv"));
    std::string line;
    std::getline(costs, line);
    EXPECT_EQ(line, "scene\tmethod\tframe\tcpu_s\trender_s\tshared_s\ttouched\texpected_relmse\tstatic_share");
    for (const int number : {0, 1, 12}) {
        std::string scene, method;
        int frame = -1;
        double cpu_s = 0, render_s = 0, shared_s = 0, touched = 0, relmse = 0, static_share = 0;
        std::getline(costs, line);
        std::istringstream(line) >> scene >> method >> frame >> cpu_s >> render_s >> shared_s >> touched >> relmse >>
            static_share;
        EXPECT_EQ(scene + method, "ballhybrid");
        EXPECT_EQ(frame, number);
        EXPECT_GT(render_s, 0);
        EXPECT_GT(cpu_s, render_s);
        EXPECT_GT(shared_s, 0);
        EXPECT_GT(touched, 0.01);
        EXPECT_LT(touched, 0.5);
        EXPECT_GT(relmse, 0);
        EXPECT_GT(static_share, 0);
        EXPECT_LT(static_share, 1);
    }
    const std::string page = bytes_of(folder / "x/report.html");
    for (const char* part :
         {"<tr data-frame=\"2\"><th scope=\"row\">12</th>", "max=\"2\"", "Frame by frame", "<svg", "Plan and lineage"})
        EXPECT_NE(page.find(part), std::string::npos) << part;
    for (const char* outside : {"https:", "src=", "@import", "<link"})
        EXPECT_EQ(page.find(outside), std::string::npos) << outside;
    EXPECT_EQ(frames("SPP=4"), Numbers());
    EXPECT_EQ(bytes_of(folder / "x/report.html"), page);
    // Path tracing has no graph; denoised frames no variance.
    frames("METHOD=pt DENOISE=1", "y");
    EXPECT_NE(bytes_of(folder / "y/frame-costs.tsv").find("\t0\tnan\tnan\tnan\n"), std::string::npos)
        << bytes_of(folder / "y/frame-costs.tsv");
    for (const std::string spp : {"auto", "2"}) {
        const Outcome report = sh(fmt::format(
            "make -s -f pipelines/report.mk BUILD='{}' OUT='{}' FRAMES={} SPP=2 DEFINES='resx=12 resy=8' BASE_SPP={}",
            fs::path(stage("trace")).parent_path().parent_path().string(), in("r"), named(table), spp));
        EXPECT_EQ(report.out, in("r/report.html") + "\n") << report.err;
    }
    // What comes from outside is text on the page, and no scheme in its link.
    const std::string hostile = "</script><script>alert(1)</script>";
    const std::string report =
        "'" + stage("report") + "' --quiet --animation " + image(0).string() + " " + image(12).string();
    ASSERT_EQ(sh(report + " --title '" + hostile + "' --made-by '" + hostile +
                 "' --movie 'javascript:alert(1)\"<.mp4' -o " + in("p.html"))
                  .code,
              0);
    const std::string other = bytes_of(folder / "p.html");
    EXPECT_EQ(other.find("<script>alert"), std::string::npos);
    EXPECT_EQ(other.find("href=\"javascript"), std::string::npos);
    EXPECT_NE(other.find("javascript%3Aalert%281%29%22%3C.mp4\""), std::string::npos);
    EXPECT_NE(other.find("\"number\": \"12\""), std::string::npos);
    EXPECT_EQ(sh(report + " --by-frame " + in("x/frame-costs.tsv") + " -o " + in("q.html")).code, 2);
    EXPECT_EQ(sh(report + " --tour " + in("x/frame-costs.tsv") + " -o " + in("q.html")).code, 2);
    // A table where the chart's data would be.
    fs::copy_file(folder / table, folder / "x/frames.tsv", fs::copy_options::overwrite_existing);
    table = "x/frames.tsv";
    const std::string before = bytes_of(folder / table);
    const Outcome refused = make();
    EXPECT_EQ(refused.code, 2);
    EXPECT_NE(refused.err.find("would overwrite it"), std::string::npos) << refused.err;
    EXPECT_EQ(bytes_of(folder / table), before);
}

// In a browser, from disk: the page moves its own controls (check() in animation.js) and says what did not follow.
TEST_F(MakeAnimation, the_page_works_in_a_browser) {
    if (std::getenv("LOOM_TEST_FULL") == nullptr) GTEST_SKIP() << "runs in make test-full";
    if (sh("command -v chromium").code != 0) GTEST_SKIP() << "chromium is not installed (Debian: apt install chromium)";
    write(row(0, "-0.5") + row(1, "-0.2") + row(2, "0.3") + row(12, "0.3"));
    frames("SPP=4");
    const Outcome shown =
        sh("chromium --headless --no-sandbox --disable-gpu --disable-dev-shm-usage --enable-logging=stderr "
           "--virtual-time-budget=10000 --user-data-dir='" +
           (folder / "browser").string() + "' --dump-dom 'file://" + (folder / "x/report.html").string() + "#check'");
    ASSERT_EQ(shown.code, 0) << shown.err;
    EXPECT_NE(shown.out.find("data-check=\"right\""), std::string::npos) << shown.out.substr(0, 400);
    EXPECT_EQ(shown.err.find("CONSOLE"), std::string::npos) << shown.err;
}

// A small chart of one row: the table's gain with all costs is that of the curve.
TEST_F(MakeAnimation, is_charted_against_path_tracing) {
    const Outcome made = sh("make -s -f pipelines/chart-animation.mk BUILD='" +
                            fs::path(stage("trace")).parent_path().parent_path().string() + "' OUT=" + in("c") +
                            " ROWS=ball COUNT=3 SIZE=16 SPPS=4 BASE_SPP=16 REFERENCE_SPP=64");
    ASSERT_EQ(made.code, 0) << made.err;
    for (const char* name : {"error.svg", "flicker.svg", "gain.svg", "spectrum.svg", "table.md"}) {
        EXPECT_TRUE(fs::exists(folder / "c" / name)) << name;
        EXPECT_NE(made.out.find((folder / "c" / name).string() + "\n"), std::string::npos) << made.out;
    }
    const auto cells = [](const std::string& text, const std::string& start, std::size_t column) {
        std::istringstream lines(text);
        for (std::string line; std::getline(lines, line);) {
            if (!line.starts_with(start)) continue;
            std::istringstream words(line);
            std::string word;
            for (std::size_t i = 0; i <= column; ++i) std::getline(words, word, '\t');
            return word;
        }
        return std::string("none");
    };
    const std::string rows = bytes_of(folder / "c/table.tsv"), gains = bytes_of(folder / "c/gains.tsv");
    for (const char* method :
         {"pt\t2", "pt\t4", "pt-d\t4", "hybrid\t4", "hybrid-d\t4", "auto\t4", "auto-d\t4", "single\t4", "single-d\t4"})
        EXPECT_NE(cells(rows, std::string("shape\tball\t") + method, 5), "none") << method << rows;
    EXPECT_EQ(cells(rows, "shape\tball\thybrid\t4\t", 16), cells(gains, "ball\thybrid 4\t240\t", 3)) << rows << gains;
    EXPECT_EQ(cells(rows, "shape\tball\thybrid\t4\t", 15), cells(gains, "ball\thybrid 4\t24\t", 3));
    EXPECT_NE(bytes_of(folder / "c/spectra.tsv").find("ball\thybrid-d-4\t0\t"), std::string::npos);
    const std::string page = bytes_of(folder / "c/table.md");
    EXPECT_EQ(std::count(page.begin(), page.end(), '\n') > 15, true) << page;
    EXPECT_NE(page.find("| ball | single 4 |"), std::string::npos) << page;
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

TEST_F(MakeAnimation, walks_with_a_cache) {
    const std::string walk = "SCENE=scenes/animated/walk.xml ",
                      cached = walk + "CACHE=points CACHE_VIEWS=2 CACHE_SPP=2 ";
    const auto at = [](int number, const std::string& x, const std::string& eye) {
        return fmt::format("{}\t{}\t{}, 1, 3\n", number, x, eye);
    };
    const std::string head = "frame\tx\teye\n", first = at(0, "-.5", "0") + at(1, "-.3", ".1"),
                      last = at(3, ".1", ".3");
    write(first + at(2, "-.1", ".2") + last, head);
    // Without a cache the error says what to do.
    for (const char* spp : {"2", "auto"}) {
        const Outcome outcome = make(walk + "BASE_SPP=" + spp, "bad");
        EXPECT_EQ(outcome.code, 2);
        EXPECT_NE(outcome.err.find("has another sensor than frame 0. Where the camera moves"), std::string::npos)
            << outcome.err;
        EXPECT_NE(outcome.err.find("make animation CACHE=points"), std::string::npos) << outcome.err;
    }
    EXPECT_EQ(frames(walk + "METHOD=pt", "pt"), Numbers({0, 1, 2, 3}));
    EXPECT_EQ(frames(cached), Numbers({0, 1, 2, 3}));
    const fs::path cache = folder / "x/cache/cache.h5", view = folder / "x/cache/view-0002.h5";
    EXPECT_TRUE(fs::exists(cache));
    EXPECT_TRUE(fs::exists(view));
    EXPECT_FALSE(fs::exists(folder / "x/cache/view-0001.h5"));
    EXPECT_FALSE(fs::exists(folder / "x/base"));
    EXPECT_EQ(frames(cached), Numbers());
    const Outcome inspected = sh(stage("inspect") + " --quiet " + named("x/images/frame-0001.exr"));
    EXPECT_NE(inspected.out.find("CacheError.R"), std::string::npos) << inspected.out;
    EXPECT_NE(inspected.out.find("biased"), std::string::npos) << inspected.out;
    // A row whose view is not in the cache: that frame. One whose view is: the cache, and so all of them.
    const std::string before = bytes_of(cache);
    write(at(0, "-.5", "0") + at(1, "-.3", ".15") + at(2, "-.1", ".2") + last, head);
    EXPECT_EQ(frames(cached), Numbers({1}));
    EXPECT_EQ(bytes_of(cache), before);
    write(first + at(2, "-.1", ".25") + last, head);
    EXPECT_EQ(frames(cached), Numbers({0, 1, 2, 3}));
    EXPECT_NE(bytes_of(cache), before);
    // Batches, threads and a cache made alone change no byte.
    EXPECT_EQ(frames(cached + "BATCH=1 THREADS=1", "y"), Numbers({0, 1, 2, 3}));
    for (int number = 0; number < 4; ++number)
        EXPECT_EQ(bytes_of(image(number)), bytes_of(image(number, "y"))) << number;
    // Corrected frames are made again with another share, from the same cache.
    for (const char* share : {".5", ".25"}) {
        EXPECT_EQ(frames(cached + "CORRECT=" + share), Numbers({0, 1, 2, 3}));
        EXPECT_EQ(frames(cached + "CORRECT=" + share), Numbers());
        const Outcome corrected = sh(stage("inspect") + " --quiet " + named("x/images/frame-0001.exr"));
        EXPECT_EQ(corrected.out.find("CacheError"), std::string::npos) << corrected.out;
        EXPECT_NE(corrected.out.find("unbiased"), std::string::npos) << corrected.out;
    }
    EXPECT_NE(bytes_of(folder / "x/report.html").find("CORRECT=.25"), std::string::npos);
    EXPECT_EQ(frames(cached + "SPP=3"), Numbers({0, 1, 2, 3}));
    // Another kind of cache, of the same views.
    const std::string points = bytes_of(cache);
    EXPECT_EQ(frames(walk + "CACHE=grid CACHE_VIEWS=2 CACHE_SPP=2 SPP=3"), Numbers({0, 1, 2, 3}));
    EXPECT_NE(bytes_of(cache), points);
    EXPECT_NE(sh(stage("inspect") + " --quiet " + named("x/cache/cache.h5")).out.find("grid/features"),
              std::string::npos);
    // A camera that stands still may have one as well.
    write(row(0, "-.5") + row(1, ".2"));
    EXPECT_EQ(frames(cached, "still"), Numbers({0, 1}));
    for (const char* wrong :
         {"CACHE=magic", "CACHE=points METHOD=pt", "CACHE=grid METHOD=pt", "CACHE=points CACHE_VIEWS=0"})
        EXPECT_EQ(make(wrong).code, 2) << wrong;
    for (const auto& [wrong, said] :
         {std::pair("CORRECT=.5", "no cache to correct"), std::pair("CACHE=points CORRECT=0", "must be from .001 to 1"),
          std::pair("CACHE=points CORRECT=1.5", "must be from .001 to 1"),
          std::pair("CACHE=points CORRECT=half", "must be a number")}) {
        const Outcome outcome = make(wrong);
        EXPECT_EQ(outcome.code, 2) << wrong;
        EXPECT_NE(outcome.err.find(said), std::string::npos) << outcome.err;
    }
    // By hand: views without a number in their name, or as passes.
    const std::string run =
        stage("trace") + " scenes/animated/walk.xml --spp 1 --static " + named(table) + " --only 0:1 -o ";
    EXPECT_NE(sh(run + named("v.h5")).err.find("needs a %"), std::string::npos);
    EXPECT_NE(sh(run + named("v-%.h5") + " --passes 2").err.find("leave out --passes"), std::string::npos);
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
