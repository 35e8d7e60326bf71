#include "formats/io/documenter.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

namespace loom {

void Documenter::add(const Field& field) {
    const std::size_t bytes = element_size(field.type) * field.row_size();
    const bool is_optional = field.presence == Presence::optional;
    rows_ += fmt::format("| `{}`{} | {} | {} | {} | {} | {}{} |\n", field.name, is_optional ? " ?" : "",
                         element_name(field.type), field.axes.empty() ? "" : fmt::format("[{}]", field.axes),
                         field.units, bytes == 0 ? "" : std::to_string(bytes), field.text,
                         field.finite == Finite::counted ? "; NaN allowed, and counted" : "");
}

std::string Documenter::markdown() const {
    return "| dataset | type | axes | units | bytes per row | what it is |\n|---|---|---|---|---|---|\n" + rows_;
}

}  // namespace loom
