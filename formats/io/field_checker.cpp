#include "formats/io/field_checker.h"

#include <fmt/format.h>

#include <bit>

namespace loom {
namespace {

/// A block at a time without a branch inside, so that the scan runs at the speed of memory.
template <class Bits, class T>
std::size_t first_with_full_exponent(std::span<const T> values, Bits exponent) {
    constexpr std::size_t block = 4096;
    for (std::size_t begin = 0; begin < values.size(); begin += block) {
        const std::size_t end = std::min(values.size(), begin + block);
        std::size_t n_bad = 0;
        for (std::size_t i = begin; i < end; ++i) {
            n_bad += (std::bit_cast<Bits>(values[i]) & exponent) == exponent ? 1 : 0;
        }
        if (n_bad == 0) continue;
        for (std::size_t i = begin; i < end; ++i) {
            if ((std::bit_cast<Bits>(values[i]) & exponent) == exponent) return i;
        }
    }
    return values.size();
}

}  // namespace

std::size_t first_nonfinite(std::span<const float> values) {
    return first_with_full_exponent<std::uint32_t>(values, std::uint32_t{0x7f800000u});
}
std::size_t first_nonfinite(std::span<const double> values) {
    return first_with_full_exponent<std::uint64_t>(values, std::uint64_t{0x7ff0000000000000u});
}
std::size_t first_nonfinite(std::span<const Half> values) {
    return first_with_full_exponent<std::uint16_t>(values, std::uint16_t{0x7c00u});
}

void FieldChecker::check_length(const Field& field, std::size_t n_elements) {
    if (!problem_.empty()) return;
    if (field.row_size() == 0) {
        problem_ = fmt::format("{}: has rows without elements", field.name);
        return;
    }
    const std::size_t rows = n_elements / field.row_size();
    if (rows * field.row_size() != n_elements) {
        problem_ =
            fmt::format("{}: {} numbers are no whole rows of {}", field.name, n_elements, field.row_size());
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
