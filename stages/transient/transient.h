#pragma once
// loom-transient: histograms over time from the paths of path graphs, without tracing rays.

#include <cstdint>
#include <functional>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "formats/derivative.h"
#include "formats/path_graph.h"
#include "formats/transient_cube.h"
#include "stages/core/graph/time_of_flight.h"
#include "stages/core/graph/time_response.h"

namespace loom::app {
class Command;
class Progress;
class Report;
}  // namespace loom::app

namespace loom {
class SharedArrivals;
}

namespace loom::transient {

enum class Unit { opl, ns };
/// Treatment of derivatives that need the slope of a response: averaged over an interval, or of a delta pulse, which has
/// none, by samples at the borders of bins, or not at all.
enum class Temporal { widen, exact, refuse };
enum class Shape { film, delta, box, gaussian, expgauss, table, sine, square };

struct Options {
    std::vector<std::string> graphs;       // path graphs of one scene with different samples
    std::vector<std::string> clusters;     // of these graphs, in their order; empty: paths alone
    std::vector<std::string> derivatives;  // of these graphs, in their order; empty: values alone
    Temporal temporal = Temporal::widen;
    std::optional<double> widen;  // length over which slopes of the response are averaged
    std::string output;           // transient cube (.h5)
    std::string tal;              // also an NLOS capture for the TAL tools (.h5); empty: none

    std::string like;  // cube whose bins and pulse are taken; empty: none
    // Lengths are in `unit`; unset options are those of the film.
    Unit unit = Unit::opl;
    double metres_per_unit = 1;
    std::optional<std::uint32_t> bins;
    std::optional<double> start, width, gate;
    Shape pulse = Shape::film;
    double pulse_length = 0, pulse_tail = 0;  // box: length; Gaussian: standard deviation; tail: mean
    std::string pulse_table;                  // two columns
    double period = 0;                        // of sine and square
    bool unwarp = false;
    std::vector<std::string> group_index;  // PHASE=GROUP

    std::uint64_t memory_MiB = 1024;
    int threads = 0;  // 0: all
};

void declare(app::Command& command, Options& options);

/// Borders of bins as borders of those of a derivative's temporal rows.
///   border k of these bins is border first + k step of the rows
struct ExactBorders {
    std::uint32_t first = 0, step = 1;
};

/// Bins paths of several graphs by opl and passes on rows of the cube.
///   radiance[k] = mean over paths of sum over light edges of L S_e[k](opl)
///   derivative[k] = mean over paths of [sum over light edges of (L' S_e[k] + L S_e[k]' opl') + boundary rows of the
///                   path] + boundary rows that belong to no path
/// Sums are in double precision, path by path in the order of graphs and samples, for any number of threads.
/// in:      graphs     of one sensor
///          max_bytes  memory for the rows in progress
///          shared     the same graphs with their clusters; empty: paths alone
///          derivatives  of the same graphs, by the same parameters; empty: values alone. The values are the same to
///                     the bit.
///          exact      borders of each derivative's temporal rows; empty: these rows are not used
/// needs:   shared or derivatives are empty
void bin_graphs(std::span<const PathGraph> graphs, std::span<SharedArrivals> shared,
                std::span<const Derivative> derivatives, const TimeResponse& response, const Timing& timing,
                std::uint64_t max_bytes, int threads, app::Progress& progress,
                const std::function<void(std::uint32_t first_row, const TransientRows&)>& take,
                std::span<const ExactBorders> exact = {});

/// Window derived from a graph's light: from the first arrival to where all but 0.1 % has arrived.
struct Window {
    double start = 0, end = 1;
};
Window window_of(const PathGraph& graph, const Timing& timing);

/// throws: InputError
void run(const Options& options, app::Report& report);

}  // namespace loom::transient
