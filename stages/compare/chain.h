#pragma once
// Cost of an output, its ancestors included.

#include <filesystem>
#include <string>
#include <vector>

#include "formats/io/cost.h"

namespace loom::compare {

/// Sum over the files of a chain that one stage made; peak memory is the largest.
struct StageCost {
    std::uint64_t n_files = 0;
    Cost cost;
};

/// Returns the costs of an output and all its ancestors, each file once (see formats/chain.h).
/// out:     stages in the order of their first file, ancestors before the files made from them
std::vector<StageCost> chain_cost(const std::filesystem::path& output);

/// Returns the sum over all stages, named "total".
StageCost total_of(const std::vector<StageCost>& stages);

}  // namespace loom::compare
