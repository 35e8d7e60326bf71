#pragma once
// loom-chart: charts from tables, and the tables behind the charts.

#include <map>
#include <string>
#include <vector>

#include "stages/chart/curves.h"

namespace loom::app {
class Command;
class Report;
}  // namespace loom::app

namespace loom::chart {

enum class Kind { curves, parts, stages };

struct Options {
    std::vector<std::string> tables;  // TSV
    std::string output;               // .svg; PNG, data and commands beside it
    Kind kind = Kind::curves;
    std::string x = "cpu_s";    // cost; of stages the only one
    std::string y = "relmse";   // error
    std::string by = "method";  // what tells curves apart
    bool linear_x = false;      // curves of what falls by a factor per step: no slopes, no front
    bool no_front = false;      // less of x is not bought with more of y
    std::string title;
    std::string command;  // what made the chart, for NAME.gp to say; not an option
};

/// Everything but the pictures, by name: STEM.gp (which makes STEM.svg and STEM.png), STEM.tsv and, for curves,
/// STEM.equal-cost.tsv and STEM.equal-error.tsv.
using Files = std::map<std::string, std::string>;
Files curve_files(const std::string& stem, const std::vector<Curve>& curves, const Options& options);
/// Variance and squared bias over cost, each a curve of every method on log axes. Squared bias is an estimate; where it
/// is not above 0, no bias was seen and no point is drawn.
Files part_files(const std::string& stem, const Table& table, const Options& options);
/// Stacked bars of what each stage of a method takes per sample per pixel, mean over the replicates.
Files stage_files(const std::string& stem, const Table& table, const Options& options);

/// Slopes and equal-cost, equal-error comparisons in words.
std::string summary(const std::vector<Curve>& curves, const Options& options);

/// Binds the options to the command line; `options` must outlive `command`.
void declare(app::Command& command, Options& options);

/// throws:  InputError for a table that lacks a column or holds no positive number, or when gnuplot is missing
void run(const Options& options, app::Report& report);

}  // namespace loom::chart
