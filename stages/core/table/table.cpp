#include "stages/core/table/table.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <charconv>
#include <fstream>

#include "formats/io/error.h"

namespace loom {
namespace {

std::vector<std::string> cells_of(std::string line) {
    if (!line.empty() && line.back() == '\r') line.pop_back();
    std::vector<std::string> cells(1);
    for (char c : line) {
        if (c == '\t')
            cells.emplace_back();
        else
            cells.back() += c;
    }
    return cells;
}

Table read_table(const std::string& file) {
    std::ifstream in(file);
    if (!in) throw InputError(fmt::format("{}: cannot be read", file));
    Table table{file, {}, {}, {}};
    std::size_t number = 0;
    for (std::string line; std::getline(in, line);) {
        ++number;
        if (line.empty()) continue;
        std::vector<std::string> cells = cells_of(std::move(line));
        if (table.names.empty()) {
            table.names = std::move(cells);
        } else if (cells.size() != table.names.size()) {
            throw InputError(fmt::format("{}:{}: has {} cells, the first line has {}", file, number, cells.size(),
                                         table.names.size()));
        } else {
            table.rows.push_back(std::move(cells));
            table.lines.push_back(number);
        }
    }
    if (table.rows.empty()) throw InputError(fmt::format("{}: has no rows", file));
    return table;
}

}  // namespace

bool Table::has(const std::string& name) const {
    return std::find(names.begin(), names.end(), name) != names.end();
}

std::size_t Table::column(const std::string& name) const {
    const auto at = std::find(names.begin(), names.end(), name);
    if (at == names.end())
        throw InputError(fmt::format("{}: has no column {}; there are {}", file, name, fmt::join(names, ", ")));
    return std::size_t(at - names.begin());
}

double Table::number(std::size_t row, std::size_t column) const {
    const std::string& text = rows[row][column];
    double value = 0;
    const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
    if (error != std::errc{} || end != text.data() + text.size())
        throw InputError(fmt::format("{}: row {}, {}: '{}' is not a number", file, row + 1, names[column], text));
    return value;
}

Table read_tables(const std::vector<std::string>& files) {
    Table all;
    for (const std::string& file : files) {
        Table table = read_table(file);
        if (all.names.empty()) {
            all = std::move(table);
            continue;
        }
        std::vector<std::size_t> order;
        for (const std::string& name : all.names) order.push_back(table.column(name));
        if (table.names.size() != all.names.size())
            throw InputError(fmt::format("{}: has other columns than {}", file, all.file));
        all.lines.insert(all.lines.end(), table.lines.begin(), table.lines.end());
        for (const auto& row : table.rows) {
            auto& joined = all.rows.emplace_back();
            for (std::size_t k : order) joined.push_back(row[k]);
        }
    }
    return all;
}

}  // namespace loom
