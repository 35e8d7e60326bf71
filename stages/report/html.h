#pragma once
// Text of an HTML page.

#include <cstdint>
#include <map>
#include <span>
#include <string>
#include <string_view>
#include <vector>

namespace loom::report {

/// A text as content or as the value of an attribute.
std::string escaped(std::string_view text);

/// [RFC4648] section 4.
std::string base64(std::span<const std::uint8_t> bytes);

/// A number to read: three digits, powers of ten as such; "–" for NaN. With two digits of its standard error,
/// where that is known.
std::string number(double value);
std::string number(double value, double se);

/// A template with each {{name}} replaced; what is put in is not searched again.
/// throws:  std::logic_error when a name is unknown, or known and not there
std::string filled(std::string_view text, const std::map<std::string, std::string>& values);

/// Cells of a row; a table of them, the first column left, the others right.
using Cells = std::vector<std::string>;
/// in:      head, rows  HTML
std::string table(const Cells& head, const std::vector<Cells>& rows);

/// An SVG to stand inside a page: without its XML head, its ids prefixed so that several charts may stand in
/// one page. throws:  InputError when it is no SVG or holds a script
std::string inline_svg(std::string_view svg, std::string_view prefix, std::string_view file);

}  // namespace loom::report
