#pragma once
// Tables of text as loom-compare prints them: tab-separated, one line of names first.

#include <string>
#include <vector>

namespace loom {

struct Table {
    std::string file;
    std::vector<std::string> names;
    std::vector<std::vector<std::string>> rows;

    bool has(const std::string& name) const;
    /// throws:  InputError naming the columns that there are
    std::size_t column(const std::string& name) const;
    /// A number of a row, NaN included.
    /// throws:  InputError naming file, row and column
    double number(std::size_t row, std::size_t column) const;
};

/// Reads a table from a file; several with the same columns (in any order) are joined.
/// throws:  InputError "FILE:LINE: …" when a row has another number of cells than the head, or columns differ
Table read_tables(const std::vector<std::string>& files);

}  // namespace loom
