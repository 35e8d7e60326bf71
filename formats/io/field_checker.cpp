#include "formats/io/field_checker.h"

#include <fmt/format.h>

#include <algorithm>
#include <bit>

namespace loom {
namespace {

/// Branch-free, so that the scan runs at memory bandwidth.
template <class Bits, class T>
std::size_t count_full_exponents(std::span<const T> values, Bits exponent) {
    std::size_t n = 0;
    for (const T& value : values) n += (std::bit_cast<Bits>(value) & exponent) == exponent ? 1 : 0;
    return n;
}
std::size_t count(std::span<const float> values) {
    return count_full_exponents(values, std::uint32_t{0x7f800000u});
}
std::size_t count(std::span<const double> values) {
    return count_full_exponents(values, std::uint64_t{0x7ff0000000000000u});
}
std::size_t count(std::span<const Half> values) {
    return count_full_exponents(values, std::uint16_t{0x7c00u});
}

/// Counts block by block, then searches the first block with a hit.
template <class T>
std::size_t first(std::span<const T> values) {
    constexpr std::size_t block = 4096;
    for (std::size_t begin = 0; begin < values.size(); begin += block) {
        const auto part = values.subspan(begin, std::min(block, values.size() - begin));
        if (count(part) == 0) continue;
        for (std::size_t i = 0; i < part.size(); ++i)
            if (count(part.subspan(i, 1)) > 0) return begin + i;
    }
    return values.size();
}

template <class T>
std::size_t count_as(std::span<const std::byte> bytes) {
    return count(std::span(reinterpret_cast<const T*>(bytes.data()), bytes.size() / sizeof(T)));
}

}  // namespace

std::size_t first_nonfinite(std::span<const float> values) {
    return first(values);
}
std::size_t first_nonfinite(std::span<const double> values) {
    return first(values);
}
std::size_t first_nonfinite(std::span<const Half> values) {
    return first(values);
}

std::size_t count_nonfinite(std::span<const float> values) {
    return count(values);
}
std::size_t count_nonfinite(std::span<const double> values) {
    return count(values);
}
std::size_t count_nonfinite(std::span<const Half> values) {
    return count(values);
}

std::size_t count_nonfinite(ElementType type, std::span<const std::byte> bytes) {
    switch (type) {
        case ElementType::float16:
            return count_as<Half>(bytes);
        case ElementType::float32:
            return count_as<float>(bytes);
        case ElementType::float64:
            return count_as<double>(bytes);
        default:
            return 0;
    }
}

void FieldChecker::check_length(const Field& field, std::size_t n_elements) {
    if (!problem_.empty()) return;
    if (field.row_size() == 0) {
        problem_ = fmt::format("{}: has rows without elements", field.name);
        return;
    }
    const std::size_t rows = n_elements / field.row_size();
    if (rows * field.row_size() != n_elements) {
        problem_ = fmt::format("{}: {} numbers are no whole rows of {}", field.name, n_elements, field.row_size());
        return;
    }
    std::string_view axis = field.axes.substr(0, field.axes.find(','));
    std::size_t n = rows;
    if (axis.ends_with("+1")) {
        axis.remove_suffix(2);
        if (rows == 0) {
            problem_ = fmt::format("{}: is empty, but offsets have one row more than {}", field.name, axis);
            return;
        }
        n = rows - 1;
    }
    const auto [known, inserted] = counts_.try_emplace(std::string(axis), Count{n, std::string(field.name)});
    if (known->second.n != n) {
        problem_ = fmt::format("{}: has rows for {} of axis {}, but {} has {}", field.name, n, axis,
                               known->second.first_name, known->second.n);
    }
}

void FieldChecker::check_finite(const Field& field, std::size_t n_elements, std::size_t first_bad) {
    if (first_bad == n_elements) return;
    problem_ = fmt::format("{}: row {} is NaN or infinite", field.name, first_bad / field.row_size());
}

}  // namespace loom
