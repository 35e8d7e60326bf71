#pragma once
// From the equations at one point to the point where the scene is to be evaluated next.

#include <cstdint>
#include <functional>

#include "formats/fit.h"
#include "stages/fit/equations.h"

namespace loom::fit {

struct Rules {
    std::uint32_t max_evaluations = 40;
    std::uint32_t max_at_level = 8;  // evaluations before bins get finer
    double tolerance = 1;            // a step of lm shorter than so many error bars ends the fit
    std::uint32_t averaged = 4;      // near evaluations at the finest bins whose mean the result of lm is
    // Starts from elsewhere, after an end in a minimum that does not explain the measurement: its loss is too large by so
    // many standard deviations, and by such a share of the first loss.
    std::uint32_t max_restarts = 3;
    double misfit = 5, misfit_share = 0.02;
    std::uint64_t seed = 0;  // of these starts
    double rate = 0.3;       // first step of adam, in parameters/scale
};

/// Returns the equations with so many bins merged, at the point that was evaluated.
using EquationsOf = std::function<Equations(std::uint32_t merged_bins)>;

/// Adds the evaluation at parameters/value, and moves parameters/value on.
///
///   lm        Levenberg-Marquardt: (normal + lambda diag curvature) step = gradient; steps that make the loss larger by
///             more than noise are taken back. Where `normal` is not positive definite, `curvature` takes its place.
///             Evaluations that differ within noise are averaged. Bins get finer once a step is shorter than the error
///             bars, or after max_at_level evaluations.
///   adam      [Kingma2015] on the gradient; `rate` falls to a tenth by the last evaluation
///   gradient  steepest descent in units of parameters/scale, by the length that the curvature makes best
/// All keep to the bounds: a parameter at a bound that the step leads out of stays there.
/// needs:   fit.is_running()
void advance(Fit& fit, const EquationsOf& evaluated, const Rules& rules);

}  // namespace loom::fit
