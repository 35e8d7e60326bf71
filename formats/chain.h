#pragma once
// The files that an output came from, by the costs that lie beside them.

#include <filesystem>
#include <vector>

#include "formats/io/cost.h"

namespace loom {

/// A file of a chain and what making it took.
struct ChainFile {
    std::filesystem::path file;
    Cost cost;
};

/// An output and all its ancestors, each once however many ways lead to it, ancestors before what is made from them.
///   NEEDS only the .cost.json files: the ancestors themselves may be gone
/// throws:  InputError naming the missing or damaged cost file, what needs it and what to run again; or the loop
///          when a file is its own ancestor
std::vector<ChainFile> read_chain(const std::filesystem::path& output);

}  // namespace loom
