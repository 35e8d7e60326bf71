#include "stages/chart/chart.h"

#include <fmt/format.h>

#include <cmath>
#include <filesystem>

#include "formats/io/error.h"
#include "formats/io/output_file.h"
#include "stages/core/app/command.h"
#include "stages/core/plot/gnuplot.h"

namespace loom::chart {
namespace {

std::string match_lines(const std::vector<Match>& matches, const std::string& equal, const std::string& what) {
    std::string text;
    for (const Match& m : matches) {
        const bool better = m.ratio >= 1;
        text += fmt::format("{}{} at equal {} {:.3g}: {} {:.3g} against {:.3g} of {}, {:.3g} times {}",
                            m.scene.empty() ? "" : m.scene + ": ", m.method, equal, m.level, what, m.value_method,
                            m.value_first, m.first, better ? m.ratio : 1 / m.ratio, better ? "better" : "worse");
        if (!std::isnan(m.low)) {
            text += fmt::format(" ({:.3g} to {:.3g}, 95 %)", better ? m.low : 1 / m.high, better ? m.high : 1 / m.low);
        }
        text += "\n";
    }
    return text;
}

}  // namespace

std::string summary(const std::vector<Curve>& curves, const Options& options) {
    std::string text;
    for (const Curve& curve : curves) {
        if (std::isnan(curve.slope.mean)) continue;
        text += fmt::format("{}{}: {} falls as {}^{:.3f}", curve.scene.empty() ? "" : curve.scene + ": ", curve.method,
                            options.y, options.x, curve.slope.mean);
        if (!std::isnan(curve.slope.se)) text += fmt::format(" ± {:.2g}", curve.slope.se);
        text += "\n";
    }
    text += match_lines(equal_cost(curves), options.x, options.y);
    return text + match_lines(equal_error(curves), options.y, options.x);
}

void declare(app::Command& command, Options& options) {
    command.files("tables", options.tables, "tables (TSV) of loom-compare --tsv, with a header line").required();
    command.output("-o,--output", options.output, "chart.svg; beside it chart.png, .tsv (data), .gp (commands), tables")
        .required();
    command.choice<Kind>(
        "--kind", options.kind,
        "curves: error against cost; parts: bias and variance against cost; stages: time by stage "
        "(from loom-compare --cost --tsv); frames: cost, touched share and expected error of frames "
        "(from loom-compare --by-frame); spectrum: power of errors in time (from loom-compare --spectrum)",
        {{"curves", Kind::curves},
         {"parts", Kind::parts},
         {"stages", Kind::stages},
         {"frames", Kind::frames},
         {"spectrum", Kind::spectrum}});
    command.option("--x", options.x, "column of the x axis (cpu_s, wall_s, samples, iteration, …)");
    command.option("--y", options.y, "column of the y axis");
    command.option("--by", options.by, "column whose values name the curves");
    command.flag("--linear-x", options.linear_x,
                 "linear x axis, for quantities that fall by a constant factor per step");
    command.flag("--no-front", options.no_front, "leave out the Pareto front, for columns that are no trade-off");
    command.option("--title", options.title, "title above the chart");
    command.example("loom-chart errors.tsv -o error-cost.svg --x wall_s --y relmse_trimmed");
}

void run(const Options& given, app::Report& report) {
    Options options = given;
    options.command = report.command();
    const std::filesystem::path svg = options.output;
    if (svg.extension() != ".svg") throw InputError(fmt::format("{}: the output must end in .svg", options.output));
    check_output_path(svg);
    const std::string stem = svg.stem();
    const Table table = read_tables(options.tables);
    Files files;
    if (options.kind == Kind::stages) {
        files = stage_files(stem, table, options);
    } else if (options.kind == Kind::parts) {
        files = part_files(stem, table, options);
    } else if (options.kind == Kind::frames) {
        files = frame_files(stem, table, options);
    } else if (options.kind == Kind::spectrum) {
        files = spectrum_files(stem, table, options);
    } else {
        const std::vector<Curve> curves = curves_of(table, options.x, options.y, options.by);
        files = curve_files(stem, curves, options);
        report.answer(summary(curves, options));
    }
    for (const auto& [name, text] : files) {
        const std::filesystem::path written = svg.parent_path() / name;
        for (const std::string& input : options.tables) {
            std::error_code none;
            if (std::filesystem::equivalent(written, input, none))
                throw InputError(fmt::format("{}: the chart's own data would overwrite this table", input));
        }
    }
    plot::make_pictures(svg.parent_path(), files, stem + ".gp", {stem + ".svg", stem + ".png"});
    report.done("{}: {} rows", options.output, table.rows.size());
}

}  // namespace loom::chart
