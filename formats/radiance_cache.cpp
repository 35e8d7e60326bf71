#include "formats/radiance_cache.h"

#include <fmt/format.h>

#include <algorithm>

#include "formats/io/hdf5_format.h"

namespace loom {
namespace {

using Points = RadianceCache::Points;

std::string bad_points(const RadianceCache& c) {
    const Points& x = c.points;
    for (const auto& [name, n] :
         {std::pair{"points/p", x.p.size()}, std::pair{"points/n", x.n.size()}, std::pair{"points/E", x.E.size()},
          std::pair{"points/var", x.var.size()}, std::pair{"points/members", x.members.size()}})
        if (n == 0) return fmt::format("{}: is absent or empty, but settings/method is points", name);
    if (!(c.metric.normal_weight >= 0)) return "metric/normal_weight: is negative";
    if (!(c.metric.length_scale > 0)) return "metric/length_scale: is not positive";
    if (!(c.metric.median_distance >= 0)) return "metric/median_distance: is negative";
    if (const auto at = std::find(x.members.begin(), x.members.end(), 0); at != x.members.end())
        return fmt::format("points/members: row {} is 0", at - x.members.begin());
    if (const auto at = std::find_if(x.var.begin(), x.var.end(), [](float v) { return v < 0; }); at != x.var.end())
        return fmt::format("points/var: row {} is negative", (at - x.var.begin()) / 3);
    return {};
}

std::string bad_grid(const RadianceCache& c) {
    const auto& [resolution, first, features] = c.grid;
    if (c.n_levels() == 0) return "grid/resolution: is absent or empty, but settings/method is grid";
    if (first.empty()) return "grid/first: is absent, but settings/method is grid";
    const std::size_t n_entries = features.size() / RadianceCache::features_per_level;
    if (first[0] != 0) return fmt::format("grid/first: starts at {}, not at 0", first[0]);
    if (first[c.n_levels()] != n_entries)
        return fmt::format("grid/first: ends at {}, but there are {} entries", first[c.n_levels()], n_entries);
    for (std::size_t level = 0; level < c.n_levels(); ++level) {
        if (resolution[level] == 0) return fmt::format("grid/resolution: row {} is 0", level);
        if (first[level] >= first[level + 1])
            return fmt::format("grid/first: does not grow from {} to {} at row {}", first[level], first[level + 1],
                               level + 1);
    }
    return {};
}

std::string bad_mlp(const RadianceCache& c) {
    const auto& [weight, rows, columns] = c.mlp;
    const std::size_t n = rows.size();
    if (n == 0) return "mlp/rows: is absent or empty, but settings/method is grid";
    if (columns.empty()) return "mlp/columns: is absent, but settings/method is grid";
    if (columns[0] != c.inputs.size())
        return fmt::format("mlp/columns: row 0 is {}, but there are {} inputs", columns[0], c.inputs.size());
    if (rows[n - 1] != 3) return fmt::format("mlp/rows: row {} is {}, expected 3 (rgb)", n - 1, rows[n - 1]);
    std::uint64_t left = weight.size();
    for (std::size_t i = 0; i < n; ++i) {
        if (rows[i] == 0 || columns[i] == 0) return fmt::format("mlp/rows, mlp/columns: row {} is 0", i);
        if (i > 0 && columns[i] != rows[i - 1])
            return fmt::format("mlp/columns: row {} is {}, but the layer before has {} outputs", i, columns[i],
                               rows[i - 1]);
        const std::uint64_t used = std::uint64_t{rows[i]} * columns[i];
        if (used > left)
            return fmt::format("mlp/weight: has {} rows, fewer than mlp/rows times mlp/columns", weight.size());
        left -= used;
    }
    if (left > 0) return fmt::format("mlp/weight: has {} rows more than mlp/rows times mlp/columns", left);
    return {};
}

}  // namespace

std::string RadianceCache::problem() const {
    if (settings.method != "points" && settings.method != "grid")
        return fmt::format("settings/method: is {}, expected points or grid", settings.method);
    if (demodulated > 1) return fmt::format("demodulated: is {}, expected 0 or 1", demodulated);
    if (!(settings.smallest_roughness >= 0)) return "settings/smallest_roughness: is negative";
    if (!(domain.size > 0)) return "domain/size: is not positive";
    for (const auto& [name, column] : {std::pair{"validation/relative_l2", &validation.relative_l2},
                                       std::pair{"validation/mean_ratio", &validation.mean_ratio}})
        if (const auto at = std::find_if(column->begin(), column->end(), [](double v) { return v < 0; });
            at != column->end())
            return fmt::format("{}: row {} is negative", name, at - column->begin());
    if (!is_grid()) return bad_points(*this);
    if (std::string bad = bad_grid(*this); !bad.empty()) return bad;
    return bad_mlp(*this);
}

void write_radiance_cache(const RadianceCache& cache, const std::filesystem::path& path, Sync sync) {
    write_format(cache, path, sync);
}

RadianceCache read_radiance_cache(const std::filesystem::path& path) {
    return read_format<RadianceCache>(path);
}

}  // namespace loom
