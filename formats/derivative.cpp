#include "formats/derivative.h"

#include <fmt/format.h>

#include <algorithm>
#include <functional>
#include <tuple>

#include "formats/io/error.h"
#include "formats/io/hdf5_format.h"
#include "formats/path_graph.h"

namespace loom {
namespace {

/// Returns the first row whose number is not above the one before, or not below `end`; the size when all are.
std::size_t first_unsorted(const Column<std::uint32_t>& rows, std::uint64_t end) {
    for (std::size_t i = 0; i < rows.size(); ++i)
        if (rows[i] >= end || (i > 0 && rows[i] <= rows[i - 1])) return i;
    return rows.size();
}

/// Whether a sample of a family is a path of the graph.
bool is_of_path(std::uint8_t family) {
    return BoundaryFamily(family) != BoundaryFamily::primary && BoundaryFamily(family) != BoundaryFamily::edge_light;
}

/// Boundary rows must lie in pixels of the graph, those that belong to a path in its pixel.
std::string bad_pixel(const PathGraph& graph, const Derivative& derivative) {
    const auto& b = derivative.boundary;
    if (b.pixel.empty()) return {};
    const std::uint32_t last = b.pixel[b.pixel.size() - 1];
    if (last >= graph.n_pixels())
        return fmt::format("boundary/pixel goes to {}, but the graph has {} pixels", last, graph.n_pixels());
    for (std::size_t i = 0; i < b.pixel.size(); ++i)
        if (is_of_path(b.family[i]) && b.sample[i] % graph.n_pixels() != b.pixel[i])
            return fmt::format("boundary/pixel: row {} is {}, but path {} is of pixel {}", i, b.pixel[i], b.sample[i],
                               b.sample[i] % graph.n_pixels());
    return {};
}

/// Points of lights must replace edges to finite lights at the first vertices of paths.
std::string bad_light_point(const PathGraph& graph, const Derivative& derivative) {
    const auto& first = graph.paths.first_vertex;
    auto path = first.begin();
    for (const std::uint32_t edge : derivative.light_points.edge) {
        const std::uint32_t vertex = graph.light_edges.vertex[edge];
        path = std::lower_bound(path, first.end(), vertex);
        if (path == first.end() || *path != vertex)
            return fmt::format("light_points/edge: edge {} is of vertex {}, which is the first of no path", edge,
                               vertex);
        if (graph.light_edges.y[4 * std::size_t(edge) + 3] == 0)
            return fmt::format("light_points/edge: edge {} leads to infinity", edge);
    }
    return {};
}

/// Returns the first violated invariant of temporal rows; empty: none.
std::string temporal_problem(const Derivative& d) {
    const auto& bins = d.temporal_bins;
    const auto& t = d.temporal;
    const auto refuse_rows = [&] { return !t.pixel.empty() || !t.is_exact.empty(); };
    if (!d.has_temporal()) return refuse_rows() ? "temporal: has rows, but no temporal/n" : std::string();
    if (bins.n.size() != 1 || bins.start_opl.size() != 1 || bins.width_opl.size() != 1 ||
        bins.camera_segment.size() != 1)
        return "temporal: start_opl, width_opl, n and camera_segment have one row each";
    if (!d.light_points.edge.empty()) return "temporal: rows beside light_points";
    if (!(bins.width_opl[0] > 0)) return fmt::format("temporal/width_opl: is {}, expected > 0", bins.width_opl[0]);
    if (bins.n[0] == 0 || bins.n[0] > max_temporal_bins)
        return fmt::format("temporal/n: is {}, expected 1 to {}", bins.n[0], max_temporal_bins);
    if (bins.camera_segment[0] > 1)
        return fmt::format("temporal/camera_segment: is {}, expected 0 or 1", bins.camera_segment[0]);
    if (bins.exact_energy.size() != d.n_parameters() || bins.widened_energy.size() != d.n_parameters())
        return "temporal/exact_energy, widened_energy: expected one row per parameter";
    if (t.is_exact.size() != d.interior.edge.size())
        return fmt::format("temporal/is_exact: has {} rows, but interior/edge has {}", t.is_exact.size(),
                           d.interior.edge.size());
    for (std::size_t i = 0; i < t.is_exact.size(); ++i)
        if (t.is_exact[i] > 1) return fmt::format("temporal/is_exact: row {} is {}, expected 0 or 1", i, t.is_exact[i]);
    if (t.border.size() != t.pixel.size() || t.flux.size() != 3 * d.n_parameters() * t.pixel.size() ||
        t.var_mean.size() != t.flux.size())
        return "temporal: pixel, border, flux and var_mean have different numbers of rows";
    for (std::size_t i = 0; i < t.pixel.size(); ++i) {
        if (t.border[i] > bins.n[0])
            return fmt::format("temporal/border: row {} is {}, but there are {} bins", i, t.border[i], bins.n[0]);
        if (i > 0 && std::pair(t.pixel[i], t.border[i]) <= std::pair(t.pixel[i - 1], t.border[i - 1]))
            return fmt::format("temporal/pixel, border: row {} is not after the row before", i);
    }
    return {};
}

/// Returns the first violated invariant of the points of lights; empty: none.
std::string light_points_problem(const Derivative& d) {
    const auto& l = d.light_points;
    if (l.to_light.size() != l.edge.size() || l.L.size() != 3 * l.edge.size() ||
        l.dL.size() != 3 * d.n_parameters() * l.edge.size() || l.dopl.size() != d.n_parameters() * l.edge.size())
        return "light_points: edge, to_light, L, dL and dopl have different numbers of rows";
    std::size_t row = 0;
    for (std::size_t i = 0; i < l.edge.size(); ++i) {
        if (l.edge[i] >= d.n_light_edges || (i > 0 && l.edge[i] < l.edge[i - 1]))
            return fmt::format("light_points/edge: row {} is {}, decreasing or not below {}", i, l.edge[i],
                               d.n_light_edges);
        if (!(l.to_light[i] >= 0)) return fmt::format("light_points/to_light: row {} is {}", i, l.to_light[i]);
        while (row < d.interior.edge.size() && d.interior.edge[row] < l.edge[i]) ++row;
        if (row < d.interior.edge.size() && d.interior.edge[row] == l.edge[i])
            return fmt::format("light_points/edge: row {} is {}, which is in interior/edge, too", i, l.edge[i]);
    }
    return {};
}

}  // namespace

std::string_view boundary_family_name(BoundaryFamily family) {
    switch (family) {
        case BoundaryFamily::primary:
            return "primary";
        case BoundaryFamily::vertex_light:
            return "vertex-light";
        case BoundaryFamily::edge_light:
            return "edge-light";
        case BoundaryFamily::indirect:
            return "indirect";
        case BoundaryFamily::joined_light:
            break;
    }
    return "joined-light";
}

std::string Derivative::problem() const {
    const std::size_t n = n_parameters();
    if (n == 0) return "parameters/name: has no rows";
    if (parameters.unit.size() != n || parameters.value.size() != n)
        return fmt::format("parameters: {} names, {} units and {} values", n, parameters.unit.size(),
                           parameters.value.size());
    constexpr std::size_t fewest = 4;  // of version 1.0
    if (boundary_samples.size() < fewest || boundary_samples.size() > n_boundary_families)
        return fmt::format("boundary/samples: has {} rows, expected {} to {}", boundary_samples.size(), fewest,
                           n_boundary_families);
    for (const auto& [name, rows, end] :
         {std::tuple{"interior/edge", &interior.edge, n_light_edges}, std::tuple{"seen/path", &seen.path, n_paths}})
        if (const std::size_t i = first_unsorted(*rows, end); i < rows->size())
            return fmt::format("{}: row {} is {}, not increasing or not below {}", name, i, (*rows)[i], end);
    if (!std::is_sorted(boundary.pixel.begin(), boundary.pixel.end())) return "boundary/pixel: is not sorted";
    for (std::size_t i = 0; i < boundary.family.size(); ++i) {
        const double opl = boundary.opl[i], from_camera = boundary.camera_opl[i];
        // Sums of the two round differently.
        if (!(from_camera >= 0) || (opl >= 0 && from_camera > opl * (1 + 1e-6)))
            return fmt::format("boundary/camera_opl: row {} is {}, expected 0 to its opl, {}", i, from_camera, opl);
        const std::uint8_t family = boundary.family[i];
        if (family >= boundary_samples.size())
            return fmt::format("boundary/family: row {} is {}, expected 0 to {}", i, family,
                               boundary_samples.size() - 1);
        if (const std::uint64_t end = is_of_path(family) ? n_paths : boundary_samples[family];
            boundary.sample[i] >= end)
            return fmt::format("boundary/sample: row {} is {}, but family {} has {}", i, boundary.sample[i], family,
                               end);
    }
    if (std::string bad = light_points_problem(*this); !bad.empty()) return bad;
    return temporal_problem(*this);
}

void write_derivative(const Derivative& derivative, const std::filesystem::path& path, Sync sync) {
    write_format(derivative, path, sync,
                 derivative.light_points.edge.empty() ? Derivative::format_of_most : Derivative::format);
}

Derivative read_derivative(const std::filesystem::path& path) {
    return read_format<Derivative>(path);
}

void require_derivative_of(const PathGraph& graph, const InputId& graph_id, const Derivative& derivative,
                           const std::filesystem::path& derivative_path) {
    if (derivative.graph == graph_id.hash && derivative.n_light_edges == graph.n_light_edges() &&
        derivative.n_paths == graph.n_paths()) {
        const auto& moved = derivative.temporal.pixel;
        if (!moved.empty() && moved[moved.size() - 1] >= graph.n_pixels())
            throw InputError(fmt::format("{}: temporal/pixel goes to {}, but the graph has {} pixels",
                                         derivative_path.native(), moved[moved.size() - 1], graph.n_pixels()));
        for (const auto& check : {bad_pixel, bad_light_point})
            if (const std::string bad = check(graph, derivative); !bad.empty())
                throw InputError(fmt::format("{}: {}", derivative_path.native(), bad));
        return;
    }
    const std::string made_from =
        derivative.provenance.inputs.size() < 2 ? "another graph" : derivative.provenance.inputs[1].name;
    throw InputError(
        fmt::format("{}: made from {} (content {}), not from {} (content {}); run: loom-derive SCENE {} --wrt NAME "
                    "-o {}",
                    derivative_path.native(), made_from, derivative.graph, graph_id.name, graph_id.hash, graph_id.name,
                    derivative_path.native()));
}

}  // namespace loom
