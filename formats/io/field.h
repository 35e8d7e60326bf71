#pragma once
// The single declaration of a format: a struct with
//   static constexpr FormatId format;
//   template <class Self, class Visitor> static void fields(Self&, Visitor&);
// fields() lists each array, value and list of names once. The writer, the reader, the checker and the documenter in
// formats/io visit it.

#include <array>
#include <cstdint>
#include <string>
#include <string_view>
#include <type_traits>
#include <utility>
#include <vector>

#include "formats/io/column.h"
#include "formats/io/half.h"

namespace loom {

/// Identity of a format: root attributes `filetype` and `version`.
struct FormatId {
    std::string_view name;
    int major = 1, minor = 0;
    int oldest_major = major;  // oldest major version that a reader accepts
};

/// Types of elements on disk; all little-endian.
enum class ElementType { float16, float32, float64, int16, int32, int64, uint8, uint16, uint32, uint64, text };

std::string_view element_name(ElementType type);
std::size_t element_size(ElementType type);  // bytes; 0 for text

template <class T>
constexpr ElementType element_type() {
    if constexpr (std::is_same_v<T, Half>)
        return ElementType::float16;
    else if constexpr (std::is_same_v<T, float>)
        return ElementType::float32;
    else if constexpr (std::is_same_v<T, double>)
        return ElementType::float64;
    else if constexpr (std::is_same_v<T, std::int16_t>)
        return ElementType::int16;
    else if constexpr (std::is_same_v<T, std::int32_t>)
        return ElementType::int32;
    else if constexpr (std::is_same_v<T, std::int64_t>)
        return ElementType::int64;
    else if constexpr (std::is_same_v<T, std::uint8_t>)
        return ElementType::uint8;
    else if constexpr (std::is_same_v<T, std::uint16_t>)
        return ElementType::uint16;
    else if constexpr (std::is_same_v<T, std::uint32_t>)
        return ElementType::uint32;
    else if constexpr (std::is_same_v<T, std::uint64_t>)
        return ElementType::uint64;
    else {
        static_assert(std::is_same_v<T, std::string>, "not a type that formats store");
        return ElementType::text;
    }
}

enum class Presence { required, optional };
/// Whether non-finite floats are an error. Fields of estimates count NaNs instead.
enum class Finite { required, counted };

/// Declaration of one dataset. `axes` names each axis, slowest first. All datasets with the same first axis have the
/// same length ("vertex"; "path+1" is one more than "path").
struct Field {
    std::string_view name;
    ElementType type;
    std::vector<std::size_t> row_shape;  // extents after the first axis; of all axes for a value
    std::string_view axes, units, text;
    Presence presence = Presence::required;
    Finite finite = Finite::required;

    std::size_t row_size() const {
        std::size_t n = 1;
        for (std::size_t extent : row_shape) n *= extent;
        return n;
    }
};

/// Shape and element type of a value: a number, a std::array of numbers, or a matrix as an array of rows.
template <class T>
struct ValueTraits {
    using Element = T;
    static std::vector<std::size_t> shape() { return {}; }
};
template <class T, std::size_t n>
struct ValueTraits<std::array<T, n>> {
    using Element = typename ValueTraits<T>::Element;
    static std::vector<std::size_t> shape() {
        auto inner = ValueTraits<T>::shape();
        inner.insert(inner.begin(), n);
        return inner;
    }
};

/// Translates the calls of a declaration into calls of Derived, which has
///   column_of(const Field&, Column<T>&), value_of(const Field&, T&), names_of(const Field&, vector<string>&)
template <class Derived>
class FieldVisitor {
  public:
    template <class C>
    void field(std::string_view name, C& column, std::size_t width, std::string_view axes, std::string_view units,
               std::string_view text, Finite finite = Finite::required) {
        add(name, column, width, axes, units, text, Presence::required, finite);
    }
    /// Declares a column whose rows have several axes; `row_shape` has the extents after the first axis.
    template <class C>
    void grid(std::string_view name, C& column, std::vector<std::size_t> row_shape, std::string_view axes,
              std::string_view units, std::string_view text, Finite finite = Finite::required) {
        self().column_of(Field{name, element_type<typename C::Element>(), std::move(row_shape), axes, units, text,
                               Presence::required, finite},
                         column);
    }
    template <class C>
    void optional(std::string_view name, C& column, std::size_t width, std::string_view axes, std::string_view units,
                  std::string_view text, Finite finite = Finite::required) {
        add(name, column, width, axes, units, text, Presence::optional, finite);
    }
    /// Declares a grid that may be absent, and then is empty.
    template <class C>
    void optional_grid(std::string_view name, C& column, std::vector<std::size_t> row_shape, std::string_view axes,
                       std::string_view units, std::string_view text, Finite finite = Finite::required) {
        self().column_of(Field{name, element_type<typename C::Element>(), std::move(row_shape), axes, units, text,
                               Presence::optional, finite},
                         column);
    }
    template <class V>
    void value(std::string_view name, V& value, std::string_view axes, std::string_view units, std::string_view text) {
        using Traits = ValueTraits<std::remove_const_t<V>>;
        self().value_of(Field{name, element_type<typename Traits::Element>(), Traits::shape(), axes, units, text},
                        value);
    }
    template <class S>
    void names(std::string_view name, S& strings, std::string_view axes, std::string_view text) {
        self().names_of(Field{name, ElementType::text, {}, axes, "1", text}, strings);
    }
    template <class S>
    void optional_names(std::string_view name, S& strings, std::string_view axes, std::string_view text) {
        self().names_of(Field{name, ElementType::text, {}, axes, "1", text, Presence::optional}, strings);
    }

  private:
    Derived& self() { return static_cast<Derived&>(*this); }
    template <class C>
    void add(std::string_view name, C& column, std::size_t width, std::string_view axes, std::string_view units,
             std::string_view text, Presence presence, Finite finite) {
        std::vector<std::size_t> row_shape;
        if (width != 1) row_shape.push_back(width);
        self().column_of(
            Field{name, element_type<typename C::Element>(), row_shape, axes, units, text, presence, finite}, column);
    }
};

}  // namespace loom
