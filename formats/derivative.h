#pragma once
// derivative: derivatives of the light of every stored path, and light that appears or disappears at moving boundaries.
//
// Derivatives are with respect to the parameters of a scene, at the values for which the graph was traced. Interior rows
// belong to light edges of the graph; boundary rows are samples of their own. Neither depends on the response of a
// sensor, so that loom-transient turns both into bins without tracing.

#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "formats/io/documenter.h"
#include "formats/io/field.h"
#include "formats/io/mapped_file.h"
#include "formats/io/output_file.h"
#include "formats/io/provenance.h"

namespace loom {

struct PathGraph;

/// Estimator of a boundary row; value of `boundary/family`. Append only.
enum class BoundaryFamily : std::uint8_t {
    primary = 0,       // edges as the camera sees them
    vertex_light = 1,  // edges between a stored vertex and an emitter
    edge_light = 2,    // edges seen from a light point
    indirect = 3,      // edges between a stored vertex and a surface
    joined_light = 4,  // edges seen from a light point, their shadows from a stored vertex
};
inline constexpr int n_boundary_families = 5;
/// Largest number of bins whose borders temporal rows describe.
inline constexpr std::uint32_t max_temporal_bins = 1u << 16;
std::string_view boundary_family_name(BoundaryFamily family);

struct DerivativeHeader {
    std::string graph;                // content hash of the path graph, as in Provenance::inputs
    std::uint64_t n_light_edges = 0;  // of that graph
    std::uint64_t n_paths = 0;        // of that graph

    struct Parameters {
        std::vector<std::string> name, unit;
        Column<double> value;
    } parameters;

    Column<std::uint64_t> boundary_samples;  // [family]

    /// Bins for which temporal rows are exact, one row; empty columns: there are none. Energies are by parameter.
    struct TemporalBins {
        Column<double> start_opl, width_opl;
        Column<std::uint32_t> n;
        Column<std::uint8_t> camera_segment;
        Column<double> exact_energy, widened_energy;
    } temporal_bins;

    Provenance provenance;

    std::size_t n_parameters() const { return parameters.name.size(); }
    bool has_temporal() const { return !temporal_bins.n.empty(); }
};

template <template <class> class ColumnOf>
struct DerivativeOf : DerivativeHeader {
    static constexpr FormatId format{"derivative", 2, 0, 1};
    static constexpr FormatId format_of_most{"derivative", 1, 1};  // without light_points

    struct Interior {
        ColumnOf<std::uint32_t> edge;
        ColumnOf<float> dL, dopl;
    } interior;

    /// Points of lights that are seen wholly, in place of a stored light edge.
    struct LightPoints {
        ColumnOf<std::uint32_t> edge;
        ColumnOf<float> to_light, L, dL, dopl;
    } light_points;

    struct Seen {
        ColumnOf<std::uint32_t> path;
        ColumnOf<float> dLe, dopl;
    } seen;

    struct Boundary {
        ColumnOf<std::uint32_t> pixel;
        ColumnOf<double> opl, camera_opl;
        ColumnOf<float> dL;
        ColumnOf<std::uint8_t> family;
        ColumnOf<std::uint64_t> sample;
    } boundary;

    struct Temporal {
        ColumnOf<std::uint8_t> is_exact;
        ColumnOf<std::uint32_t> pixel, border;
        ColumnOf<float> flux, var_mean;
    } temporal;

    template <class Self, class Visitor>
    static void fields(Self& d, Visitor& v);
};

struct Derivative : DerivativeOf<Column> {
    std::shared_ptr<const void> storage;  // memory that columns borrow

