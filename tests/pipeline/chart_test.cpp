// Errors, costs and charts as a user makes them.

#include <cmath>
#include <sstream>
#include <tuple>

#include "formats/image.h"
#include "formats/io/output_file.h"
#include "tests/pipeline/process.h"

namespace loom::pipeline {
namespace {

const std::string box = "scenes/cornell-box.xml -D resx=16 -D resy=16 ";

class Compare : public PipelineTest {
  protected:
    void SetUp() override {
        PipelineTest::SetUp();
        for (int seed : {1, 2, 3}) {
            ASSERT_EQ(sh(stage("trace") + " " + box + "--spp 4 --seed " + std::to_string(seed) + " -o " +
                         in("pt" + std::to_string(seed) + ".exr"))
                          .code,
                      0);
        }
    }
    std::string in(const std::string& name) const { return (folder / name).string(); }
};

TEST_F(Compare, LimitsDecideTheExitCode) {
    const std::string run = stage("compare") + " " + in("pt1.exr") + " " + in("pt2.exr");
    EXPECT_EQ(sh(run).code, 0);
    EXPECT_EQ(sh(run + " --fail-above relmse=100 --fail-below psnr=1").code, 0);
    EXPECT_EQ(sh(run + " --fail-above relmse=1e-9").code, 1);
    EXPECT_EQ(sh(run + " --fail-below psnr=90").code, 1);
    EXPECT_EQ(sh(run + " --fail-above cpu_s=100").code, 1);  // unknown without --cost: not passed
    const Outcome wrong = sh(run + " --fail-above wrong=1");
    EXPECT_EQ(wrong.code, 2);
    EXPECT_NE(wrong.err.find("relmse_trimmed"), std::string::npos) << wrong.err;
    // An image against itself: no error, and no limit of 0 broken.
    EXPECT_EQ(sh(stage("compare") + " " + in("pt1.exr") + " " + in("pt1.exr") + " --fail-above mse=0").code, 0);
}

// Detected mutation: the checks left out; the errors are then NaN, with exit 0.
TEST_F(Compare, RefusesValuesThatAreNotFinite) {
    const std::string with_pt2 = " " + in("bad.exr") + " -r " + in("pt2.exr");
    for (const auto& [channel, samples, refused] :
         {std::tuple{"G", 4u, true}, {"VarMean.B", 4u, true}, {"VarMean.B", 1u, false}, {"Depth.Z", 4u, false}}) {
        Image image = read_image(in("pt1.exr"));
        image.samples = samples;
        image.add(channel)[3 * 16 + 5] = NAN, image.add(channel)[4 * 16 + 5] = INFINITY;
        EXPECT_THROW(write_image(image, in("bad.exr")), NonfiniteError);
        std::filesystem::rename(not_finite_name(in("bad.exr")), in("bad.exr"));
        for (const std::string& order : {with_pt2, " " + in("pt2.exr") + " -r " + in("bad.exr")}) {
            const Outcome got = sh(stage("compare") + order);
            EXPECT_EQ(got.code, refused ? 2 : 0) << channel << got.err;
            if (refused) {
                EXPECT_NE(got.err.find(std::string("bad.exr: values that are NaN or infinite: 2 of ") + channel +
                                       " (first in pixel (5, 3))"),
                          std::string::npos)
                    << got.err;
            }
        }
    }
}

TEST_F(Compare, ReplicatesAndTheirFiles) {
    const std::string replicates = " pt=" + in("pt1.exr") + " pt=" + in("pt2.exr");
    const Outcome tsv = sh(stage("compare") + replicates + " -r " + in("pt3.exr") + " --cost --tsv --scene box");
    EXPECT_EQ(tsv.code, 0) << tsv.err;
    std::istringstream lines(tsv.out);
    std::string head, first, second, rest;
    std::getline(lines, head), std::getline(lines, first), std::getline(lines, second);
    EXPECT_EQ(head.find("scene\tmethod\tsamples\treplicate\tfile\tmse\trelmse\t"), 0u) << head;
    EXPECT_EQ(first.find("box\tpt\t4\t0\t"), 0u) << first;
    EXPECT_EQ(second.find("box\tpt\t4\t1\t"), 0u) << second;
    EXPECT_EQ(std::count(first.begin(), first.end(), '\t'), std::count(head.begin(), head.end(), '\t'));
    EXPECT_FALSE(std::getline(lines, rest));

    // The remaining error without the reference's own noise; costs of a file without parents are its own.
    const auto value = [&](const std::string& line, const std::string& column) {
        std::istringstream names(head), cells(line);
        std::string name, cell;
        while (std::getline(names, name, '\t') && std::getline(cells, cell, '\t') && name != column) {
        }
        return std::stod(cell);
    };
    EXPECT_GT(value(first, "reference_noise"), 0);
    EXPECT_NEAR(value(first, "relmse_net"), value(first, "relmse") - value(first, "reference_noise"), 1e-12);
    const Image reference = read_image(folder / "pt3.exr");
    double variance = 0;
    for (const char* c : {"VarMean.R", "VarMean.G", "VarMean.B"})
        for (const float v : reference.find(c)) variance += double(v) / double(3 * reference.n_pixels());
    EXPECT_NEAR(value(first, "mse_net"), value(first, "mse") - variance, 1e-6 * variance);
    const std::string cost = bytes_of(folder / "pt1.exr.cost.json");
    EXPECT_EQ(value(first, "cpu_s"), std::stod(cost.substr(cost.find("\"cpu_s\": ") + 9)));
    // Reading the scene is part of it, and apart.
    const double load_s = std::stod(cost.substr(cost.find("\"load_s\": ") + 10));
    EXPECT_GT(load_s, 0);
    EXPECT_NEAR(value(first, "render_s"), value(first, "cpu_s") - load_s, 1e-12);
    EXPECT_EQ(value(first, "rays"), std::stod(cost.substr(cost.find("\"rays\": ") + 8)));

    // Two files with the same noise are no replicates; sizes must agree.
    EXPECT_EQ(sh(stage("compare") + " pt=" + in("pt1.exr") + " pt=" + in("pt1.exr") + " -r " + in("pt3.exr")).code, 2);
    ASSERT_EQ(sh(stage("trace") + " scenes/cornell-box.xml -D resx=8 -D resy=16 --spp 1 -o " + in("s.exr")).code, 0);
    EXPECT_EQ(sh(stage("compare") + " " + in("s.exr") + " " + in("pt3.exr")).code, 2);

    ASSERT_EQ(sh(stage("compare") + replicates + " -r " + in("pt3.exr") + " --difference " + in("d.exr")).code, 0);
    for (const char* name : {"d.exr", "d.png", "d-tiles.png"}) EXPECT_TRUE(fs::exists(folder / name)) << name;
}

// The graphs of all passes but the last are gone; their costs are not.
TEST_F(Compare, CostsOutliveTheFiles) {
    ASSERT_EQ(
        sh(still("x", "SCENE=scenes/cornell-box.xml DEFINES='resx=16 resy=16' METHOD=graph SPP=1 PASSES=2") + " image")
            .code,
        0);
    ASSERT_FALSE(fs::exists(folder / "x/graph/pass-0.h5"));
    const std::string run = stage("compare") + " --cost --tsv x=" + in("x/image.exr");
    const Outcome costs = sh(run);
    EXPECT_EQ(costs.code, 0) << costs.err;
    EXPECT_NE(costs.out.find("\tloom-trace\t2\t"), std::string::npos) << costs.out;
    EXPECT_NE(costs.out.find("\tloom-gather\t2\t"), std::string::npos) << costs.out;
    EXPECT_NE(costs.out.find("\tloom-merge\t1\t"), std::string::npos) << costs.out;

    fs::remove(folder / "x/graph/pass-0.h5.cost.json");
    const Outcome missing = sh(run);
    EXPECT_EQ(missing.code, 2);
    EXPECT_EQ(missing.out, "");
    EXPECT_NE(missing.err.find("make " + in("x/graph/pass-0.h5") + " again"), std::string::npos) << missing.err;
}

class Chart : public PipelineTest {
  protected:
    std::string chart(const std::string& variables) const {
        return "make -s -f pipelines/chart.mk BUILD='" + fs::path(LOOM_BIN_DIR).parent_path().string() +
               "' OUT=" + (folder / "c").string() +
               " SCENE=scenes/cornell-box.xml DEFINES='resx=16 resy=16' REFERENCE_SPP=16 REPLICATES=2 " + variables;
    }
};

TEST_F(Chart, FromSceneToChartAndOn) {
    const Outcome made = sh(chart("SPPS='1 4'"));
    ASSERT_EQ(made.code, 0) << made.err;
    EXPECT_NE(made.out.find((folder / "c/error-cost.png").string() + "\n"), std::string::npos) << made.out;
    for (const char* name :
         {"error-cost.svg", "error-cost.png", "error-cost.tsv", "error-cost.gp", "stages.svg", "bias-variance.svg",
          "error-cost.equal-cost.tsv", "error-cost.equal-error.tsv", "stages.png", "errors.tsv"})
        EXPECT_TRUE(fs::exists(folder / "c" / name)) << name;
    const auto rows = [&] {
        const std::string text = bytes_of(folder / "c/errors.tsv");
        return std::count(text.begin(), text.end(), '\n') - 1;
    };
    EXPECT_EQ(rows(), 8);

    // Making the table again gives the same bytes.
    const std::string again = "mkdir " + (folder / "again").string() + " && " + stage("chart") + " " +
                              (folder / "c/errors.tsv").string() + " -o " + (folder / "again/error-cost.svg").string();
    ASSERT_EQ(sh(again).code, 0);
    for (const char* name : {"error-cost.svg", "error-cost.png", "error-cost.tsv", "error-cost.gp"})
        EXPECT_TRUE(bytes_of(folder / "c" / name) == bytes_of(folder / "again" / name)) << name;
    for (const auto& [name, table, kind] :
         {std::tuple{"bias-variance", "errors", "parts"}, {"stages", "costs", "stages"}}) {
        const std::string other = (folder / "again" / name).string();
        const Outcome made_again = sh(stage("chart") + " " + (folder / "c" / table).string() + ".tsv --kind " + kind +
                                      " -o " + other + ".svg");
        ASSERT_EQ(made_again.code, 0) << made_again.err;
        for (const char* ending : {".svg", ".png", ".tsv", ".gp"})
            EXPECT_TRUE(bytes_of(folder / "c" / (std::string(name) + ending)) == bytes_of(other + ending))
                << name << ending;
    }
    // The command file alone makes the images again.
    ASSERT_EQ(sh("cd " + (folder / "again").string() + " && rm error-cost.svg && gnuplot error-cost.gp").code, 0);
    EXPECT_TRUE(bytes_of(folder / "c/error-cost.svg") == bytes_of(folder / "again/error-cost.svg"));

    // A second make does nothing; another number of samples keeps the existing images.
    const auto old_table = fs::last_write_time(folder / "c/errors.tsv");
    const auto old_image = fs::last_write_time(folder / "c/pt-1-0/image.exr");
    ASSERT_EQ(sh(chart("SPPS='1 4'")).code, 0);
    EXPECT_EQ(fs::last_write_time(folder / "c/errors.tsv"), old_table);
    ASSERT_EQ(sh(chart("SPPS='1 2 4'")).code, 0);
    EXPECT_EQ(rows(), 12);
    EXPECT_EQ(fs::last_write_time(folder / "c/pt-1-0/image.exr"), old_image);
    // Another cost: other charts of the same tables.
    ASSERT_EQ(sh(chart("SPPS='1 2 4' COST=render_s")).code, 0);
    EXPECT_NE(bytes_of(folder / "c/stages.gp").find("--x render_s"), std::string::npos);
    EXPECT_EQ(fs::last_write_time(folder / "c/pt-1-0/image.exr"), old_image);
}

// Two scenes, a panel each; copies for the documentation; nothing is made twice.
TEST_F(Chart, ManyScenes) {
    const std::string all = "make -s -f pipelines/chart-all.mk BUILD='" +
                            fs::path(LOOM_BIN_DIR).parent_path().string() + "' OUT=" + (folder / "all").string() +
                            " DOCS=" + (folder / "docs").string() +
                            " SCENES='scenes/cornell-box.xml scenes/glossy-box.xml' REFERENCES=none SIZE=16 "
                            "REFERENCE_SPP=16 SPPS='1 4' REPLICATES=2 METHODS='pt graph'";
    const Outcome made = sh(all);
    ASSERT_EQ(made.code, 0) << made.err;
    EXPECT_TRUE(made.out.ends_with((folder / "all/all.png").string() + "\n")) << made.out;
    const std::string data = bytes_of(folder / "all/all.tsv");
    EXPECT_NE(data.find("cornell-box\tpt\t"), std::string::npos) << data;
    EXPECT_NE(data.find("glossy-box\tgraph\t"), std::string::npos) << data;
    EXPECT_NE(data.find("\trender_s\t"), std::string::npos) << data;
    EXPECT_TRUE(fs::exists(folder / "docs/charts/all.svg"));
    EXPECT_TRUE(fs::exists(folder / "docs/charts/glossy-box-bias-variance.svg"));
    const auto old_table = fs::last_write_time(folder / "all/glossy-box/errors.tsv");
    const std::string old_chart = bytes_of(folder / "all/all.svg");
    ASSERT_EQ(sh(all).code, 0);
    EXPECT_EQ(fs::last_write_time(folder / "all/glossy-box/errors.tsv"), old_table);
    EXPECT_TRUE(bytes_of(folder / "all/all.svg") == old_chart);
}

TEST_F(Chart, WrongVariablesAreRefused) {
    for (const char* wrong : {"METHODS='pt none'", "SPPS='1 x'", "SPPS=6", "REPLICATES=0", "REFERENCE=missing.exr"})
        EXPECT_EQ(sh(chart("SPPS=1 " + std::string(wrong))).code, 2) << wrong;
}

// t.svg has its data beside it as t.tsv.
TEST_F(Chart, ATableIsNotOverwritten) {
    const std::string table = "method\tcpu_s\trelmse\npt\t1\t1\npt\t2\t0.5\n";
    std::ofstream(folder / "t.tsv") << table;
    const Outcome made =
        sh("cd " + folder.string() + " && " + stage("chart") + " t.tsv -o " + (folder / "t.svg").string());
    EXPECT_EQ(made.code, 2);
    EXPECT_NE(made.err.find("t.tsv: the chart's own data would overwrite this table"), std::string::npos) << made.err;
    EXPECT_EQ(bytes_of(folder / "t.tsv"), table);
}

TEST_F(Chart, MissingGnuplotIsNamed) {
    std::ofstream(folder / "t.tsv") << "method\tcpu_s\trelmse\npt\t1\t1\npt\t2\t0.5\n";
    const std::string run = stage("chart") + " " + (folder / "t.tsv").string() + " -o " + (folder / "x.svg").string();
    const Outcome without = sh("PATH=/nowhere " + run);
    EXPECT_EQ(without.code, 2);
    EXPECT_NE(without.err.find("gnuplot-nox"), std::string::npos) << without.err;
    EXPECT_EQ(files(), std::vector<std::string>{"t.tsv"});
}

}  // namespace
}  // namespace loom::pipeline
