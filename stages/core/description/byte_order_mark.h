#pragma once
#include <string_view>

namespace loom {

/// The text behind the UTF-8 byte order mark that some editors put first; the whole text where there is none.
inline std::string_view without_byte_order_mark(std::string_view text) {
    constexpr std::string_view mark = "\xEF\xBB\xBF";
    if (text.starts_with(mark)) text.remove_prefix(mark.size());
    return text;
}

}  // namespace loom
