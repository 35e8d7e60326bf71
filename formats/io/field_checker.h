#pragma once
#include <cstddef>
#include <cstdint>
#include <map>
#include <span>
#include <string>

#include "formats/io/field.h"

namespace loom {

/// Returns the index of the first NaN or infinity; the size when there is none.
std::size_t first_nonfinite(std::span<const float> values);
std::size_t first_nonfinite(std::span<const double> values);
std::size_t first_nonfinite(std::span<const Half> values);

/// Counts NaNs and infinities.
std::size_t count_nonfinite(std::span<const float> values);
std::size_t count_nonfinite(std::span<const double> values);
std::size_t count_nonfinite(std::span<const Half> values);
/// Counts NaNs and infinities among aligned elements in memory; 0 for integers and text.
std::size_t count_nonfinite(ElementType type, std::span<const std::byte> bytes);

/// Visits a filled format and checks that columns with a common axis have one length and that floats are finite.
class FieldChecker : public FieldVisitor<FieldChecker> {
  public:
    /// in:      finite  check every float, besides the lengths
    explicit FieldChecker(bool finite) : finite_(finite) {}

    /// Returns the first problem, naming the dataset; empty when there is none.
    const std::string& problem() const { return problem_; }

    template <class C>
    void column_of(const Field& field, const C& column) {
        using T = typename C::Element;
        if (field.presence == Presence::optional && column.empty()) return;
        check_length(field, column.size());
        if constexpr (std::is_floating_point_v<T> || std::is_same_v<T, Half>) {
            if (!finite_ || field.finite != Finite::required || !problem_.empty()) return;
            std::size_t first_bad = 0;
            for (const std::span<const T> piece : column.pieces()) {
                const std::size_t in_piece = first_nonfinite(piece);
                first_bad += in_piece;
                if (in_piece < piece.size()) break;
            }
            check_finite(field, column.size(), first_bad);
        }
    }
    template <class V>
    void value_of(const Field& field, const V& value) {
        using Element = typename ValueTraits<V>::Element;
        if constexpr (std::is_floating_point_v<Element>) {
            const std::span<const Element> numbers(reinterpret_cast<const Element*>(&value), field.row_size());
            if (finite_ && problem_.empty()) check_finite(field, numbers.size(), first_nonfinite(numbers));
        }
    }
    void names_of(const Field& field, const std::vector<std::string>& texts) {
        if (field.presence == Presence::optional && texts.empty()) return;
        check_length(field, texts.size());
    }

  private:
    struct Count {
        std::size_t n;
        std::string first_name;
    };
    void check_length(const Field& field, std::size_t n_elements);
    void check_finite(const Field& field, std::size_t n_elements, std::size_t first_bad);

    bool finite_;
    std::string problem_;
    std::map<std::string, Count, std::less<>> counts_;  // by first axis
};

}  // namespace loom
