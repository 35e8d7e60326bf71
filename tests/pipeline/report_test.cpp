// The report as a user makes it, and as a browser shows it.

#include <cstdlib>

#include "tests/pipeline/process.h"

namespace loom::pipeline {
namespace {

class Report : public PipelineTest {
  protected:
    std::string report(const std::string& variables) const {
        return "make -s -f pipelines/report.mk BUILD='" + fs::path(LOOM_BIN_DIR).parent_path().string() +
               "' OUT=" + (folder / "r").string() +
               " SCENE=scenes/cornell-box.xml DEFINES='resx=16 resy=16' REFERENCE_SPP=16 REPLICATES=2 "
               "SPPS='1 4' " +
               variables;
    }
    /// The page as a browser leaves it, scripts run; its log is in err.
    Outcome browse(const std::string& options, const std::string& hash) const {
        return sh(
            "chromium --headless --no-sandbox --disable-gpu --disable-dev-shm-usage --enable-logging=stderr "
            "--virtual-time-budget=10000 --user-data-dir='" +
            (folder / "browser").string() + "' " + options + " 'file://" + (folder / "r/report.html").string() + hash +
            "'");
    }
};

TEST_F(Report, FromSceneToPage) {
    const Outcome made = sh(report("METHODS='pt pathgraph+K4'"));
    ASSERT_EQ(made.code, 0) << made.err;
    EXPECT_TRUE(made.out.ends_with((folder / "r/report.html").string() + "\n")) << made.out;
    const std::string page = bytes_of(folder / "r/report.html");
    for (const char* part : {"Error against cost", "Where the time goes", "Bias and variance apart", "Convergence",
                             "Plan and lineage", "pathgraph+K4", "loom-cluster"})
        EXPECT_NE(page.find(part), std::string::npos) << part;
    // The same files give the same bytes.
    fs::remove(folder / "r/report.html");
    ASSERT_EQ(sh(report("METHODS='pt pathgraph+K4'")).code, 0);
    EXPECT_TRUE(page == bytes_of(folder / "r/report.html"));
    // Settings reach the method: K of the clusters, steps of the refinement.
    const std::string steps = bytes_of(folder / "r/iterations.tsv");
    EXPECT_NE(steps.find("\tpathgraph+K4\t6\t"), std::string::npos) << steps;
    EXPECT_EQ(bytes_of(folder / "r/pathgraph+K4-4-0/pathgraph/cluster.parameters"),
              "--scene 'scenes/cornell-box.xml' -D 'resx=16' -D 'resy=16' --k 4\n");
}

// Paths that end after their first vertex leave nothing to refine, and one replicate has no spread. Charts of these
// report that or are left out; the rest is made.
TEST_F(Report, WithoutStepsAndReplicates) {
    const Outcome made = sh("make -s -f pipelines/report.mk report BUILD='" +
                            fs::path(LOOM_BIN_DIR).parent_path().string() + "' OUT=" + (folder / "r").string() +
                            " SCENE=scenes/direct-sphere.xml DEFINES='resx=8 resy=8' REFERENCE_SPP=16 REPLICATES=1 "
                            "SPPS=1 METHODS='pt pathgraph'");
    ASSERT_EQ(made.code, 0) << made.err;
    const std::string page = bytes_of(folder / "r/report.html");
    EXPECT_NE(page.find("No light is refined"), std::string::npos);
    EXPECT_EQ(page.find("Bias and variance apart"), std::string::npos);
}

TEST_F(Report, WrongSettingsAreRefused) {
    for (const char* wrong : {"pt+X3", "pathgraph+K", "path-graph"})
        EXPECT_EQ(sh(report("METHODS='" + std::string(wrong) + "'")).code, 2) << wrong;
}

// In a browser, from disk: the page moves its own controls (see check() in page.js) and reports what did not follow;
// both colour schemes; nothing on the console. Detected mutations: the line not moved, the exposure's factor left out,
// both schemes of one colour.
TEST_F(Report, WorksInABrowser) {
    if (std::getenv("LOOM_TEST_FULL") == nullptr) GTEST_SKIP() << "runs in make test-full";
    if (sh("command -v chromium").code != 0) GTEST_SKIP() << "chromium is not installed (Debian: apt install chromium)";
    const Outcome made = sh(report("METHODS='pt pathgraph'"));
    ASSERT_EQ(made.code, 0) << made.err;
    std::string paper[2];
    for (int light : {0, 1}) {
        const Outcome shown =
            browse("--blink-settings=preferredColorScheme=" + std::to_string(light) + " --dump-dom", "#check");
        ASSERT_EQ(shown.code, 0) << shown.err;
        const auto attribute = [&](const std::string& name) {
            const std::size_t at = shown.out.find(name + "=\"");
            if (at == std::string::npos) return std::string("not there");
            const std::size_t begin = at + name.size() + 2;
            return shown.out.substr(begin, shown.out.find('"', begin) - begin);
        };
        EXPECT_EQ(attribute("data-check"), "right");
        EXPECT_EQ(shown.err.find("CONSOLE"), std::string::npos) << shown.err;
        paper[light] = attribute("data-paper");
    }
    EXPECT_EQ(paper[0], "rgb(21, 23, 26)");
    EXPECT_EQ(paper[1], "rgb(252, 251, 248)");
}

}  // namespace
}  // namespace loom::pipeline
