#include "stages/fit/charts.h"

#include <fmt/format.h>

#include <algorithm>
#include <string>

#include "stages/core/plot/gnuplot.h"

namespace loom::fit {
namespace {

std::string one_line(std::string text) {
    for (char& c : text)
        if (static_cast<unsigned char>(c) < ' ') c = ' ';
    return text;
}

std::string table_of(const Fit& fit) {
    const auto& h = fit.history;
    std::string text = "evaluation\tmerged_bins\taccepted\tloss\tloss_sigma\tpaths";
    for (const std::string& name : fit.parameters.name) text += fmt::format("\t{}", one_line(name));
    for (std::size_t i = 0; i < fit.n_evaluations(); ++i)
        text += fmt::format("\n{}\t{}\t{}\t{}\t{}\t{}\t{}", i + 1, h.merged_bins[i], h.accepted[i], h.loss[i],
                            h.loss_sigma[i], h.paths[i], fmt::join(h.value.row(i, fit.n_parameters()), "\t"));
    return text + "\n";
}

}  // namespace

void draw_charts(const Fit& fit, const std::vector<std::optional<double>>& truth, const std::filesystem::path& folder) {
    const std::size_t n = fit.n_parameters(), end = fit.n_evaluations() + 1;
    // Merged bins, coarse to fine.
    std::vector<std::uint32_t> levels;
    for (const std::uint32_t merged : fit.history.merged_bins)
        if (std::find(levels.begin(), levels.end(), merged) == levels.end()) levels.push_back(merged);
    std::sort(levels.rbegin(), levels.rend());

    std::string loss = fmt::format(
        "set logscale y\nset format y '%.0e'\nset ylabel 'loss'\nset key outside right\nplot {} with lines lc rgb "
        "'#444444' dt 2 title "
        "'noise of the measurement'",
        fit.best.expected_loss > 0 ? fit.best.expected_loss : 1e-300);
    for (const std::uint32_t merged : levels)
        loss += fmt::format(
            ", 'fit.tsv' using 1:(column(2) == {0} && column(4) > 0 ? column(4) : NaN):(column(5)) skip 1 with "
            "yerrorbars pt 7 "
            "ps 0.6 title 'bins merged: {0}'",
            merged);
    std::string results, values = fmt::format("set multiplot layout {},1\nunset key\n", n);
    for (std::size_t i = 0; i < n; ++i) {
        results += fmt::format("$result{} << EOD\n{}\t{}\t{}\nEOD\n", i, end, fit.parameters.value[i], fit.sigma(i));
        values += fmt::format(
            "set ylabel {}\nplot {}'fit.tsv' using 1:(column({})) skip 1 with linespoints lc rgb '#3b6fb6' pt 7 ps "
            "0.5, "
            "$result{} using 1:2:3 with yerrorbars lc rgb '#c0392b' pt 7 ps 0.9\n",
            plot::in_quotes(fit.parameters.name[i]),
            truth[i] ? fmt::format("{} with lines lc rgb '#444444' dt 2, ", *truth[i]) : "", 8 + i, i);
    }
    values += "unset multiplot\n";
    const std::string head = fmt::format(
        "set encoding utf8\nset border lw 0.7 lc rgb '#444444'\nset grid lc rgb '#d8d8d8'\nset datafile separator "
        "'\\t'\nset xrange "
        "[0.5:{}]\nset xlabel 'evaluation'\nset lmargin 12\n",
        double(end) + 0.5);
    const auto both = [&](const char* name, double height, const std::string& commands) {
        return fmt::format(
            "do for [picture in 'svg png'] {{\nif (picture eq 'svg') {{\nset terminal svg size 760,{0} noenhanced font "
            "'DejaVu "
            "Sans,11' background '#ffffff'\n}} else {{\nset terminal pngcairo size 1140,{1} noenhanced font 'DejaVu "
            "Sans,14' "
            "background '#ffffff'\n}}\nset output '{2}.'.picture\n{3}\nunset output\n}}\nunset logscale y\nset format "
            "y '%g'\n",
            height, height * 1.5, name, commands);
    };
    plot::make_pictures(
        folder,
        {{"fit.tsv", table_of(fit)},
         {"fit.gp", results + head + both("loss", 400, loss) + both("parameters", 80 + 170 * double(n), values)}},
        "fit.gp", {"loss.svg", "loss.png", "parameters.svg", "parameters.png"});
}

}  // namespace loom::fit
