#include "formats/gradient.h"

#include <fmt/format.h>

#include <tuple>

#include "formats/io/hdf5_format.h"

namespace loom {
namespace {

/// Checks the ranges of things (meshes, images) in a common array.
std::string bad_ranges(const char* name, std::size_t n, const Column<std::uint64_t>& first, std::size_t n_rows) {
    if (n == 0 && first.empty() && n_rows == 0) return {};
    if (first.size() != n + 1) return fmt::format("{}: has {} rows for {} names", name, first.size(), n);
    if (first[0] != 0) return fmt::format("{}: does not start at 0", name);
    for (std::size_t i = 0; i < n; ++i)
        if (first[i + 1] < first[i]) return fmt::format("{}: row {} is below the one before", name, i + 1);
    if (first[n] != n_rows) return fmt::format("{}: ends at {}, but there are {} rows", name, first[n], n_rows);
    return {};
}

}  // namespace

std::string Gradient::problem() const {
    const std::size_t n = parameters.name.size();
    if (parameters.unit.size() != n || parameters.value.size() != n || parameters.gradient.size() != n)
        return fmt::format("parameters: {} names, {} units, {} values and {} derivatives", n, parameters.unit.size(),
                           parameters.value.size(), parameters.gradient.size());
    for (const auto& [name, n_things, first, n_rows] :
         {std::tuple{"vertices/first", vertices.name.size(), &vertices.first, vertices.gradient.size() / 3},
          std::tuple{"texels/first", texels.name.size(), &texels.first, texels.gradient.size() / 3}})
        if (std::string bad = bad_ranges(name, n_things, *first, n_rows); !bad.empty()) return bad;
    if (texels.width.size() != texels.name.size() || texels.height.size() != texels.name.size())
        return "texels/width, texels/height: differ in length from texels/name";
    for (std::size_t i = 0; i < texels.name.size(); ++i)
        if (std::uint64_t{texels.width[i]} * texels.height[i] != texels.first[i + 1] - texels.first[i])
            return fmt::format("texels/first: image {} has {} rows, not {} x {}", i,
                               texels.first[i + 1] - texels.first[i], texels.width[i], texels.height[i]);
    return {};
}

void write_gradient(const Gradient& gradient, const std::filesystem::path& path, Sync sync) {
    write_format(gradient, path, sync);
}

Gradient read_gradient(const std::filesystem::path& path) {
    return read_format<Gradient>(path);
}

}  // namespace loom
