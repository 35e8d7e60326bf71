#pragma once
// Tables of text as loom-compare prints them: tab-separated, one line of names first.

#include <string>
#include <vector>

namespace loom {

struct Table {
    std::string file;
    std::vector<std::string> names;
    std::vector<std::vector<std::string>> rows;
    std::vector<std::size_t> lines = {};  // [row] of its file, from 1

    bool has(const std::string& name) const;
    /// throws:  InputError naming the existing columns
    std::size_t column(const std::string& name) const;
    /// Returns a number of a row, which may be NaN.
    /// throws:  InputError naming file, row and column
    double number(std::size_t row, std::size_t column) const;
};

/// Reads a table from files with the same columns (in any order) and concatenates the rows.
/// throws:  InputError "FILE:LINE: …" when a row has another number of cells than the header, or columns differ
Table read_tables(const std::vector<std::string>& files);

}  // namespace loom
