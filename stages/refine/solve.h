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
    float epsilon = 1e-4f;
    int threads = 0;
    bool last_for_first_hits = false;  // the last step is for first hits alone: all others keep the light that it took
};

/// A light of each unknown: an array, or a column of the system's rows.
struct LightColumn {
    Light* first;
    std::size_t stride;  // in lights

    LightColumn(HugeArray<Light>& array) : first(array.data()), stride(1) {}
    LightColumn(Light* first_, std::size_t stride_) : first(first_), stride(stride_) {}
    Light& operator[](std::size_t k) const { return first[k * stride]; }
};
/// X in the rows of a system.
inline LightColumn radiance_of(System& system) {
    return {&system.at.data()->X, sizeof(System::Row) / sizeof(Light)};
}

/// Jacobi steps X <- M X + B, a fixed number of them; same result for any number of threads.
/// in:   first_hits  unknowns of the first vertices of paths, each once
///       X           start; replaced by the result
///       step        called after each iteration
/// out:  one entry per iteration; fewer when the iteration diverged: sum |X' - X| grew threefold over its least (the
///       residual, relative to what grows as fast, need not grow), or a value stopped being finite, in which case X
///       is the last iterate before that
std::vector<Iteration> solve(const System& system, std::span<const std::uint32_t> first_hits,
                             const SolveOptions& options, LightColumn X,
                             const std::function<void(const Iteration&)>& step = {});

}  // namespace loom::refine
