#pragma once
// Conversion between text of the command line and values: whole-text parsing with short messages, and printing that
// reads back.

#include <fmt/format.h>

#include <charconv>
#include <cmath>
#include <concepts>
#include <cstdint>
#include <limits>
#include <optional>
#include <string>
#include <string_view>
#include <type_traits>

namespace loom::app {

/// Allowed values of a number, both ends included; the help shows `unit` ("px", "EV", …).
template <class T>
struct Range {
    T low, high;
    std::string unit = {};
};

template <class T>
concept Number = (std::integral<T> && !std::same_as<T, bool>) || std::floating_point<T>;

template <class T>
struct is_optional : std::false_type {};
template <class T>
struct is_optional<std::optional<T>> : std::true_type {};
template <class T>
struct value_of {
    using type = T;
};
template <class T>
struct value_of<std::optional<T>> {
    using type = T;
};

/// Parses the whole text as a number; nothing on failure: no blanks, no sign on unsigned, no overflow, finite.
template <Number T>
std::optional<T> parse_number(std::string_view text) {
    T value{};
    const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
    if (error != std::errc{} || end != text.data() + text.size()) return std::nullopt;
    if constexpr (std::floating_point<T>)
        if (!std::isfinite(value)) return std::nullopt;
    return value;
}

/// Returns the shortest text that reads back to the same value.
template <Number T>
std::string number_text(T value) {
    return fmt::format("{}", value);
}

/// Returns `path` without its folders, for files whose bytes must not depend on their folder.
std::string base_name(std::string_view path);
/// Returns the name of one output of several: its last % is replaced, where it has one.
std::string name_of_part(std::string name, std::string_view part);

/// Returns the number of a file of several, the digits at the end of its name: 12 of out/frame-0012.exr; nothing
/// without digits.
std::optional<std::uint64_t> number_at_end(std::string_view path);

struct Labelled {
    std::string label, file;  // the label is empty when there is none
};
/// Splits a labelled input: "pt=out/image.exr" -> pt, out/image.exr. When a file with the whole text as its name
/// exists, there is no label.
Labelled split_label(const std::string& text);

/// Quotes a word for a shell: in single quotes when it has any character that is not plain.
std::string shell_word(std::string_view word);

}  // namespace loom::app
