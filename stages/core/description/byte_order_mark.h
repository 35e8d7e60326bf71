#pragma once
#include <string_view>

namespace loom {

/// Returns the text without a leading UTF-8 byte order mark, which some editors write.
inline std::string_view without_byte_order_mark(std::string_view text) {
    constexpr std::string_view mark = "\xEF\xBB\xBF";
    if (text.starts_with(mark)) text.remove_prefix(mark.size());
    return text;
}

}  // namespace loom
