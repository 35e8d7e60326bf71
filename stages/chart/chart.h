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

enum class Kind { curves, parts, stages, frames, spectrum };

struct Options {
    std::vector<std::string> tables;  // TSV
    std::string output;               // .svg; PNG, data and commands beside it
    Kind kind = Kind::curves;
    std::string x = "cpu_s";    // column of the cost; with Kind::stages the only choice
    std::string y = "relmse";   // column of the error
    std::string by = "method";  // column that distinguishes curves
    bool linear_x = false;      // for quantities that fall by a factor per step: no slopes, no front
    bool no_front = false;      // x and y are no trade-off
    std::string title;
    std::string command;  // the command written into NAME.gp; not an option
};

/// All files except the images, by name: STEM.gp (which makes STEM.svg and STEM.png), STEM.tsv and, for curves,
/// STEM.equal-cost.tsv and STEM.equal-error.tsv.
using Files = std::map<std::string, std::string>;
Files curve_files(const std::string& stem, const std::vector<Curve>& curves, const Options& options);
/// Plots variance and squared bias over cost, each as a curve of every method on log axes. Squared bias is an estimate;
/// no point is drawn where it is not above 0 (no measurable bias).
Files part_files(const std::string& stem, const Table& table, const Options& options);
/// Plots stacked bars of each stage's cost per sample per pixel, by method, mean over the replicates.
Files stage_files(const std::string& stem, const Table& table, const Options& options);

/// Plots cost, share of paths that are traced again and expected error of each frame of an animation, one panel above the
/// other, a curve per method (`loom-compare --by-frame`). A panel without a number is left out.
Files frame_files(const std::string& stem, const Table& table, const Options& options);

/// Plots the power of errors by frequency in time, a curve per method, a panel per scene (`loom-compare --spectrum`, `scene`
/// added). Frequency 0 has its place: the axis is linear.
Files spectrum_files(const std::string& stem, const Table& table, const Options& options);

/// Describes slopes and equal-cost, equal-error comparisons as text.
std::string summary(const std::vector<Curve>& curves, const Options& options);

/// Binds the options to the command line; `options` must outlive `command`.
void declare(app::Command& command, Options& options);

/// throws:  InputError for a table without a required column or without a positive number, or when gnuplot is missing
void run(const Options& options, app::Report& report);

}  // namespace loom::chart
