#pragma once
// How many samples each family of boundary terms takes.

#include "stages/derive/boundary.h"

namespace loom::derive {

/// Samples all families that `parts` requires.
///
/// A pilot of each family measures variance V_f and cost c_f of a sample, and n_f = a sqrt(V_f / c_f). With
/// options.effort, a is such that the samples cost that share of tracing and binning the graph. Without, it is such that
/// variance times cost of the whole derivative is least: for the variance V and the cost T of all that boundary samples do
/// not change, the interior's, n_f = sqrt(V_f / c_f) sqrt(T / V), at most the cost T. Variances of all parameters count,
/// each over its own sum.
/// out:     samples  [family]; returns the number of rays
std::uint64_t sample_families(BoundaryScene& s, const Parts& parts, std::vector<BoundaryRows>& rows,
                              std::span<std::uint64_t> samples, app::Report& report);

}  // namespace loom::derive
