#include <fmt/format.h>
#include <fmt/ranges.h>

#include <array>
#include <filesystem>
#include <map>
#include <optional>

#include "formats/clusters.h"
#include "formats/io/cost.h"
#include "formats/io/json.h"
#include "stages/core/app/report.h"
#include "stages/core/transport/cluster_quality.h"
#include "stages/inspect/inspect.h"

namespace loom::inspect {
namespace {

/// Paths, vertices, edges and endings of a graph; shown under its head.
struct GraphFacts {
    std::size_t n_paths, n_vertices, n_edges;
    std::array<std::size_t, n_endings> endings{};
    std::vector<ColumnBytes> columns;

    explicit GraphFacts(const PathGraph& graph)
        : n_paths(graph.n_paths()),
          n_vertices(graph.n_vertices()),
          n_edges(graph.n_light_edges()),
          columns(column_bytes(graph)) {
        for (std::uint16_t flags : graph.vertices.flags)
            ++endings[static_cast<std::size_t>(ending_of(flags))];
    }
    double per_vertex(std::size_t n) const {
        return n_vertices == 0 ? 0.0 : static_cast<double>(n) / static_cast<double>(n_vertices);
    }
    double vertices_per_path() const {
        return n_paths == 0 ? 0.0 : static_cast<double>(n_vertices) / static_cast<double>(n_paths);
    }
    std::size_t total_bytes() const {
        std::size_t total = 0;
        for (const auto& column : columns) total += column.bytes;
        return total;
    }
};

bool is_path_graph(const Survey& survey) {
    return survey.attribute("filetype") == PathGraph::format.name;
}

bool is_clusters(const Survey& survey) {
    return survey.attribute("filetype") == Clusters::format.name;
}

/// Sizes of clusters; with the graph that they are of, their extent too.
struct ClusterFacts {
    ClusterSizes sizes;
    std::optional<ClusterSpread> spread;

