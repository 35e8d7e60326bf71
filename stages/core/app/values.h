#pragma once
// Text of the command line <-> values: whole-text parsing with short messages, and printing that reads back.

#include <fmt/format.h>

#include <charconv>
#include <cmath>
#include <concepts>
#include <limits>
#include <optional>
#include <string>
#include <string_view>
#include <type_traits>

namespace loom::app {

/// What a number may be, both ends included; `unit` is shown in the help ("px", "EV", …).
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

/// The number that the whole text says, or nothing: no blanks, no sign on unsigned, no overflow, finite.
template <Number T>
std::optional<T> parse_number(std::string_view text) {
    T value{};
    const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
    if (error != std::errc{} || end != text.data() + text.size()) return std::nullopt;
    if constexpr (std::floating_point<T>)
        if (!std::isfinite(value)) return std::nullopt;
    return value;
}

/// The shortest text that reads back to the same value.
template <Number T>
std::string number_text(T value) {
    return fmt::format("{}", value);
}

/// `name` without its folders: what a file that should not depend on its place says of another.
std::string base_name(std::string_view path);

struct Labelled {
    std::string label, file;  // the label is empty when there is none
};
/// "pt=out/image.exr" -> pt, out/image.exr. A file that has this whole text for its name has no label.
Labelled split_label(const std::string& text);

/// The word as a shell would need it: in single quotes when it holds anything but plain characters.
std::string shell_word(std::string_view word);

}  // namespace loom::app
