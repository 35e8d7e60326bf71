// Curves with known slope, front and crossings.

#include "stages/chart/chart.h"

#include <gtest/gtest.h>

#include <cmath>

#include "formats/io/error.h"
#include "stages/core/stats/student.h"

namespace loom::chart {
namespace {

std::string error_of(const std::function<void()>& body) {
    try {
        body();
    } catch (const InputError& error) {
        return error.what();
    }
    return "nothing was thrown";
}

/// error = a / cost at costs 1, 4, 16; `spread`: replicates at (1 - spread), 1 and (1 + spread) of it.
void add_method(Table& table, const std::string& method, double a, double cost_scale, double spread) {
    for (double samples : {1.0, 4.0, 16.0}) {
        for (double factor : {1 - spread, 1.0, 1 + spread}) {
            const double cost = cost_scale * samples;
            table.rows.push_back(
                {"box", method, std::to_string(int(samples)), std::to_string(cost), std::to_string(factor * a / cost)});
            if (spread == 0) break;
        }
    }
}

Table two_methods(double spread) {
    Table table{"t.tsv", {"scene", "method", "samples", "cpu_s", "relmse"}, {}};
    add_method(table, "pt", 8, 1, spread);
    add_method(table, "graph", 2, 2, spread);
    return table;
}

TEST(Chart, SlopesOfPowerLaws) {
    for (double spread : {0.0, 0.1}) {
        const auto curves = curves_of(two_methods(spread), "cpu_s", "relmse", "method");
        ASSERT_EQ(curves.size(), 2u);
        EXPECT_EQ(curves[0].method, "pt");
        ASSERT_EQ(curves[0].points.size(), 3u);
        EXPECT_EQ(curves[0].points[0].errors.size(), spread == 0 ? 1u : 3u);
        EXPECT_NEAR(curves[0].slope.mean, -1, 1e-5);
        EXPECT_NEAR(curves[0].slope.se, 0, 1e-5);
        EXPECT_NEAR(curves[0].points[1].low, 2 * (1 - spread), 1e-5);
        EXPECT_NEAR(curves[0].points[1].high, 2 * (1 + spread), 1e-5);
    }
    EXPECT_TRUE(std::isnan(fit_slope({Point{}}).mean));
}

// Replicates of slopes -1 and -1/2 (by hand): mean slope of the logs of the means apart, error of the slope 1/4.
TEST(Chart, ErrorOfTheSlopeIsFromReplicates) {
    Table table{"t.tsv", {"method", "samples", "cpu_s", "relmse"}, {}};
    table.rows = {
        {"pt", "1", "1", "1"}, {"pt", "1", "1", "1"}, {"pt", "16", "16", "0.0625"}, {"pt", "16", "16", "0.25"}};
    const auto curves = curves_of(table, "cpu_s", "relmse", "method");
    EXPECT_NEAR(curves[0].slope.mean, std::log(0.15625) / std::log(16), 1e-12);
    EXPECT_NEAR(curves[0].slope.se, 0.25, 1e-12);
    EXPECT_EQ(curves[0].slope.dof, 1);
}

// graph has a quarter of pt's error at equal cost, and a quarter of its cost at equal error.
TEST(Chart, EqualCostAndEqualError) {
    const auto curves = curves_of(two_methods(0), "cpu_s", "relmse", "method");
    const auto by_cost = equal_cost(curves), by_error = equal_error(curves);
    // Costs 1, 4, 16 and 2, 8, 32: both reach 2, 4, 8, 16. Errors 8, 2, 0.5 and 1, 0.25, 0.0625: 0.5 and 1.
    ASSERT_EQ(by_cost.size(), 4u);
    ASSERT_EQ(by_error.size(), 2u);
    for (const auto* matches : {&by_cost, &by_error}) {
        for (const Match& m : *matches) {
            EXPECT_EQ(m.first, "pt");
            EXPECT_EQ(m.method, "graph");
            EXPECT_NEAR(m.ratio, 4, 1e-4);
            EXPECT_NEAR(m.value_first / m.value_method, 4, 1e-4);
            EXPECT_TRUE(std::isnan(m.low));
        }
    }
    EXPECT_NEAR(by_cost[0].level, 2, 1e-12);
    EXPECT_NEAR(by_cost[0].value_first, 4, 1e-4);
    EXPECT_NEAR(by_error[0].level, 0.5, 1e-12);
    EXPECT_NEAR(by_error[0].value_first, 16, 1e-3);
}

// At cost 4 pt is measured and graph half way between two points: se 0.1/sqrt(3) and that over sqrt(2).
TEST(Chart, IntervalsOfRatios) {
    const auto matches = equal_cost(curves_of(two_methods(0.1), "cpu_s", "relmse", "method"));
    const double se = 0.1 / std::sqrt(3.0), va = se * se, vb = va / 2;
    const double dof = (va + vb) * (va + vb) / (va * va / 2 + vb * vb / 2);
    const double reach = student_critical(0.05, dof) * std::sqrt(va + vb);
    EXPECT_NEAR(matches[1].level, 4, 1e-12);
    EXPECT_NEAR(matches[1].low, 4 * std::exp(-reach), 1e-4);
    EXPECT_NEAR(matches[1].high, 4 * std::exp(reach), 1e-4);
}

TEST(Chart, ParetoFront) {
    const auto curves = curves_of(two_methods(0), "cpu_s", "relmse", "method");
    // Of pt only the cheapest: (4, 2) and (16, 0.5) have graph's (2, 1) and (8, 0.25) below and left of them.
    EXPECT_TRUE(curves[0].points[0].on_front);
    EXPECT_FALSE(curves[0].points[1].on_front);
    EXPECT_FALSE(curves[0].points[2].on_front);
    for (const Point& point : curves[1].points) EXPECT_TRUE(point.on_front);
}

TEST(Chart, BadTablesSayWhatIsWrong) {
    Table table = two_methods(0);
    EXPECT_EQ(error_of([&] { curves_of(table, "cpu", "relmse", "method"); }),
              "t.tsv: has no column cpu; there are scene, method, samples, cpu_s, relmse");
    table.rows[1][4] = "-0.5";
    EXPECT_EQ(error_of([&] { curves_of(table, "cpu_s", "relmse", "method"); }),
              "t.tsv: row 2, relmse: -0.5 must be above 0 on a log axis");
    table.rows[1][4] = "much";
    EXPECT_EQ(error_of([&] { curves_of(table, "cpu_s", "relmse", "method"); }),
              "t.tsv: row 2, relmse: 'much' is not a number");
}

// Bars of mean seconds per sample, one after the other, stages in the order of the chain of both methods.
TEST(Chart, StageBars) {
    const Table table{"s.tsv",
                      {"scene", "method", "samples", "replicate", "file", "stage", "cpu_s"},
                      {{"", "pt", "4", "0", "c", "loom-trace", "4"},
                       {"", "pt", "4", "0", "c", "loom-merge", "1"},
                       {"", "graph", "4", "0", "a", "loom-trace", "4"},
                       {"", "graph", "4", "0", "a", "loom-gather", "8"},
                       {"", "graph", "4", "1", "b", "loom-trace", "12"},
                       {"", "graph", "4", "1", "b", "loom-gather", "0"}}};
    const Files files = stage_files("bars", table, {});
    EXPECT_EQ(files.at("bars.tsv"),
              "scene\tmethod\tsamples\tstage\tbar\tbegin_s\tend_s\n"
              "\tpt\t4\tloom-trace\t0\t0\t1\n"
              "\tgraph\t4\tloom-trace\t1\t0\t2\n"
              "\tgraph\t4\tloom-gather\t1\t2\t3\n"
              "\tpt\t4\tloom-merge\t0\t1\t1.25\n");
}

// Variance of both replicates is one number of their group; a squared bias that is not above 0 has no point.
TEST(Chart, PartsOfTheError) {
    const Table table{"e.tsv",
                      {"method", "samples", "cpu_s", "variance", "bias2"},
                      {{"pt", "1", "1", "0.5", "-0.01"},
                       {"pt", "1", "3", "0.5", "-0.01"},
                       {"pt", "4", "8", "0.125", "0.002"},
                       {"pt", "4", "8", "0.125", "0.002"}}};
    const Files files = part_files("parts", table, {});
    EXPECT_EQ(files.at("parts.tsv"),
              "scene\tmethod\tpart\tcpu_s\tvalue\n"
              "\tpt\tvariance\t2\t0.5\n"
              "\tpt\tvariance\t8\t0.125\n"
              "\tpt\tbias2\t8\t0.002\n");
    EXPECT_NE(files.at("parts.gp").find("every ::3::3 using 4:5 with linespoints lw 2 dt 2 pt 6"), std::string::npos);
    Table unknown = table;
    for (auto& row : unknown.rows) row[3] = row[4] = "nan";
    EXPECT_NE(error_of([&] { part_files("parts", unknown, {}); }).find("has neither variance nor bias2"),
              std::string::npos);
}

// A linear axis has neither slopes nor a front; the command that made a chart is the first line of its commands.
TEST(Chart, LinearAxisAndCommand) {
    Options options;
    options.linear_x = true;
    options.command = "loom-chart t.tsv";
    const Files files = curve_files("c", curves_of(two_methods(0), "cpu_s", "relmse", "method"), options);
    const std::string& commands = files.at("c.gp");
    EXPECT_EQ(commands.find("# loom-chart t.tsv\n# gnuplot c.gp\n"), 0u);
    EXPECT_NE(commands.find("set logscale y\n"), std::string::npos);
    EXPECT_NE(commands.find("set xrange [0.5:32.5]"), std::string::npos);
    EXPECT_EQ(commands.find("slope"), std::string::npos);
    EXPECT_EQ(commands.find("Pareto"), std::string::npos);
}

// Columns that are no trade-off: logarithmic axes and slopes, no front, and a key that covers no curve.
TEST(Chart, NoFrontWhereNothingIsTraded) {
    Options options;
    const auto curves = curves_of(two_methods(0), "cpu_s", "relmse", "method");
    EXPECT_NE(curve_files("c", curves, options).at("c.gp").find("Pareto"), std::string::npos);
    options.no_front = true;
    const Files files = curve_files("c", curves, options);
    const std::string& commands = files.at("c.gp");
    EXPECT_EQ(commands.find("Pareto"), std::string::npos);
    EXPECT_NE(commands.find("slope"), std::string::npos);
    EXPECT_NE(commands.find("set key outside"), std::string::npos);
}

// A name with a quote must not end gnuplot's string, let alone start a command.
TEST(Chart, NamesAreQuoted) {
    Table table = two_methods(0);
    for (auto& row : table.rows) row[1] = "it's `x`";
    const Files files = curve_files("c", curves_of(table, "samples", "relmse", "method"), {});
    EXPECT_NE(files.at("c.gp").find("title 'it''s `x`"), std::string::npos);
}

// What is not known is in no panel, and no frame without it in its curve.
TEST(Chart, FramesHaveAPanelForEachKnownQuantity) {
    const Table table{"t.tsv",
                      {"scene", "method", "frame", "render_s", "touched", "expected_relmse"},
                      {{"a", "hybrid", "3", "0.5", "0.25", "0.01"},
                       {"a", "hybrid", "4", "0.25", "nan", "0"},
                       {"a", "pt", "3", "2", "nan", "0.125"}}};
    const Files files = frame_files("f", table, {});
    EXPECT_EQ(
        files.at("f.tsv"),
        "method\tframe\tvalue\tquantity\nhybrid\t3\t0.5\trender_s\nhybrid\t4\t0.25\trender_s\npt\t3\t2\trender_s\n"
        "hybrid\t3\t25\ttouched\nhybrid\t3\t0.01\texpected_relmse\npt\t3\t0.125\texpected_relmse\n");
    const std::string& commands = files.at("f.gp");
    EXPECT_NE(commands.find("layout 3,1"), std::string::npos);
    EXPECT_NE(commands.find("every ::1::2 using 2:3"), std::string::npos);
    EXPECT_NE(commands.find("every ::6::6 using 2:3"), std::string::npos);
    Table unknown = table;
    for (auto& row : unknown.rows) row[3] = row[4] = row[5] = "nan";
    EXPECT_NE(error_of([&] { frame_files("f", unknown, {}); }).find("no number to draw"), std::string::npos);
}

TEST(Chart, SpectraHaveAPlaceForFrequencyZero) {
    const Table table{"t.tsv",
                      {"scene", "method", "frequency", "power"},
                      {{"a", "x", "0", "0.5"}, {"a", "x", "0.5", "0"}, {"b", "y", "0", "2"}, {"a", "y", "0.25", "1"}}};
    const Files files = spectrum_files("f", table, {});
    EXPECT_EQ(files.at("f.tsv"), "scene\tmethod\tfrequency\tpower\na\tx\t0\t0.5\na\ty\t0.25\t1\nb\ty\t0\t2\n");
    EXPECT_NE(files.at("f.gp").find("every ::3::3 using 3:4"), std::string::npos);
}

}  // namespace
}  // namespace loom::chart