    ClusterFacts(const std::string& file, const std::string& graph_file) {
        const Clusters clusters = read_clusters(file);
        sizes = cluster_sizes(clusters);
        if (graph_file.empty()) return;
        const PathGraph graph = read_path_graph(graph_file);
        require_clusters_of(graph, identify(graph_file), clusters, file);
        spread = cluster_spread(graph, clusters);
    }
    std::string text() const {
        return "\n" + text_of(sizes) + "\n" +
               (spread ? text_of(*spread) + "\n" : "radii and normals: name the graph with --graph\n");
    }
    void write(JsonWriter& json) const {
        json.begin_object("clusters");
        json.integer("n_clusters", sizes.n_clusters);
        json.integer("n_members", sizes.n_members);
        json.number("size_mean", sizes.mean);
        json.number("size_weighted_mean", sizes.size_weighted_mean);
        json.integer("size_min", sizes.min);
        json.integer("size_median", sizes.median);
        json.integer("size_p99", sizes.p99);
        json.integer("size_max", sizes.max);
        if (spread) {
            json.number("mean_distance", spread->mean_distance);
            json.number("median_radius", spread->median_radius);
            json.number("share_off_normal", spread->share_off_normal);
            json.number("share_opposed", spread->share_opposed);
        }
        json.end_object();
    }
};

bool has_cost(const std::string& file) {
    return std::filesystem::exists(cost_path(file));
}

std::string extents_text(const std::vector<std::size_t>& extents) {
    return extents.empty() ? "scalar" : fmt::format("{}", fmt::join(extents, " x "));
}

std::string shortened(std::string text, std::size_t n) {
    if (text.size() > n) text = text.substr(0, n - 3) + "...";
    return text;
}

std::string dataset_line(const DatasetSummary& d, std::size_t name_width) {
    std::string line = fmt::format("  {:<{}}  {:<9} {:>14}  {:<14}", d.name, name_width, d.type,
                                   extents_text(d.extents), d.units);
    if (!d.values.empty())
        return line + " " + shortened(fmt::format("{}", fmt::join(d.values, ", ")), 60) + "\n";
    if (!d.is_number) return line + "\n";
    const Statistics& s = d.statistics;
    line += fmt::format(" {:>11.5g} {:>11.5g} {:>11.5g}", s.min, s.mean, s.max);
    if (s.n_nan + s.n_inf > 0) line += fmt::format("  {} NaN, {} inf", s.n_nan, s.n_inf);
    return line + "\n";
}

std::string graph_text(const GraphFacts& facts) {
    std::string text = fmt::format(
        "\n{} paths, {} vertices ({:.3g} per path), {} light edges ({:.3g} per vertex)\n", facts.n_paths,
        facts.n_vertices, facts.vertices_per_path(), facts.n_edges, facts.per_vertex(facts.n_edges));
    text += "endings:";
    for (std::size_t k = 1; k < facts.endings.size(); ++k) {
        text +=
            fmt::format("{} {} {}", k == 1 ? "" : ",", facts.endings[k], ending_name(static_cast<Ending>(k)));
    }
    text += "\n\nbytes per vertex by column:\n";
    for (const auto& column : facts.columns) {
        if (column.axis != "vertex" && column.axis != "edge" && !column.axis.starts_with("path")) continue;
        text += fmt::format("  {:<28} {:>8.2f}\n", column.name, facts.per_vertex(column.bytes));
    }
    return text + fmt::format("  {:<28} {:>8.2f}\n", "all columns", facts.per_vertex(facts.total_bytes()));
}

void graph_json(const GraphFacts& facts, JsonWriter& json) {
    json.begin_object("path_graph");
    json.integer("n_paths", facts.n_paths);
    json.integer("n_vertices", facts.n_vertices);
    json.integer("n_light_edges", facts.n_edges);
    json.begin_object("endings");
    for (std::size_t k = 1; k < facts.endings.size(); ++k) {
        json.integer(ending_name(static_cast<Ending>(k)), facts.endings[k]);
    }
    json.end_object();
    json.begin_object("bytes_per_vertex");
    for (const auto& column : facts.columns) json.number(column.name, facts.per_vertex(column.bytes));
    json.end_object();
    json.end_object();
}

void dataset_json(const DatasetSummary& d, JsonWriter& json) {
    json.begin_object();
    json.text("name", d.name);
    json.text("type", d.type);
    json.begin_array("extents");
    for (std::size_t extent : d.extents) json.integer({}, extent);
    json.end_array();
    json.text("axes", d.axes);
    json.text("units", d.units);
    json.text("description", d.description);
    json.text("storage", d.storage);
    json.integer("bytes", d.bytes);
    if (d.is_number) {
        json.number("min", d.statistics.min);
        json.number("mean", d.statistics.mean);
        json.number("max", d.statistics.max);
        json.integer("nan", d.statistics.n_nan);
        json.integer("inf", d.statistics.n_inf);
    }
    if (!d.values.empty()) {
        json.begin_array("values");
        for (const auto& value : d.values) json.text({}, value);
        json.end_array();
    }
    json.end_object();
}

}  // namespace

std::string text_of(const Survey& survey, const std::string& file, const std::string& graph) {
    const std::string filetype = survey.attribute("filetype");
    std::string text =
        fmt::format("{}: {}, {}\n", file,
                    !filetype.empty() ? fmt::format("{} {}", filetype, survey.attribute("version"))
                    : survey.kind == Survey::Kind::exr ? "EXR of another program"
                                                       : "HDF5 of another program",
                    app::bytes_text(survey.file_bytes));
    for (const auto& [name, value] : survey.attributes) {
        if (name == "filetype" || name == "version" || value.empty()) continue;
        for (std::size_t at = 0; at < value.size();) {  // one line per input
            const std::size_t end = std::min(value.find('\n', at), value.size());
            text += fmt::format("  {:<18} {}\n", at == 0 ? name : "", value.substr(at, end - at));
            at = end + 1;
        }
    }
    if (has_cost(file)) {
        const Cost cost = read_cost(file);
        text += fmt::format("  {:<18} {}, {} of CPU, {} rays, {} samples, peak memory {}\n", "cost",
                            app::duration_text(cost.wall_s), app::duration_text(cost.cpu_s), cost.rays,
                            cost.samples, app::bytes_text(cost.peak_memory_bytes));
    }
    if (is_path_graph(survey)) text += graph_text(GraphFacts(read_path_graph(file)));
    if (is_clusters(survey)) text += ClusterFacts(file, graph).text();
    std::size_t name_width = 7;
    for (const auto& d : survey.datasets) name_width = std::max(name_width, d.name.size());
    text += fmt::format("\n  {:<{}}  {:<9} {:>14}  {:<14} {:>11} {:>11} {:>11}\n", "dataset", name_width,
                        "type", "extent", "units", "min", "mean", "max");
    for (const auto& d : survey.datasets) text += dataset_line(d, name_width);
    return text;
}

std::string json_of(const Survey& survey, const std::string& file, const std::string& graph) {
    JsonWriter json;
    json.begin_object();
    json.text("file", file);
    json.integer("bytes", survey.file_bytes);
    json.text("container", survey.kind == Survey::Kind::exr ? "exr" : "hdf5");
    json.begin_object("attributes");
    for (const auto& [name, value] : survey.attributes) json.text(name, value);
    json.end_object();
    if (has_cost(file)) {
        const Cost cost = read_cost(file);
        json.begin_object("cost");
        json.number("wall_s", cost.wall_s);
        json.number("cpu_s", cost.cpu_s);
        json.integer("rays", cost.rays);
        json.integer("samples", cost.samples);
        json.integer("peak_memory_bytes", cost.peak_memory_bytes);
        json.end_object();
    }
    if (is_path_graph(survey)) graph_json(GraphFacts(read_path_graph(file)), json);
    if (is_clusters(survey)) ClusterFacts(file, graph).write(json);
    json.begin_array("datasets");
    for (const auto& d : survey.datasets) dataset_json(d, json);
    json.end_array();
    json.end_object();
    return json.str();
}

}  // namespace loom::inspect
