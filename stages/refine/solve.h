#pragma once
#include <functional>

#include "stages/refine/system.h"

namespace loom::refine {

struct Iteration {
    double residual = 0;       // sum |X' - X| / sum |X'|
    double image_change = 0;   // the same over first hits
    double clamped_share = 0;  // Clamp::cluster: energy taken, over what clusters gave before
};

struct SolveOptions {
    int iterations = 6;
    Clamp clamp = Clamp::column;
    float epsilon = 1e-3f;
    int threads = 0;
};

/// Jacobi steps X <- M X + B, a fixed number of them; same result for any number of threads.
/// in:   first_hits  unknowns of the first vertices of paths, each once
///       X           start; replaced by the result
///       step        called after each iteration
/// out:  one entry per iteration; fewer when the iteration diverged: sum |X' - X| grew threefold over its least (the
///       residual, relative to what grows as fast, need not grow), or a value stopped being finite, in which case X
///       is the last iterate before that
std::vector<Iteration> solve(const System& system, std::span<const std::uint32_t> first_hits, const SolveOptions& options,
                             HugeArray<Light>& X, const std::function<void(const Iteration&)>& step = {});

}  // namespace loom::refine