    /// Returns the first violated invariant beyond types, lengths and finite floats; empty: none.
    std::string problem() const;
};

/// needs:   columns that share an axis have the same length
void write_derivative(const Derivative& derivative, const std::filesystem::path& path, Sync sync = Sync::yes);
/// Reads, maps and checks the whole file.
/// throws:  InputError naming the file and the dataset
Derivative read_derivative(const std::filesystem::path& path);
/// Refuses derivatives of another graph than `graph`, whose content is `graph_id`.
/// throws:  InputError naming both files and the command that makes matching derivatives
void require_derivative_of(const PathGraph& graph, const InputId& graph_id, const Derivative& derivative,
                           const std::filesystem::path& derivative_path);

template <template <class> class ColumnOf>
template <class Self, class Visitor>
void DerivativeOf<ColumnOf>::fields(Self& d, Visitor& v) {
    v.value("graph/hash", d.graph, "", "1", "content hash (XXH64, 16 hexadecimal digits) of the path graph");
    v.value("graph/n_light_edges", d.n_light_edges, "", "1", "light edges of the path graph");
    v.value("graph/n_paths", d.n_paths, "", "1", "paths of the path graph");

    auto& p = d.parameters;
    v.names("parameters/name", p.name, "parameter", "name as given by --wrt, with its component");
    v.names("parameters/unit", p.unit, "parameter", "unit of one step of the parameter");
    v.field("parameters/value", p.value, 1, "parameter", "parameters/unit",
            "value at which the derivatives hold; 0 for motions, which start from the scene as it is");

    const std::size_t n = d.n_parameters();
    constexpr std::string_view unit = "W m^-2 sr^-1 per parameters/unit";
    auto& i = d.interior;
    v.field(
        "interior/edge", i.edge, 1, "row", "1",
        "row of light_edges of the graph, increasing; edges without a row here and in light_points have derivative 0");
    v.grid("interior/dL", i.dL, {n, 3}, "row,parameter,rgb", unit,
           "derivative of the light that this edge brings to the pixel, of one path (not divided by the samples)",
           Finite::counted);
    v.grid("interior/dopl", i.dopl, {n}, "row,parameter", "m per parameters/unit",
           "derivative of the optical path length from the camera; 0 for lights at infinity", Finite::counted);

    auto& l = d.light_points;
    v.optional(
        "light_points/edge", l.edge, 1, "point", "1",
        "row of light_edges of the graph, of the first vertex of a path and none of interior/edge, not decreasing: the "
        "derivative of this edge is the sum over its points, each with its own light and length");
    v.optional("light_points/to_light", l.to_light, 1, "point", "m",
               "optical path length from the vertex to the point of the light");
    v.optional_grid(
        "light_points/L", l.L, {3}, "point,rgb", "W m^-2 sr^-1",
        "light that this point brings to the pixel, of one path; the points of an edge have the mean of its light",
        Finite::counted);
    v.optional_grid("light_points/dL", l.dL, {n, 3}, "point,parameter,rgb", unit, "derivative of light_points/L",
                    Finite::counted);
    v.optional_grid("light_points/dopl", l.dopl, {n}, "point,parameter", "m per parameters/unit",
                    "derivative of the optical path length from the camera", Finite::counted);

    auto& s = d.seen;
    v.field(
        "seen/path", s.path, 1, "seen", "1",
        "path whose directly visible emitter or environment (paths/Le), or whose segment from the camera to the first "
        "vertex, has a derivative; increasing");
    v.grid("seen/dLe", s.dLe, {n, 3}, "seen,parameter,rgb", unit, "derivative of paths/Le", Finite::counted);
    v.grid("seen/dopl", s.dopl, {n}, "seen,parameter", "m per parameters/unit",
           "derivative of the optical path length to the first vertex", Finite::counted);

    auto& b = d.boundary;
    v.field("boundary/samples", d.boundary_samples, 1, "family", "1",
            "samples of each family, those without light included: 0 primary, 1 stored vertex and emitter, 2 light "
            "point, 3 indirect, 4 light point and stored vertex");
    v.field("boundary/pixel", b.pixel, 1, "boundary", "1", "pixel, y width + x; rows are sorted by it");
    v.field("boundary/opl", b.opl, 1, "boundary", "m",
            "optical path length from the camera with phase indices; negative: light at infinity, which has no arrival "
            "time");
    v.field("boundary/camera_opl", b.camera_opl, 1, "boundary", "m",
            "its share from the camera to the first vertex; subtracted where that segment does not count (--unwarp)");
    v.grid("boundary/dL", b.dL, {n, 3}, "boundary,parameter,rgb", unit,
           "light that appears at the boundary; already divided by the samples: the rows of a pixel sum to its "
           "derivative",
           Finite::counted);
    v.field("boundary/family", b.family, 1, "boundary", "1",
            "estimator: 0 primary, 1 stored vertex and emitter, 2 light point, 3 indirect, 4 light point and stored "
            "vertex");
    v.field("boundary/sample", b.sample, 1, "boundary", "1",
            "sample of the family to which the row belongs; for families 1, 3 and 4 the path of the graph");

    auto& w = d.temporal_bins;
    v.optional("temporal/start_opl", w.start_opl, 1, "window", "m",
               "start of the first bin; border k of the bins is at start_opl + k width_opl");
    v.optional("temporal/width_opl", w.width_opl, 1, "window", "m", "width of a bin");
    v.optional("temporal/n", w.n, 1, "window", "1", "number of bins");
    v.optional("temporal/camera_segment", w.camera_segment, 1, "window", "1",
               "1: lengths count from the camera, 0: from the first hit");
    v.optional("temporal/exact_energy", w.exact_energy, 1, "parameter", "W m^-1 sr^-1 per parameters/unit",
               "sum of |luminance of L| |dopl| over the light whose change of arrival time is in temporal/flux");
    v.optional("temporal/widened_energy", w.widened_energy, 1, "parameter", "W m^-1 sr^-1 per parameters/unit",
               "the same sum over all other light, whose change needs a wider response");
    auto& t = d.temporal;
    v.optional("temporal/is_exact", t.is_exact, 1, "row", "1",
               "1: what interior/dopl moves between bins is in temporal/flux, 0: it is not");
    v.optional("temporal/pixel", t.pixel, 1, "crossing", "1", "pixel, y width + x; rows are sorted by it");
    v.optional("temporal/border", t.border, 1, "crossing", "1",
               "border of bins, 0 to n, increasing within a pixel; borders without a row have flux 0");
    v.optional_grid(
        "temporal/flux", t.flux, {n, 3}, "crossing,parameter,rgb", unit,
        "light that a delta pulse moves over the border towards later bins, mean of the paths of the pixel: "
        "bin k gains that of border k and loses that of border k + 1",
        Finite::counted);
    v.optional_grid("temporal/var_mean", t.var_mean, {n, 3}, "crossing,parameter,rgb", "squared",
                    "variance of temporal/flux", Finite::counted);
}

}  // namespace loom
