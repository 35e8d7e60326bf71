#pragma once
// loom-fit: one step of a fit of scene parameters to a measured transient cube.            [TR] section 6

#include <array>
#include <optional>
#include <string>
#include <vector>

#include "stages/fit/optimiser.h"

namespace loom::app {
class Command;
class Report;
}  // namespace loom::app

namespace loom::fit {

enum class Method : std::uint8_t { lm, adam, gradient };

struct Options {
    std::string measured, state, output, values;
    std::vector<std::string> cubes;
    Method method = Method::lm;
    Loss loss = Loss::pyramid;
    std::string merge;  // list of numbers of bins; empty: default_merging()
    std::vector<std::string> lower, upper, scale, prior;
    Rules rules;
    bool done = false;
    std::string charts;  // loss.svg of a folder for charts
    std::vector<std::string> truth;
};

/// Numbers of bins to be merged, coarse to fine: powers of two, 32 at most, of which the first leaves at least 8 bins.
std::vector<std::uint32_t> default_merging(std::size_t n_bins);

/// Adds the evaluation in two cubes to a fit.
/// in:      evaluated  at fit.parameters.value, with their derivatives
/// out:     number of compared values that are not finite in one of the cubes, and left out
std::size_t add_evaluation(Fit& fit, const TransientCube& measured, std::span<const TransientCube, 2> evaluated,
                           const Rules& rules);

void declare(app::Command& command, Options& options);
/// Returns an exit code: with --done 1 for a fit that still runs.
int run(const Options& options, app::Report& report);

}  // namespace loom::fit
