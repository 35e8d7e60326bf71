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

/// The costs of an output and of all its ancestors, each file once however many ways lead to it.
///   NEEDS only the .cost.json files: the ancestors themselves may be gone
/// out:     stages in the order of their first file, ancestors before what is made from them
/// throws:  InputError naming the missing or damaged cost file, what needs it and what to run again; or the loop
///          when a file is its own ancestor
std::vector<StageCost> chain_cost(const std::filesystem::path& output);

/// All stages together, called "total".
StageCost total_of(const std::vector<StageCost>& stages);

}  // namespace loom::compare
