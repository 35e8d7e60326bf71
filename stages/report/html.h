#pragma once
// Text of an HTML page.

#include <cstdint>
#include <map>
#include <span>
#include <string>
#include <string_view>
#include <vector>

namespace loom::report {

/// Escapes a text for use as content or as the value of an attribute.
std::string escaped(std::string_view text);

/// Encodes bytes as base64.                                                      [RFC4648] section 4
std::string base64(std::span<const std::uint8_t> bytes);

/// Formats a number with three digits and powers of ten; "–" for NaN. A known standard error is appended with two
/// digits.
std::string number(double value);
std::string number(double value, double se);

/// Formats a count, and a number of bytes; "–" for 0: other renderers do not count.
std::string counted(double value);
std::string bytes(double value);

/// Returns a section with a heading; nothing without a body.
/// in:      title, body  HTML
std::string section(const std::string& id, const std::string& title, const std::string& body);

/// Returns JSON as the content of a script element, which no text in it may end.
std::string embedded_json(std::string json);

/// Replaces each {{name}} in a template; inserted texts are not searched again.
/// throws:  std::logic_error when a name has no value, or a value's name does not occur
std::string filled(std::string_view text, const std::map<std::string, std::string>& values);

/// Cells of a row. table() aligns the first column left, the others right.
using Cells = std::vector<std::string>;
/// in:      head, rows  HTML
std::string table(const Cells& head, const std::vector<Cells>& rows);

/// Reads a chart (SVG) and returns it as a numbered figure.
/// in:      title, text  plain text
/// throws:  InputError as inline_svg
std::string chart_figure(const std::string& file, const std::string& prefix, int number, const std::string& title,
                         const std::string& text);

/// Prepares an SVG for a page: without its XML header, ids prefixed so that several charts fit into one page.
/// throws:  InputError when the text is no SVG or contains a script
std::string inline_svg(std::string_view svg, std::string_view prefix, std::string_view file);

}  // namespace loom::report
