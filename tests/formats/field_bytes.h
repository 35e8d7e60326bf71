#pragma once
#include <gtest/gtest.h>

#include <string>
#include <utility>
#include <vector>

#include "formats/io/field.h"

namespace loom::testing {

/// Collects the bytes of all fields, so that two files can be compared in any version of a format.
class ByteCollector : public FieldVisitor<ByteCollector> {
  public:
    template <class T>
    void column_of(const Field& field, const Column<T>& column) {
        add(field, column.data(), column.size() * sizeof(T));
    }
    template <class V>
    void value_of(const Field& field, const V& value) {
        if constexpr (std::is_same_v<V, std::string>)
            add(field, value.data(), value.size());
        else
            add(field, &value, sizeof value);
    }
    void names_of(const Field& field, const std::vector<std::string>& texts) {
        std::string joined;
        for (const auto& text : texts) joined += text + "\n";
        add(field, joined.data(), joined.size());
    }
    std::vector<std::pair<std::string, std::string>> found;

  private:
    void add(const Field& field, const void* data, std::size_t n) {
        found.emplace_back(field.name, n == 0 ? "" : std::string(static_cast<const char*>(data), n));
    }
};

template <class Format>
void expect_equal(const Format& a, const Format& b) {
    ByteCollector left, right;
    Format::fields(a, left);
    Format::fields(b, right);
    ASSERT_EQ(left.found.size(), right.found.size());
    for (std::size_t i = 0; i < left.found.size(); ++i) EXPECT_EQ(left.found[i], right.found[i]) << left.found[i].first;
    EXPECT_EQ(a.provenance, b.provenance);
}

}  // namespace loom::testing
