#pragma once
// The chain of files behind an output, read from the cost files beside them.

#include <filesystem>
#include <vector>

#include "formats/io/cost.h"

namespace loom {

/// A file of a chain and the cost of making it.
struct ChainFile {
    std::filesystem::path file;
    Cost cost;
};

/// Returns an output and all its ancestors, each once, ancestors before the files made from them.
/// needs:   only the .cost.json files; the ancestors themselves may be deleted
/// throws:  InputError naming the missing or damaged cost file, the file that needs it and the command to run again; or
///          naming the loop when a file is its own ancestor
std::vector<ChainFile> read_chain(const std::filesystem::path& output);

}  // namespace loom
