#include "stages/core/description/xml_location.h"

#include <fmt/format.h>

#include <algorithm>
#include <numeric>

#include "formats/io/error.h"

namespace loom {
namespace {

struct LineColumn {
    std::size_t line = 1, column = 1, line_start = 0;
};

LineColumn line_column(const Location& at) {
    LineColumn r;
    const std::string& text = at.source->text;
    const std::size_t end = std::min(at.offset, text.size());
    for (std::size_t i = 0; i < end; ++i)
        if (text[i] == '\n') {
            ++r.line;
            r.line_start = i + 1;
        }
    r.column = end - r.line_start + 1;
    return r;
}

/// Returns the number of edits (insert, delete, replace; case counts half) that turn a into b.
std::size_t edit_distance(std::string_view a, std::string_view b) {
    std::vector<std::size_t> row(b.size() + 1);
    for (std::size_t j = 0; j <= b.size(); ++j) row[j] = 2 * j;
    for (std::size_t i = 1; i <= a.size(); ++i) {
        std::size_t diagonal = row[0];
        row[0] = 2 * i;
        for (std::size_t j = 1; j <= b.size(); ++j) {
            const char x = a[i - 1], y = b[j - 1];
            const bool same_letter =
                std::tolower(static_cast<unsigned char>(x)) == std::tolower(static_cast<unsigned char>(y));
            const std::size_t replace = diagonal + (x == y ? 0u : same_letter ? 1u : 2u);
            diagonal = row[j];
            row[j] = std::min({row[j] + 2, row[j - 1] + 2, replace});
        }
    }
    return row[b.size()];
}

}  // namespace

std::string Location::where() const {
    const LineColumn at = line_column(*this);
    return fmt::format("{}:{}:{}", source->name, at.line, at.column);
}

std::string locate(const Location& at, const std::string& message) {
    if (!at.source) return message;
    const LineColumn place = line_column(at);
    const std::string& text = at.source->text;
    std::size_t end = text.find_first_of("\r\n", place.line_start);
    if (end == std::string::npos) end = text.size();
    // Cut a long line to a window around the caret. Keep tabs, so that the caret is below its location.
    constexpr std::size_t window = 160;
    std::size_t start = place.line_start;
    const std::size_t caret = start + place.column - 1;
    if (end > start + window && caret - start > window / 2) start = caret - window / 2;
    end = std::min(std::max(end, caret), start + window);
    std::string pointer;
    for (std::size_t i = start; i < caret; ++i) pointer += text[i] == '\t' ? '\t' : ' ';
    return fmt::format("{}: {}\n  {}\n  {}^", at.where(), message, text.substr(start, end - start), pointer);
}

void fail(const Location& at, const std::string& message) {
    throw InputError(locate(at, message));
}

std::string nearest_first(std::string_view name, std::vector<std::string> allowed) {
    std::vector<std::size_t> distance(allowed.size()), order(allowed.size());
    std::iota(order.begin(), order.end(), std::size_t{0});
    for (std::size_t i = 0; i < allowed.size(); ++i) distance[i] = edit_distance(name, allowed[i]);
    std::stable_sort(order.begin(), order.end(),
                     [&](std::size_t a, std::size_t b) { return distance[a] < distance[b]; });
    std::string list;
    for (const std::size_t i : order) list += (list.empty() ? "" : ", ") + allowed[i];
    return list.empty() ? "none" : list;
}

}  // namespace loom
