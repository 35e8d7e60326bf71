#include "formats/path_graph.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "formats/io/content_hash.h"
#include "formats/io/hdf5_format.h"

namespace loom {
namespace {

/// Rows at least `count` that an index column names; empty when there are none.
template <class T>
std::string bad_index(std::string_view name, const Column<T>& column, std::size_t count, std::string_view what) {
    T largest = 0;
    for (T value : column) largest = std::max(largest, value);
    if (column.empty() || largest < count) return {};
    std::size_t row = 0;
    while (column[row] < count) ++row;
    return fmt::format("{}: row {} is {}, but there are {} {}", name, row, column[row], count, what);
}

/// First row for which `good` is false; the size when there is none. Counts in blocks without a branch, so
/// that a check runs at the speed of memory.
template <class Good>
std::size_t first_bad(std::size_t n, Good good) {
    constexpr std::size_t block = 4096;
    for (std::size_t begin = 0; begin < n; begin += block) {
        const std::size_t end = std::min(n, begin + block);
        unsigned n_bad = 0;
        for (std::size_t i = begin; i < end; ++i) n_bad += good(i) ? 0u : 1u;
        if (n_bad == 0) continue;
        while (good(begin)) ++begin;
        return begin;
    }
    return n;
}

std::string bad_offsets(const PathGraph& g) {
    const auto& first = g.paths.first_vertex;
    const std::size_t n_paths = g.n_paths();
    if (first[0] != 0) return fmt::format("paths/first_vertex: starts at {}, not at 0", first[0]);
    const std::size_t row = first_bad(n_paths, [&](std::size_t i) { return first[i] <= first[i + 1]; });
    if (row < n_paths) {
        return fmt::format("paths/first_vertex: decreases from {} to {} at row {}", first[row], first[row + 1],
                           row + 1);
    }
    if (first[n_paths] != g.n_vertices()) {
        return fmt::format("paths/first_vertex: ends at {}, but there are {} vertices", first[n_paths], g.n_vertices());
    }
    const std::size_t n_pixels = g.n_pixels();
    const bool whole =
        n_pixels == 0 ? n_paths == 0 : n_paths % n_pixels == 0 && n_paths / n_pixels == g.tracing.samples_per_pixel;
    if (!whole) {
        return fmt::format("paths/first_vertex: has {} paths, but the sensor has {} x {} pixels of {} samples", n_paths,
                           g.sensor.width, g.sensor.height, g.tracing.samples_per_pixel);
    }
    return {};
}

/// `continued` must be set on every vertex of a path but the last, which must say how it ended.
std::string bad_flags(const PathGraph& g) {
    const auto& first = g.paths.first_vertex;
    const auto& flags = g.vertices.flags;
    for (std::size_t i = 0; i < g.n_paths(); ++i) {
        for (std::uint64_t j = first[i]; j < first[i + 1]; ++j) {
            const bool continued = (flags[j] & vertex_flag::continued) != 0;
            const int ending = static_cast<int>(ending_of(flags[j]));
            if (continued != (j + 1 < first[i + 1])) {
                return fmt::format("vertices/flags: row {} is {}continued, but is {}the last of path {}", j,
                                   continued ? "" : "not ", continued ? "" : "not ", i);
            }
            if (continued != (ending == 0) || ending >= n_endings) {
                return fmt::format("vertices/flags: row {} is {}continued and has ending {}", j,
                                   continued ? "" : "not ", ending);
            }
        }
    }
    return {};
}

std::string bad_vertices(const PathGraph& g) {
    const auto& x = g.vertices;
    const std::size_t n = g.n_vertices();
    const float* wo = x.wo.data();
    const std::size_t long_wo = first_bad(n, [&](std::size_t j) {
        const float* w = wo + 3 * j;
        return std::fabs(w[0] * w[0] + w[1] * w[1] + w[2] * w[2] - 1.0f) < 1e-3f;
    });
    if (long_wo < n) return fmt::format("vertices/wo: row {} is not a unit vector", long_wo);
    const std::size_t negative = first_bad(n, [&](std::size_t j) { return x.pdf_w[j] >= 0; });
    if (negative < n) return fmt::format("vertices/pdf_w: row {} is negative", negative);
    const std::size_t bad_q = first_bad(x.q.size(), [&](std::size_t j) { return x.q[j] >= 0 && x.q[j] <= 1; });
    if (bad_q < x.q.size()) return fmt::format("vertices/q: row {} is {}, not in [0, 1]", bad_q, x.q[bad_q]);
    return {};
}

template <class InOrder>
std::string bad_order(std::string_view name, std::size_t n, InOrder in_order) {
    const std::size_t unsorted = first_bad(n < 2 ? 0 : n - 1, in_order);
    return n < 2 || unsorted == n - 1
               ? std::string()
               : fmt::format("{}: row {} is not in order (by vertex, then technique)", name, unsorted + 1);
}

std::string bad_order_of_edges(const PathGraph& g) {
    const auto& e = g.light_edges;
    return bad_order("light_edges/vertex", g.n_light_edges(), [&](std::size_t k) {
        return e.vertex[k] < e.vertex[k + 1] ||
               (e.vertex[k] == e.vertex[k + 1] && e.technique[k] <= e.technique[k + 1]);
    });
}

std::string bad_order_of_misses(const PathGraph& g) {
    const auto& m = g.misses;
    const std::size_t n = g.n_misses();
    if (m.technique.size() != n || m.y.size() != 4 * n || m.emitter.size() != n)
        return "misses: some of its columns are there, some are not";
    return bad_order("misses/vertex", n, [&](std::size_t k) {
        return m.vertex[k] < m.vertex[k + 1] || (m.vertex[k] == m.vertex[k + 1] && m.technique[k] < m.technique[k + 1]);
    });
}

/// What light edges and misses have in common.
std::string bad_attempts(std::string_view group, const Column<std::uint8_t>& technique, const Column<float>& y) {
    const std::size_t n = technique.size();
    const std::size_t unknown = first_bad(n, [&](std::size_t k) { return technique[k] <= 1; });
    if (unknown < n) return fmt::format("{}/technique: row {} is {}, not 0 or 1", group, unknown, technique[unknown]);
    const std::size_t bad_w = first_bad(n, [&](std::size_t k) { return y[4 * k + 3] == 0 || y[4 * k + 3] == 1; });
    if (bad_w < n) return fmt::format("{}/y: row {} has w = {}, not 0 or 1", group, bad_w, y[4 * bad_w + 3]);
    return {};
}

std::string bad_edges(const PathGraph& g) {
    const auto& e = g.light_edges;
    const std::size_t n = g.n_light_edges();
    if (auto bad = bad_attempts("light_edges", e.technique, e.y); !bad.empty()) return bad;
    const std::size_t negative =
        first_bad(n, [&](std::size_t k) { return e.pdf_nee_w[k] >= 0 && e.pdf_bsdf_w[k] >= 0; });
    if (negative < n) return fmt::format("light_edges/pdf_nee_w or pdf_bsdf_w: row {} is negative", negative);
    return {};
}

/// Grids, points and pixels of a capture must be of one size.
std::string bad_capture(const PathGraph& g) {
    const auto& c = g.nlos;
    for (std::size_t i = 0; g.emitters.position.empty() && i < g.emitters.kind.size(); ++i)
        if (g.emitters.kind[i] >= std::uint8_t(EmitterKind::projector))
            return fmt::format("emitters/position: is missing for row {}", i);
    const bool scans = g.sensor.kind == "nlos_capture_meter";
    if (scans && c.capture.empty()) return "nlos/capture: is not there, but sensor/kind is nlos_capture_meter";
    if (c.capture.empty()) return {};
    if (!scans && c.capture[0] != 0)
        return fmt::format("nlos/capture: is {}, but sensor/kind {} takes single captures (0)", c.capture[0],
                           g.sensor.kind);
    if (c.capture[0] > 2) return fmt::format("nlos/capture: is {}, not 0, 1 or 2", c.capture[0]);
    if (c.grids.empty() || c.laser.empty() || c.true_area.empty()) return "nlos: grids, laser or true_area is missing";
    const std::size_t n_sensor = std::size_t(c.grids[0]) * c.grids[1], n_laser = std::size_t(c.grids[2]) * c.grids[3];
    const std::size_t n_points = scans ? n_sensor : 0;
    if (c.sensor_points.size() != 3 * n_points || c.sensor_normals.size() != 3 * n_points)
        return fmt::format("nlos/sensor_points, sensor_normals: not {} rows, the number {}", n_points,
                           scans ? "in nlos/grids" : "of a camera");
    if (c.laser_points.size() != 3 * n_laser || c.laser_normals.size() != 3 * n_laser)
        return fmt::format("nlos/laser_points, laser_normals: not {} rows, the number in nlos/grids", n_laser);
    if (g.n_pixels() != (c.capture[0] == 2 ? n_sensor * n_laser : n_sensor))
        return fmt::format("sensor/width, height: {} pixels do not fit nlos/grids", g.n_pixels());
    return {};
}

/// A parameter that some material leaves to its vertices must be there.
std::string missing_parameter(const PathGraph& g) {
    const auto& x = g.vertices;
    const std::array<std::pair<std::string_view, bool>, 7> columns{
        {{"vertices/diffuse", x.diffuse.empty()},
         {"vertices/specular", x.specular.empty()},
         {"vertices/transmittance", x.transmittance.empty()},
         {"vertices/alpha", x.alpha.empty()},
         {"vertices/opacity", x.opacity.empty()},
         {"vertices/exponent", x.exponent.empty()},
         {"vertices/eta_c or vertices/k_c",
          x.eta_c.empty() || x.k_c.empty()}}};  // in the order of the bits of textured_parameter
    for (std::size_t row = 0; g.n_vertices() > 0 && row < g.materials.textured.size(); ++row) {
        for (std::size_t bit = 0; bit < columns.size(); ++bit) {
            if ((g.materials.textured[row] >> bit & 1) == 0 || !columns[bit].second) continue;
            return fmt::format("materials/textured: row {} leaves a parameter to {}, which is not there", row,
                               columns[bit].first);
        }
    }
    return {};
}

/// Rows of coats must be whole, of materials that there are, and of rising roughness.
std::string bad_coats(const PathGraph& g) {
    const auto& c = g.coats;
    const std::size_t n = c.material.size();
    if (c.alpha.size() != n || c.fdr_int.size() != n || c.fdr_ext.size() != n ||
        c.external_transmittance.size() != 64 * n)
        return "coats: some of its columns are there, some are not";
    for (std::size_t i = 1; i < n; ++i)
        if (c.material[i] < c.material[i - 1] ||
            (c.material[i] == c.material[i - 1] && !(c.alpha[i] >= c.alpha[i - 1])))
            return fmt::format("coats/material: row {} is not in order (by material, then alpha)", i);
    return bad_index("coats/material", c.material, g.materials.id.size(), "materials");
}

/// Whether a reader of 1.2 would take one value where each vertex has its own, or a default for what a material says.
bool misread_by_1_2(const PathGraphHeader& g) {
    constexpr std::uint8_t newer = textured_parameter::exponent | textured_parameter::index;
    const auto& textured = g.materials.textured;
    if (!g.materials.variant.empty() || !g.materials.bump_shadowing.empty()) return true;
    return !g.coats.material.empty() ||
           std::any_of(textured.begin(), textured.end(), [](std::uint8_t bits) { return (bits & newer) != 0; });
}

/// Rows of materials, or no_medium.
std::string bad_media(std::string_view name, const Column<std::uint16_t>& medium, const PathGraph& g) {
    const std::size_t n_materials = g.materials.id.size();
    const std::size_t row =
        first_bad(medium.size(), [&](std::size_t i) { return medium[i] < n_materials || medium[i] == no_medium; });
    if (row == medium.size()) return {};
    return fmt::format("{}: row {} is {}, but there are {} materials ({}: outside)", name, row, medium[row],
                       n_materials, no_medium);
}

/// Oldest version whose readers understand a graph: 1.2, 2.0 if a reader of 1.2 would misread it, and the next minor
/// version with columns that those do not know.
template <class Graph>
FormatId version_of(const Graph& g) {
    FormatId version = Graph::format_of_most;
    if (misread_by_1_2(g)) version = {Graph::format.name, Graph::format.major, 0, Graph::format.oldest_major};
    if (!g.vertices.primitive.empty() || !g.vertices.medium.empty()) ++version.minor;
    return version;
}

template <class Graph>
void write_graph(const Graph& graph, const std::filesystem::path& path, Sync sync) {
    if (graph.n_vertices() > std::numeric_limits<std::uint32_t>::max()) {
        throw InputError(
            fmt::format("{}: {} vertices are more than one path graph can number; use fewer samples per "
                        "file",
                        path.native(), graph.n_vertices()));
    }
    write_format(graph, path, sync, version_of(graph));
}

template <class Graph>
std::vector<ColumnBytes> sizes_of(const Graph& graph) {
    ColumnSizer sizer;
    Graph::fields(graph, sizer);
    return sizer.sizes;
}

}  // namespace

std::string_view ending_name(Ending ending) {
    constexpr std::array<std::string_view, n_endings> names{"none",           "escaped",   "roulette",
                                                            "invalid sample", "max depth", "hit emitter"};
    const auto k = static_cast<std::size_t>(ending);
    return k < names.size() ? names[k] : "unknown";
}

std::string_view emitter_kind_name(std::uint8_t kind) {
    constexpr std::array<std::string_view, n_emitter_kinds> names{"area",     "point",  "spot",      "directional",
                                                                  "constant", "envmap", "projector", "laser spot"};
    return kind < names.size() ? names[kind] : "unknown";
}

std::string PathGraph::problem(Check check) const {
    if (sensor.kind != "perspective" && sensor.kind != "orthographic" && sensor.kind != "nlos_capture_meter")
        return fmt::format("sensor/kind: is {}, expected perspective, orthographic or nlos_capture_meter", sensor.kind);
    if (auto bad = bad_capture(*this); !bad.empty()) return bad;
    // Offsets first: the later checks walk through them.
    if (auto bad = bad_offsets(*this); !bad.empty()) return bad;
    if (auto bad = bad_index("vertices/material", vertices.material, materials.id.size(), "materials"); !bad.empty())
        return bad;
    if (auto bad = bad_index("vertices/shape", vertices.shape, shapes.id.size(), "shapes"); !bad.empty()) return bad;
    if (auto bad = bad_index("light_edges/vertex", light_edges.vertex, n_vertices(), "vertices"); !bad.empty())
        return bad;
    if (auto bad = bad_index("light_edges/emitter", light_edges.emitter, emitters.id.size(), "emitters"); !bad.empty())
        return bad;
    if (auto bad = bad_index("misses/vertex", misses.vertex, n_vertices(), "vertices"); !bad.empty()) return bad;
    if (auto bad = bad_index("misses/emitter", misses.emitter, emitters.id.size(), "emitters"); !bad.empty())
        return bad;
    if (auto bad = bad_media("vertices/medium", vertices.medium, *this); !bad.empty()) return bad;
    if (auto bad = bad_media("light_edges/medium", light_edges.medium, *this); !bad.empty()) return bad;
    if (vertices.medium.empty() != light_edges.medium.empty() && n_vertices() > 0 && n_light_edges() > 0)
        return "vertices/medium, light_edges/medium: one of them is missing";
    if (auto bad = missing_parameter(*this); !bad.empty()) return bad;
    if (auto bad = bad_coats(*this); !bad.empty()) return bad;
    if (auto bad = bad_order_of_edges(*this); !bad.empty()) return bad;
    if (auto bad = bad_order_of_misses(*this); !bad.empty()) return bad;
    if (check == Check::structure) return {};
    if (auto bad = bad_flags(*this); !bad.empty()) return bad;
    if (auto bad = bad_vertices(*this); !bad.empty()) return bad;
    if (auto bad = bad_edges(*this); !bad.empty()) return bad;
    return bad_attempts("misses", misses.technique, misses.y);
}

void write_path_graph(const PathGraph& graph, const std::filesystem::path& path, Sync sync) {
    write_graph(graph, path, sync);
}
void write_path_graph(const PathGraphInPieces& graph, const std::filesystem::path& path, Sync sync) {
    write_graph(graph, path, sync);
}

PathGraph read_path_graph(const std::filesystem::path& path, Check check) {
    return read_format<PathGraph>(path, check);
}

InputId identify_by_header(const PathGraph& graph, const std::filesystem::path& path) {
    const Provenance& made = graph.provenance;
    std::string text =
        fmt::format("{}\n{}\n{}\n{}\n{} {} {} {}\n", producer_text(made), made.command, made.seed, made.plan,
                    graph.n_paths(), graph.n_vertices(), graph.n_light_edges(), graph.n_misses());
    for (const InputId& input : made.inputs) text += input_text(input) + "\n";
    return {path.filename().native(), content_hash_text(content_hash(std::as_bytes(std::span(text))))};
}

std::vector<ColumnBytes> column_bytes(const PathGraph& graph) {
    return sizes_of(graph);
}
std::vector<ColumnBytes> column_bytes(const PathGraphInPieces& graph) {
    return sizes_of(graph);
}

}  // namespace loom
