#pragma once
#include <functional>

#include "stages/refine/system.h"

namespace loom::refine {

struct Iteration {
    double residual = 0;       // sum |X' - X| / sum |X'|
    double image_change = 0;   // the same quotient over first hits
    double clamped_share = 0;  // Clamp::cluster: clamped energy over the clusters' energy before
};

struct SolveOptions {
    int iterations = 6;
    Clamp clamp = Clamp::column;
    float epsilon = 1e-4f;
    int threads = 0;
    bool last_for_first_hits = false;  // the last step updates first hits only; all other vertices keep its input
};

/// One Light per unknown: an array, or a column of the system's rows.
struct LightColumn {
    Light* first;
    std::size_t stride;  // in lights

    LightColumn(HugeArray<Light>& array) : first(array.data()), stride(1) {}
    LightColumn(Light* first_, std::size_t stride_) : first(first_), stride(stride_) {}
    Light& operator[](std::size_t k) const { return first[k * stride]; }
};
/// Returns X in the rows of a system.
inline LightColumn radiance_of(System& system) {
    return {&system.at.data()->X, sizeof(System::Row) / sizeof(Light)};
}

/// Iterates Jacobi steps X <- M X + B, a fixed number of them; same result for any number of threads.
/// in:   first_hits  unknowns of the first vertices of paths, each once
///       X           start; replaced by the result
///       step        called after each iteration
/// out:  one entry per iteration. Fewer when the iteration diverged: sum |X' - X| grew to three times its minimum (the
///       residual, relative to a sum that grows as fast, need not grow), or a value became non-finite. In the latter
///       case X is the last finite iterate
std::vector<Iteration> solve(const System& system, std::span<const std::uint32_t> first_hits,
                             const SolveOptions& options, LightColumn X,
                             const std::function<void(const Iteration&)>& step = {});

}  // namespace loom::refine
