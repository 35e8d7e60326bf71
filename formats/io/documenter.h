#pragma once
#include <cstddef>
#include <string>
#include <vector>

#include "formats/io/field.h"

namespace loom {

/// Visits a declaration and prints it as a Markdown table.
class Documenter : public FieldVisitor<Documenter> {
  public:
    template <class T>
    void column_of(const Field& field, const Column<T>&) {
        add(field);
    }
    template <class V>
    void value_of(const Field& field, const V&) {
        add(field);
    }
    void names_of(const Field& field, const std::vector<std::string>&) { add(field); }

    std::string markdown() const;

  private:
    void add(const Field& field);
    std::string rows_;
};

/// Size of one column on disk.
struct ColumnBytes {
    std::string name, axis;
    std::size_t rows = 0, bytes = 0;
};

/// Visits a filled format and measures its columns; skips absent ones.
class ColumnSizer : public FieldVisitor<ColumnSizer> {
  public:
    template <class C>
    void column_of(const Field& field, const C& column) {
        if (column.empty()) return;
        sizes.push_back({std::string(field.name), std::string(field.axes.substr(0, field.axes.find(','))),
                         column.size() / field.row_size(), column.size() * sizeof(typename C::Element)});
    }
    template <class V>
    void value_of(const Field&, const V&) {}
    void names_of(const Field&, const std::vector<std::string>&) {}

    std::vector<ColumnBytes> sizes;
};

}  // namespace loom
