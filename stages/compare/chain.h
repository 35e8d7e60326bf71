#pragma once
// What an output cost, its parents included.

#include <filesystem>
#include <string>
#include <vector>

#include "formats/io/cost.h"

namespace loom::compare {

/// The files of a chain that one stage made, added up; peak memory is the largest.
struct StageCost {
    std::uint64_t n_files = 0;
    Cost cost;
};

/// The costs of an output and of all its ancestors, each file once (see formats/chain.h).
/// out:     stages in the order of their first file, ancestors before what is made from them
std::vector<StageCost> chain_cost(const std::filesystem::path& output);

/// All stages together, called "total".
StageCost total_of(const std::vector<StageCost>& stages);

}  // namespace loom::compare
