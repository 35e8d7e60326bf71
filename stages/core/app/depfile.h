#pragma once
#include <filesystem>
#include <span>
#include <string>

namespace loom::app {

/// Writes a make rule: these outputs depend on these files.
/// in:      dependencies  each has a rule without recipe too, so that a deleted one is remade (that is, complained
///                        about) by the stage and not by make
void write_depfile(const std::filesystem::path& path, std::span<const std::string> outputs,
                   std::span<const std::string> dependencies);

}  // namespace loom::app
