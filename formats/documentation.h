#pragma once
#include <string>

namespace loom {

/// Returns the text of FORMATS.md, generated from the declarations of all formats.
std::string formats_markdown();

}  // namespace loom
