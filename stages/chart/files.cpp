#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numeric>

#include "formats/io/error.h"
#include "stages/chart/chart.h"
#include "stages/core/plot/gnuplot.h"

namespace loom::chart {
namespace {

/// Distinguishable with any kind of colour vision.
constexpr std::array<const char*, 7> colours{"#0072b2", "#d55e00", "#009e73", "#cc79a7",
                                             "#e69f00", "#56b4e9", "#555555"};
constexpr std::array<int, 7> markers{7, 5, 9, 11, 13, 15, 4};

using plot::in_quotes;

std::string words_for(const std::string& column) {
    static const std::map<std::string, std::string> words{{"cpu_s", "CPU time (s)"},
                                                          {"wall_s", "wall time (s)"},
                                                          {"render_s", "render time (CPU s)"},
                                                          {"samples", "samples per pixel"},
                                                          {"relmse", "relMSE"},
                                                          {"relmse_trimmed", "relMSE, 0.1 % trimmed"},
                                                          {"relmse_net", "relMSE less the reference's noise"},
                                                          {"mse", "MSE"},
                                                          {"mse_net", "MSE less the reference's noise"},
                                                          {"rmse", "RMSE"},
                                                          {"mape", "MAPE"},
                                                          {"frames", "number of frames"},
                                                          {"frame_s", "CPU time of a frame (s)"},
                                                          {"flicker", "flicker"},
                                                          {"gain", "times better than path tracing, all costs counted"},
                                                          {"frequency", "cycles per frame"},
                                                          {"power", "power of the error"},
                                                          {"iteration", "step of the refinement"},
                                                          {"residual", "change of radiance, as a share"}};
    const auto at = words.find(column);
    return at == words.end() ? column : at->second;
}

/// Range of a log axis around values, and its ticks: 1, 2, 5 of each decade, or decades only where there are many.
struct LogAxis {
    double low = std::numeric_limits<double>::infinity(), high = 0;
    void add(double value) {
        low = std::min(low, value);
        high = std::max(high, value);
    }
    std::string commands(const std::string& name) const {
        const double from = low / 1.4, to = high * 1.4;
        const bool many = std::log10(to / from) > 3;
        std::string ticks;
        for (int decade = int(std::floor(std::log10(from))); decade <= int(std::ceil(std::log10(to))); ++decade) {
            for (int step : {1, 2, 5}) {
                if (many && step > 1) continue;
                const double value = double(step) * std::pow(10.0, decade);
                if (value >= from && value <= to) ticks += fmt::format("{}{:.6g}", ticks.empty() ? "" : ", ", value);
            }
        }
        return fmt::format("set {0}range [{1:.6g}:{2:.6g}]\nset {0}tics ({3})\n", name, from, to, ticks);
    }
};

/// Makes both images with one set of commands.
std::string script(const std::string& stem, int width, int height, const std::string& body, const Options& options) {
    return fmt::format(
        "{7}# gnuplot {0}.gp\n"
        "set datafile separator '\\t'\n"
        "set encoding utf8\n"
        "set style line 100 lc rgb '#d8d8d8' lw 1\n"
        "set style line 101 lc rgb '#555555' lw 1\n"
        "set border 3 ls 101\n"
        "set tics nomirror\n"
        "set grid xtics ytics back ls 100\n"
        "set key top right samplen 2 spacing 1.3\n"
        "set format '%g'\n"
        "do for [picture in 'svg png'] {{\n"
        "if (picture eq 'svg') {{\n"
        "set terminal svg size {1},{2} noenhanced font 'DejaVu Sans,14' background '#ffffff'\n"
        "}} else {{\n"
        "set terminal pngcairo size {3},{4} noenhanced font 'DejaVu Sans,14' fontscale 1.5 linewidth 1.5 "
        "pointscale "
        "1.5 "
        "background '#ffffff'\n"
        "}}\n"
        "set output {5}.picture\n"
        "{6}"
        "unset output\n"
        "}}\n",
        stem, width, height, 3 * width / 2, 3 * height / 2, in_quotes(stem + "."), body,
        options.command.empty() ? "" : fmt::format("# {}\n", options.command));
}

std::string match_table(const std::vector<Match>& matches, const std::string& equal, const std::string& what) {
    std::string text =
        fmt::format("scene\tfirst\tmethod\tequal_{0}\t{1}_first\t{1}_method\ttimes_better\tlow\thigh\n", equal, what);
    for (const Match& m : matches) {
        text += fmt::format("{}\t{}\t{}\t{}\t{}\t{}\t{}\t{}\t{}\n", m.scene, m.first, m.method, m.level, m.value_first,
                            m.value_method, m.ratio, m.low, m.high);
    }
    return text;
}

std::string slope_text(const Estimate& slope) {
    if (std::isnan(slope.mean)) return "";
    return std::isnan(slope.se) ? fmt::format(", slope {:.2f}", slope.mean)
                                : fmt::format(", slope {:.2f} ± {:.2f}", slope.mean, slope.se);
}

}  // namespace

Files curve_files(const std::string& stem, const std::vector<Curve>& curves, const Options& options) {
    const std::string data_name = stem + ".tsv";
    std::string data = fmt::format("scene\t{}\t{}\t{}\tse\tlow\thigh\tpareto\treplicates\tslope\tslope_se\n",
                                   options.by, options.x, options.y);
    std::vector<std::string> scenes, methods;
    for (const Curve& curve : curves) {
        for (auto [list, name] : {std::pair{&scenes, &curve.scene}, std::pair{&methods, &curve.method}})
            if (std::find(list->begin(), list->end(), *name) == list->end()) list->push_back(*name);
    }
    const int columns = int(std::min<std::size_t>(scenes.size(), 3));
    const int lines = (int(scenes.size()) + columns - 1) / columns;
    std::string body;
    if (scenes.size() > 1) {
        body += fmt::format("set multiplot layout {},{}{}\n", lines, columns,
                            options.title.empty() ? "" : " title " + in_quotes(options.title));
    }
    body +=
        fmt::format("set logscale {}\nset xlabel {}\nset ylabel {}\nset style fill transparent solid 0.2 noborder\n",
                    options.linear_x ? "y" : "xy", in_quotes(words_for(options.x)), in_quotes(words_for(options.y)));
    // Place the key outside where it would cover curves: when it is long, in a small panel, or above rising curves.
    if (methods.size() > 3 || scenes.size() > 1 || options.no_front) body += "set key outside top center horizontal\n";
    std::size_t row = 1;  // row of the data; 0 is the header
    for (const std::string& scene : scenes) {
        LogAxis x, y;
        std::string bands, drawn, front;
        for (const Curve& curve : curves) {
            if (curve.scene != scene) continue;
            const std::size_t last = row + curve.points.size() - 1;
            const std::string every = fmt::format("{} every ::{}::{}", in_quotes(data_name), row, last);
            const std::size_t style =
                std::size_t(std::find(methods.begin(), methods.end(), curve.method) - methods.begin());
            const char* colour = colours[style % colours.size()];
            bool has_band = false;
            for (const Point& p : curve.points) {
                x.add(p.cost);
                y.add(p.low), y.add(p.high);
                has_band = has_band || p.errors.size() > 1;
                data += fmt::format("{}\t{}\t{}\t{}\t{}\t{}\t{}\t{}\t{}\t{}\t{}\n", scene, curve.method, p.cost,
                                    p.error, p.se, p.low, p.high, int(p.on_front), p.errors.size(), curve.slope.mean,
                                    curve.slope.se);
            }
            if (has_band) bands += fmt::format("{} using 3:6:7 with filledcurves lc rgb '{}' notitle, ", every, colour);
            drawn += fmt::format("{} using 3:4 with linespoints lw 2 pt {} ps 1 lc rgb '{}' title {}, ", every,
                                 markers[style % markers.size()], colour,
                                 in_quotes(curve.method + (options.linear_x ? "" : slope_text(curve.slope))));
            row = last + 1;
            if (options.linear_x || options.no_front) continue;
            // One ring in the key is enough.
            front += fmt::format("{} using 3:($8 == 1 ? $4 : NaN) with points pt 6 ps 2 lw 1.5 lc rgb '#222222' {}, ",
                                 every, front.empty() ? "title 'Pareto front'" : "notitle");
        }
        const std::string title = scenes.size() > 1 || options.title.empty() ? scene : options.title;
        body += title.empty() ? "unset title\n" : fmt::format("set title {}\n", in_quotes(title));
        std::string plotted = bands + drawn + front;
        plotted.resize(plotted.size() - 2);
        body += (options.linear_x ? fmt::format("set xrange [{}:{}]\n", x.low - 0.5, x.high + 0.5) : x.commands("x")) +
                y.commands("y") + fmt::format("plot {}\n", plotted);
    }
    if (scenes.size() > 1) body += "unset multiplot\n";
    return {{stem + ".gp",
             script(stem, columns == 1 ? 800 : 560 * columns, columns == 1 ? 540 : 500 * lines, body, options)},
            {data_name, data},
            {stem + ".equal-cost.tsv", match_table(equal_cost(curves), options.x, options.y)},
            {stem + ".equal-error.tsv", match_table(equal_error(curves), options.y, options.x)}};
}

Files part_files(const std::string& stem, const Table& table, const Options& options) {
    struct Part {
        const char *column, *words, *dash;
        int marker;  // of the first method; an open marker is the filled one minus one
    };
    constexpr std::array<Part, 2> parts{{{"variance", "variance", "1", 0}, {"bias2", "bias²", "2", -1}}};
    std::string data = fmt::format("scene\t{}\tpart\t{}\tvalue\n", options.by, options.x), body;
    // Keep curves of rows that are positive (the axis is logarithmic), in the order of all.
    std::vector<std::string> scenes, methods;
    std::array<std::vector<Curve>, 2> curves;
    for (std::size_t k = 0; k < parts.size(); ++k) {
        Table positive = table;
        const std::size_t column = table.column(parts[k].column);
        positive.rows.clear();
        for (std::size_t row = 0; row < table.rows.size(); ++row)
            if (table.number(row, column) > 0) positive.rows.push_back(table.rows[row]);
        curves[k] = curves_of(positive, options.x, parts[k].column, options.by);
        for (const Curve& curve : curves[k]) {
            for (auto [list, name] : {std::pair{&scenes, &curve.scene}, std::pair{&methods, &curve.method}})
                if (std::find(list->begin(), list->end(), *name) == list->end()) list->push_back(*name);
        }
    }
    if (scenes.empty())
        throw InputError(
            fmt::format("{}: has neither variance nor bias2; compare replicates, or images with VarMean", table.file));
    const int columns = int(std::min<std::size_t>(scenes.size(), 3));
    const int lines = (int(scenes.size()) + columns - 1) / columns;
    if (scenes.size() > 1) body += fmt::format("set multiplot layout {},{}\n", lines, columns);
    body += fmt::format(
        "set logscale xy\nset xlabel {}\nset ylabel 'part of the {}'\n"
        "set key outside top center horizontal\n",
        in_quotes(words_for(options.x)), table.has("relmse") || !table.has("mse") ? "relMSE" : "MSE");
    std::size_t row = 1;  // row of the data; 0 is the header
    for (const std::string& scene : scenes) {
        LogAxis x, y;
        std::string plotted;
        for (std::size_t style = 0; style < methods.size(); ++style) {
            for (std::size_t k = 0; k < parts.size(); ++k) {
                const auto curve = std::find_if(curves[k].begin(), curves[k].end(), [&](const Curve& c) {
                    return c.scene == scene && c.method == methods[style];
                });
                if (curve == curves[k].end()) continue;
                for (const Point& p : curve->points) {
                    x.add(p.cost), y.add(p.error);
                    data +=
                        fmt::format("{}\t{}\t{}\t{}\t{}\n", scene, methods[style], parts[k].column, p.cost, p.error);
                }
                const std::size_t last = row + curve->points.size() - 1;
                plotted += fmt::format(
                    "{}{} every ::{}::{} using 4:5 with linespoints lw 2 dt {} pt {} ps 1 lc rgb '{}' title "
                    "{}",
                    plotted.empty() ? "" : ", ", in_quotes(stem + ".tsv"), row, last, parts[k].dash,
                    markers[style % markers.size()] + parts[k].marker, colours[style % colours.size()],
                    in_quotes(methods[style] + ", " + parts[k].words));
                row = last + 1;
            }
        }
        const std::string title = scenes.size() > 1 || options.title.empty() ? scene : options.title;
        body += title.empty() ? "unset title\n" : fmt::format("set title {}\n", in_quotes(title));
        body += x.commands("x") + y.commands("y") + fmt::format("plot {}\n", plotted);
    }
    if (scenes.size() > 1) body += "unset multiplot\n";
    return {{stem + ".gp",
             script(stem, columns == 1 ? 800 : 560 * columns, columns == 1 ? 540 : 500 * lines, body, options)},
            {stem + ".tsv", data}};
}

Files stage_files(const std::string& stem, const Table& table, const Options& options) {
    struct Bar {
        std::string scene, method, samples;
        std::map<std::string, double> time_of;  // [stage] sum over the replicates
        std::vector<std::string> replicates;
    };
    const std::size_t time = table.column(options.x), stage = table.column("stage"), by = table.column(options.by),
                      scene = table.column("scene"), samples = table.column("samples"), file = table.column("file");
    std::vector<Bar> bars;
    std::vector<std::string> stages;
    for (std::size_t i = 0; i < table.rows.size(); ++i) {
        const auto& cells = table.rows[i];
        auto bar = std::find_if(bars.begin(), bars.end(), [&](const Bar& b) {
            return b.scene == cells[scene] && b.method == cells[by] && b.samples == cells[samples];
        });
        if (bar == bars.end()) bar = bars.insert(bars.end(), {cells[scene], cells[by], cells[samples], {}, {}});
        if (std::find(bar->replicates.begin(), bar->replicates.end(), cells[file]) == bar->replicates.end())
            bar->replicates.push_back(cells[file]);
        // Order by the chain: a stage that only some methods have follows its predecessor.
        if (std::find(stages.begin(), stages.end(), cells[stage]) == stages.end()) {
            const bool begins = i == 0 || table.rows[i - 1][file] != cells[file];
            const auto before =
                begins ? stages.end() : std::find(stages.begin(), stages.end(), table.rows[i - 1][stage]);
            stages.insert(before == stages.end() ? before : before + 1, cells[stage]);
        }
        bar->time_of[cells[stage]] += table.number(i, time);
    }
    std::string data = fmt::format("scene\t{}\tsamples\tstage\tbar\tbegin_s\tend_s\n", options.by), ticks, plotted;
    const bool many_scenes =
        std::any_of(bars.begin(), bars.end(), [&](const Bar& b) { return b.scene != bars[0].scene; });
    std::vector<double> begin(bars.size());
    std::size_t row = 1;
    for (std::size_t s = 0; s < stages.size(); ++s) {
        const std::size_t first = row;
        for (std::size_t k = 0; k < bars.size(); ++k) {
            const Bar& bar = bars[k];
            const auto found = bar.time_of.find(stages[s]);
            if (found == bar.time_of.end()) continue;
            // An unknown number of samples counts as one.
            const double per = double(bar.replicates.size()) * std::max(1.0, std::stod(bar.samples));
            const double end = begin[k] + found->second / per;
            data += fmt::format("{}\t{}\t{}\t{}\t{}\t{}\t{}\n", bar.scene, bar.method, bar.samples, stages[s], k,
                                begin[k], end);
            begin[k] = end;
            ++row;
        }
        plotted += fmt::format(
            "{}{} every ::{}::{} using (($6 + $7) / 2):5:6:7:($5 - 0.36):($5 + 0.36) with boxxyerror "
            "fs solid 0.85 lc rgb '{}' title {}",
            s == 0 ? "" : ", ", in_quotes(stem + ".tsv"), first, row - 1, colours[s % colours.size()],
            in_quotes(stages[s]));
    }
    for (std::size_t k = 0; k < bars.size(); ++k) {
        const std::string name = (many_scenes ? bars[k].scene + ", " : "") + bars[k].method +
                                 (bars[k].samples == "0" ? "" : ", " + bars[k].samples + " spp");
        ticks += fmt::format("{}{} {}", k == 0 ? "" : ", ", in_quotes(name), k);
    }
    const std::string body = fmt::format(
        "{}set xlabel {}\nset xrange [0:*]\nset yrange [{}:-0.7]\nset ytics ({}) scale 0\nset grid noytics\n"
        "set key outside top center horizontal\nplot {}\n",
        options.title.empty() ? "" : "set title " + in_quotes(options.title) + "\n",
        in_quotes(words_for(options.x) + " per sample per pixel"), double(bars.size()) - 0.3, ticks, plotted);
    return {{stem + ".gp", script(stem, 800, 140 + 40 * int(bars.size()), body, options)}, {stem + ".tsv", data}};
}

Files frame_files(const std::string& stem, const Table& table, const Options& options) {
    struct Panel {
        const char *column, *words;
        double scale;
        bool is_log;
    };
    constexpr std::array<Panel, 3> all{{{"render_s", "CPU (s)", 1, false},
                                        {"touched", "traced again (%)", 100, false},
                                        {"expected_relmse", "expected relMSE", 1, true}}};
    const std::size_t x = table.column("frame"), by = table.column(options.by);
    const auto is_drawn = [&](std::size_t row, const Panel& panel) {
        const double value = table.number(row, table.column(panel.column));
        return panel.is_log ? value > 0 && std::isfinite(value) : std::isfinite(value);
    };
    std::vector<std::string> methods;
    double first = std::numeric_limits<double>::infinity(), last = -first;
    for (std::size_t row = 0; row < table.rows.size(); ++row) {
        const std::string& method = table.rows[row][by];
        if (std::find(methods.begin(), methods.end(), method) == methods.end()) methods.push_back(method);
        first = std::min(first, table.number(row, x)), last = std::max(last, table.number(row, x));
    }
    std::string data = fmt::format("{}\tframe\tvalue\tquantity\n", options.by), panels;
    std::size_t n_panels = 0, line = 1;
    for (const Panel& panel : all) {
        LogAxis y;
        std::string plotted;
        for (std::size_t m = 0; m < methods.size(); ++m) {
            const std::size_t begin = line;
            for (std::size_t row = 0; row < table.rows.size(); ++row) {
                if (table.rows[row][by] != methods[m] || !is_drawn(row, panel)) continue;
                const double value = panel.scale * table.number(row, table.column(panel.column));
                y.add(value);
                data += fmt::format("{}\t{}\t{}\t{}\n", methods[m], table.rows[row][x], value, panel.column);
                ++line;
            }
            if (line == begin) continue;
            plotted += fmt::format("{}{} every ::{}::{} using 2:3 with linespoints lw 2 pt {} ps 0.6 lc rgb '{}' {}",
                                   plotted.empty() ? "" : ", ", in_quotes(stem + ".tsv"), begin, line - 1,
                                   markers[m % markers.size()], colours[m % colours.size()],
                                   methods.size() > 1 && n_panels == 0 ? "title " + in_quotes(methods[m]) : "notitle");
        }
        if (plotted.empty()) continue;
        // Few ticks of a log axis lie in a narrow range.
        panels += (panel.is_log && y.high > 5 * y.low ? "set logscale y\n" + y.commands("y")
                                                      : "unset logscale y\nset ytics autofreq\nset yrange [0:*]\n") +
                  fmt::format("set ylabel {}\nplot {}\n", in_quotes(panel.words), plotted);
        ++n_panels;
    }
    if (n_panels == 0) throw InputError(fmt::format("{}: has no number to draw", table.file));
    const double margin = 0.02 * (last - first) + 0.5;
    std::string body =
        fmt::format("set multiplot layout {},1{}\nset xrange [{}:{}]\nset xlabel 'frame'\n", n_panels,
                    options.title.empty() ? "" : " title " + in_quotes(options.title), first - margin, last + margin);
    if (methods.size() > 1) body += "set key outside top center horizontal\n";
    body += "set lmargin 12\n" + panels + "unset multiplot\n";
    return {{stem + ".gp", script(stem, 800, int(60 + 220 * n_panels), body, options)}, {stem + ".tsv", data}};
}

Files spectrum_files(const std::string& stem, const Table& table, const Options& options) {
    const std::size_t x = table.column("frequency"), y = table.column("power"), by = table.column(options.by);
    const bool has_scenes = table.has("scene");
    std::vector<std::string> scenes, methods;
    const auto scene_of = [&](std::size_t row) {
        return has_scenes ? table.rows[row][table.column("scene")] : std::string();
    };
    for (std::size_t row = 0; row < table.rows.size(); ++row)
        for (const auto& [list, name] : {std::pair{&scenes, scene_of(row)}, std::pair{&methods, table.rows[row][by]}})
            if (std::find(list->begin(), list->end(), name) == list->end()) list->push_back(name);
    const int columns = int(std::min<std::size_t>(scenes.size(), 3));
    const int lines = (int(scenes.size()) + columns - 1) / columns;
    std::string data = fmt::format("scene\t{}\tfrequency\tpower\n", options.by),
                body = fmt::format("set multiplot layout {},{}{}\n", lines, columns,
                                   options.title.empty() ? "" : " title " + in_quotes(options.title)) +
                       fmt::format(
                           "set logscale y\nset xrange [-0.02:0.52]\nset xlabel {}\nset ylabel {}\n"
                           "set key outside top center horizontal\n",
                           in_quotes(words_for("frequency")), in_quotes(words_for("power")));
    std::size_t line = 1;
    for (const std::string& scene : scenes) {
        LogAxis power;
        std::string plotted;
        for (std::size_t m = 0; m < methods.size(); ++m) {
            const std::size_t begin = line;
            for (std::size_t row = 0; row < table.rows.size(); ++row) {
                // No power has no place on a log axis.
                if (scene_of(row) != scene || table.rows[row][by] != methods[m] || !(table.number(row, y) > 0))
                    continue;
                power.add(table.number(row, y));
                data += fmt::format("{}\t{}\t{}\t{}\n", scene, methods[m], table.number(row, x), table.number(row, y));
                ++line;
            }
            if (line == begin) continue;
            plotted +=
                fmt::format("{}{} every ::{}::{} using 3:4 with linespoints lw 2 pt {} ps 1 lc rgb '{}' title {}",
                            plotted.empty() ? "" : ", ", in_quotes(stem + ".tsv"), begin, line - 1,
                            markers[m % markers.size()], colours[m % colours.size()], in_quotes(methods[m]));
        }
        if (plotted.empty()) continue;
        body += (scene.empty() ? "unset title\n" : fmt::format("set title {}\n", in_quotes(scene))) +
                power.commands("y") + fmt::format("plot {}\n", plotted);
    }
    if (line == 1) throw InputError(fmt::format("{}: has no power to draw", table.file));
    body += "unset multiplot\n";
    return {{stem + ".gp",
             script(stem, columns == 1 ? 800 : 560 * columns, columns == 1 ? 540 : 500 * lines, body, options)},
            {stem + ".tsv", data}};
}

}  // namespace loom::chart
