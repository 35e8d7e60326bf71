#pragma once
#include <string>

namespace loom {

/// The text of FORMATS.md, printed from the declarations of all formats.
std::string formats_markdown();

}  // namespace loom
