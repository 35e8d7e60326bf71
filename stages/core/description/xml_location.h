#pragma once
#include <cstddef>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

namespace loom {

/// Text of one file as read, for messages that quote it.
struct SourceText {
    std::string name;  // as the user would write it
    std::string text;  // without byte order mark
};

/// A location in a source text.
struct Location {
    std::shared_ptr<const SourceText> source;
    std::size_t offset = 0;  // bytes from the start of the text

    /// Formats the location: "scene.xml:12:7"; lines and columns from 1, columns in bytes.
    std::string where() const;
};

/// Formats a message: "scene.xml:12:7: message", the line, and a caret below the location.
std::string locate(const Location& at, const std::string& message);

/// throws:  InputError(locate(at, message))
[[noreturn]] void fail(const Location& at, const std::string& message);

/// Lists the allowed names for a message, those nearest to `name` first: "a, b, c".
std::string nearest_first(std::string_view name, std::vector<std::string> allowed);

}  // namespace loom
