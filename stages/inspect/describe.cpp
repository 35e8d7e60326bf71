#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <filesystem>
#include <map>
#include <numeric>
#include <optional>

#include "formats/chain.h"
#include "formats/clusters.h"
#include "formats/fit.h"
#include "formats/gradient.h"
#include "formats/image.h"
#include "formats/io/cost.h"
#include "formats/io/error.h"
#include "formats/io/json.h"
#include "formats/radiance_cache.h"
#include "formats/transient_cube.h"
#include "stages/core/app/report.h"
#include "stages/core/clusters/cluster_quality.h"
#include "stages/core/math/vector.h"
#include "stages/inspect/inspect.h"

namespace loom::inspect {
namespace {

/// Paths, vertices, edges and endings of a graph; printed under its heading.
struct GraphFacts {
    std::size_t n_paths, n_vertices, n_edges;
    std::array<std::size_t, n_endings> endings{};
    std::vector<ColumnBytes> columns;

    explicit GraphFacts(const PathGraph& graph)
        : n_paths(graph.n_paths()),
          n_vertices(graph.n_vertices()),
          n_edges(graph.n_light_edges()),
          columns(column_bytes(graph)) {
        for (std::uint16_t flags : graph.vertices.flags) ++endings[static_cast<std::size_t>(ending_of(flags))];
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

/// Sizes of clusters; with their graph also their extent.
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
        return fmt::format("\n{}\n{}\n", text_of(sizes),
                           spread ? text_of(*spread) : "radii and normals: give the graph with --graph");
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

/// Window, response and distribution of the light of a transient cube.
struct CubeFacts {
    TransientCubeHeader header;
    double inside = 0, before = 0, after = 0, never = 0, steady = 0;  // luminance, mean over the pixels
    double relative_error = 0;  // root of the summed variances over the sum of the bins
    double brightest = 0;
    std::size_t brightest_x = 0, brightest_y = 0, brightest_bin = 0;
    double half_by = 0;  // time by which half of the light in the bins has arrived, in the cube's unit

    /// Derivative by one parameter: luminance, mean over the pixels.
    struct OfParameter {
        double steady = 0, inside = 0, magnitude = 0;  // magnitude: sum of |derivative| over the bins
        double error = 0;                              // standard error of steady
    };
    std::vector<OfParameter> parameters;

    explicit CubeFacts(const std::string& file) {
        const TransientCube cube = read_transient_cube(file);
        header = cube;
        const std::size_t n = cube.time.n_bins;
        const auto sum_of = [&](const Column<float>& field) {
            double sum = 0;
            for (std::size_t i = 0; i < field.size(); i += 3)
                sum += luminance(Rgb<double>(field[i], field[i + 1], field[i + 2]));
            return sum / double(cube.n_pixels());
        };
        before = sum_of(cube.before), after = sum_of(cube.after), never = sum_of(cube.never),
        steady = sum_of(cube.steady);
        std::vector<double> of_bin(n);
        double variance = 0;
        for (std::size_t i = 0; i < cube.radiance.size(); i += 3) {
            const double Y = luminance(Rgb<double>(cube.radiance[i], cube.radiance[i + 1], cube.radiance[i + 2]));
            // Channels of a path are correlated: their standard deviations add up.
            const double sd =
                luminance(Rgb<double>(std::sqrt(double(cube.var_mean[i])), std::sqrt(double(cube.var_mean[i + 1])),
                                      std::sqrt(double(cube.var_mean[i + 2]))));
            variance += sd * sd;
            of_bin[i / 3 % n] += Y / double(cube.n_pixels());
            if (Y > brightest) {
                brightest = Y;
                brightest_bin = i / 3 % n;
                brightest_x = i / 3 / n % cube.film.width, brightest_y = i / 3 / n / cube.film.width;
            }
        }
        for (double Y : of_bin) inside += Y;
        relative_error = std::sqrt(variance) / double(cube.n_pixels()) / inside;
        double seen = 0;
        for (std::size_t bin = 0; bin < n && seen < inside / 2; ++bin) {
            seen += of_bin[bin];
            half_by = opening_of(bin + 1);
        }
        for (std::size_t p = 0; p < header.n_parameters(); ++p) parameters.push_back(of_parameter(cube, p));
    }
    static OfParameter of_parameter(const TransientCube& cube, std::size_t p) {
        OfParameter facts;
        const auto at = [](const Column<float>& values, std::size_t i) {
            return luminance(Rgb<double>(values[i], values[i + 1], values[i + 2]));
        };
        const auto& d = cube.derivative;
        const std::size_t bins = cube.radiance.size(), pixels = cube.steady.size();
        const double n_pixels = double(cube.n_pixels());
        for (std::size_t i = p * bins; i < (p + 1) * bins; i += 3) {
            facts.inside += at(d.bins, i) / n_pixels;
            facts.magnitude += std::abs(at(d.bins, i)) / n_pixels;
        }
        double variance = 0;
        for (std::size_t i = p * pixels; i < (p + 1) * pixels; i += 3) {
            facts.steady += at(d.steady, i) / n_pixels;
            // Channels of a path are correlated: their standard deviations add up.
            const auto& v = d.steady_var_mean;
            const double sd = luminance(
                Rgb<double>(std::sqrt(double(v[i])), std::sqrt(double(v[i + 1])), std::sqrt(double(v[i + 2]))));
            variance += sd * sd;
        }
        facts.error = std::sqrt(variance) / n_pixels;
        return facts;
    }
    double opening_of(std::size_t bin) const {
        return header.in_unit(header.time.start_opl + double(bin) * header.time.bin_width_opl);
    }
    double percent(double part) const { return steady > 0 ? 100 * part / steady : 0; }
    const char* unit() const { return header.time.unit == "ns" ? "ns" : "m"; }

    std::string text() const {
        const auto& t = header.time;
        const auto& r = header.response;
        std::string text = fmt::format(
            "\n{} x {} pixels of {} samples; {} bins of {:.6g} {} from {:.6g} to {:.6g}, {}{}\n", header.film.width,
            header.film.height, header.film.samples_per_pixel, t.n_bins, header.in_unit(t.bin_width_opl), unit(),
            opening_of(0), opening_of(t.n_bins),
            t.gate_opl == t.bin_width_opl ? "" : fmt::format("each open for {:.6g}, ", header.in_unit(t.gate_opl)),
            t.camera_segment ? "counted from the camera" : "counted from the first hit");
        text += fmt::format("pulse: {}", r.pulse);
        for (const auto& [name, opl] :
             {std::pair{"length", r.length_opl}, std::pair{"tail", r.tail_opl}, std::pair{"period", r.period_opl}})
            if (opl != 0) text += fmt::format(", {} {:.6g} {}", name, header.in_unit(opl), unit());
        text += fmt::format(
            "\nlight: {:.5g} W m^-2 sr^-1 (mean luminance), of it {:.4g} % in the bins, {:.3g} % before, {:.3g} % "
            "after, {:.3g} % never\n",
            steady, percent(inside), percent(before), percent(after), percent(never));
        text += fmt::format(
            "brightest bin: {:.4g} at pixel {}:{}, bin {} ({:.6g} {}); half of the light by {:.6g} {}; "
            "standard error of the sum {:.2g} %\n",
            brightest, brightest_x, brightest_y, brightest_bin, opening_of(brightest_bin), unit(), half_by, unit(),
            100 * relative_error);
        for (std::size_t p = 0; p < parameters.size(); ++p) {
            const OfParameter& d = parameters[p];
            const auto& q = header.parameters;
            text += fmt::format(
                "derivative by {} at {:.6g} {}: {:.4g} +- {:.2g} (mean luminance), of it {:.4g} in the bins; sum of "
                "magnitudes over the bins {:.4g}; moving between bins: {}\n",
                q.name[p], q.value[p], q.unit[p], d.steady, d.error, d.inside, d.magnitude,
                q.temporal[p] == "none" ? "complete" : q.temporal[p]);
        }
        return text;
    }
    void write(JsonWriter& json) const {
        json.begin_object("transient_cube");
        json.number("start", opening_of(0));
        json.number("end", opening_of(header.time.n_bins));
        json.text("unit", unit());
        json.number("mean_luminance", steady);
        json.number("share_inside", percent(inside) / 100);
        json.number("share_before", percent(before) / 100);
        json.number("share_after", percent(after) / 100);
        json.number("share_never", percent(never) / 100);
        json.number("brightest", brightest);
        json.integer("brightest_x", brightest_x);
        json.integer("brightest_y", brightest_y);
        json.integer("brightest_bin", brightest_bin);
        json.number("half_by", half_by);
        json.number("relative_error", relative_error);
        if (!parameters.empty()) json.begin_array("derivatives");
        for (std::size_t p = 0; p < parameters.size(); ++p) {
            const OfParameter& d = parameters[p];
            json.begin_object();
            json.text("parameter", header.parameters.name[p]);
            json.text("unit", header.parameters.unit[p]);
            json.number("value", header.parameters.value[p]);
            json.text("temporal", header.parameters.temporal[p]);
            json.number("steady", d.steady);
            json.number("steady_error", d.error);
            json.number("inside", d.inside);
            json.number("magnitude", d.magnitude);
            json.end_object();
        }
        if (!parameters.empty()) json.end_array();
        json.end_object();
    }
};

bool is_gradient(const Survey& survey) {
    return survey.attribute("filetype") == Gradient::format.name;
}

/// The largest derivatives of a loss.
std::string gradient_text(const Gradient& g) {
    constexpr std::size_t shown = 12;
    std::vector<std::size_t> order(g.parameters.name.size());
    std::iota(order.begin(), order.end(), std::size_t(0));
    const auto& by = g.parameters.gradient;
    std::stable_sort(order.begin(), order.end(),
                     [&](std::size_t a, std::size_t b) { return std::abs(by[a]) > std::abs(by[b]); });
    std::string text = fmt::format("loss {:.9g}; {} parameters, {} vertices, {} texels\n", g.loss, order.size(),
                                   g.vertices.gradient.size() / 3, g.texels.gradient.size() / 3);
    for (std::size_t i = 0; i < std::min(order.size(), shown); ++i)
        text += fmt::format("d loss / d {} = {:.6g} per {}, at {:.6g}\n", g.parameters.name[order[i]], by[order[i]],
                            g.parameters.unit[order[i]], g.parameters.value[order[i]]);
    if (order.size() > shown) text += fmt::format("and {} smaller ones\n", order.size() - shown);
    const auto size = [](const Column<double>& numbers, std::uint64_t begin, std::uint64_t end) {
        double sum = 0;
        for (std::uint64_t i = 3 * begin; i < 3 * end; ++i) sum += numbers[i] * numbers[i];
        return std::sqrt(sum);
    };
    for (std::size_t m = 0; m < g.vertices.name.size(); ++m)
        text += fmt::format("{}: length {:.6g} per m\n", g.vertices.name[m],
                            size(g.vertices.gradient, g.vertices.first[m], g.vertices.first[m + 1]));
    for (std::size_t m = 0; m < g.texels.name.size(); ++m)
        text += fmt::format("{}: {} x {}, length {:.6g}\n", g.texels.name[m], g.texels.width[m], g.texels.height[m],
                            size(g.texels.gradient, g.texels.first[m], g.texels.first[m + 1]));
    return text;
}

bool is_fit(const Survey& survey) {
    return survey.attribute("filetype") == Fit::format.name;
}

/// The values of a fit with their error bars, and its evaluations.
std::string fit_text(const Fit& f) {
    const std::size_t n = f.n_parameters();
    const auto& p = f.parameters;
    std::string text = fmt::format("{} by {}: {} after {} evaluations, {} starts from elsewhere\n", f.settings.loss,
                                   f.settings.method, f.state.status, f.n_evaluations(), f.state.restarts);
    for (std::size_t i = 0; i < n; ++i)
        text += fmt::format("{} = {:.8g} +- {:.3g} {}, from {:.8g}\n", p.name[i], p.value[i], f.sigma(i), p.unit[i],
                            p.start[i]);
    const auto& h = f.history;
    text +=
        fmt::format("{:>10} {:>6} {:>12} {:>9}  {}\n", "evaluation", "merged", "loss", "+-", fmt::join(p.name, " "));
    for (std::size_t i = 0; i < f.n_evaluations(); ++i)
        text += fmt::format("{:>10} {:>6} {:>12.5g} {:>9.2g}  {:.6g}{}\n", i + 1, h.merged_bins[i], h.loss[i],
                            h.loss_sigma[i], fmt::join(h.value.row(i, n), " "), h.accepted[i] ? "" : " (taken back)");
    return text;
}

bool is_radiance_cache(const Survey& survey) {
    return survey.attribute("filetype") == RadianceCache::format.name;
}

/// What a cache was made of, and its error by material.
std::string cache_text(const RadianceCache& c) {
    std::string text =
        fmt::format("{} of {} {} of {} graphs; {} labels not finite\n", c.settings.method, c.settings.samples,
                    c.is_grid() ? "training samples" : "vertices", c.graphs.size(), c.settings.nonfinite);
    const auto& v = c.validation;
    for (std::size_t m = 0; m < v.material.size(); ++m)
        if (v.vertices[m] > 0)
            text += fmt::format("{}: relative L2 {:.4g}, mean ratio {:.4g} ({} vertices held back)\n", v.material[m],
                                v.relative_l2[m], v.mean_ratio[m], v.vertices[m]);
    return text;
}

bool has_cost(const std::string& file) {
    return std::filesystem::exists(cost_path(file));
}

bool has_ledger(const Survey& survey) {
    return survey.attribute("filetype") == Image::format.name && !survey.attribute("ledger").empty();
}

/// Returns the CPU time of a file and all its ancestors; nothing where it is unknown.
std::optional<double> whole_cpu_s(const std::filesystem::path& file) {
    try {
        double sum = 0;
        for (const ChainFile& made : read_chain(file)) sum += made.cost.cpu_s;
        return sum;
    } catch (const InputError&) {
        return {};
    }
}

/// Links of an image with added edits, and the cost of each where it is still known.
struct LedgerFacts {
    Ledger ledger;
    std::vector<std::optional<double>> cpu_s;  // [link]; for the first link, with all ancestors

    explicit LedgerFacts(const Survey& survey, const std::string& file)
        : ledger(ledger_from_text(survey.attribute("ledger"), file)), cpu_s(ledger.size()) {
        // The first parent of a link's image is the image of the previous link; other parents are existing residuals.
        std::filesystem::path picture = file;
        for (std::size_t i = ledger.size(); i-- > 1 && has_cost(picture);) {
            const Cost cost = read_cost(picture);
            if (cost.parents.empty()) return;
            const auto parent = [&](std::size_t k) {
                return (picture.parent_path() / cost.parents[k]).lexically_normal();
            };
            cpu_s[i] = cost.cpu_s;
            for (std::size_t k = 1; k < cost.parents.size() && cpu_s[i]; ++k) {
                const auto made = whole_cpu_s(parent(k));
                cpu_s[i] = made ? std::optional(*cpu_s[i] + *made) : std::nullopt;
            }
            picture = parent(0);
            if (i == 1) cpu_s[0] = whole_cpu_s(picture);
        }
        if (ledger.size() == 1) cpu_s[0] = whole_cpu_s(file);
    }
    std::string text() const {
        std::string text =
            fmt::format("\n  {:>4}  {:<12} {:>9}  {:>11}  {:>11}  {:>7}  {:>9}  {:>9}  {}\n", "link", "method",
                        "per pixel", "var_mean", "sum", "share", "fresh spp", "CPU", "shows; edit");
        const double all = accumulated_var_mean(ledger, ledger.size());
        for (std::size_t i = 0; i < ledger.size(); ++i) {
            const LedgerLink& link = ledger[i];
            const double worth = worth_samples(ledger, i + 1);
            text +=
                fmt::format("  {:>4}  {:<12} {:>9}  {:>11.4g}  {:>11.4g}  {:>5.1f} %  {:>9}  {:>9}  {}; {}\n", i,
                            link.method, link.samples, link.var_mean, accumulated_var_mean(ledger, i + 1),
                            all > 0 ? 100 * link.var_mean / all : 0.0, worth == 0 ? "?" : fmt::format("{:.4g}", worth),
                            cpu_s[i] ? app::duration_text(*cpu_s[i]) : "?",
                            link.scene.hash.empty() ? "?" : link.scene.name, link.what);
        }
        return text;
    }
    void write(JsonWriter& json) const {
        json.begin_array("ledger");
        for (std::size_t i = 0; i < ledger.size(); ++i) {
            const LedgerLink& link = ledger[i];
            json.begin_object();
            json.text("scene", link.scene.name);
            json.text("hash", link.scene.hash);
            json.text("what", link.what);
            json.text("method", link.method);
            json.integer("samples", link.samples);
            json.integer("seed", link.seed);
            json.number("var_mean", link.var_mean);
            json.number("sum", accumulated_var_mean(ledger, i + 1));
            json.number("fresh_spp", worth_samples(ledger, i + 1));
            if (cpu_s[i]) json.number("cpu_s", *cpu_s[i]);
            json.end_object();
        }
        json.end_array();
    }
};

std::string extents_text(const std::vector<std::size_t>& extents) {
    return extents.empty() ? "scalar" : fmt::format("{}", fmt::join(extents, " x "));
}

std::string shortened(std::string text, std::size_t n) {
    if (text.size() > n) text = text.substr(0, n - 3) + "...";
    return text;
}

std::string dataset_line(const DatasetSummary& d, std::size_t name_width) {
    std::string line =
        fmt::format("  {:<{}}  {:<9} {:>14}  {:<14}", d.name, name_width, d.type, extents_text(d.extents), d.units);
    if (!d.values.empty()) return line + " " + shortened(fmt::format("{}", fmt::join(d.values, ", ")), 60) + "\n";
    if (!d.is_number) return line + "\n";
    const Statistics& s = d.statistics;
    line += fmt::format(" {:>11.5g} {:>11.5g} {:>11.5g}", s.min, s.mean, s.max);
    if (s.n_nan + s.n_inf > 0) line += fmt::format("  {} NaN, {} inf", s.n_nan, s.n_inf);
    return line + "\n";
}

std::string graph_text(const GraphFacts& facts) {
    std::string text =
        fmt::format("\n{} paths, {} vertices ({:.3g} per path), {} light edges ({:.3g} per vertex)\n", facts.n_paths,
                    facts.n_vertices, facts.vertices_per_path(), facts.n_edges, facts.per_vertex(facts.n_edges));
    text += "endings:";
    for (std::size_t k = 1; k < facts.endings.size(); ++k) {
        text += fmt::format("{} {} {}", k == 1 ? "" : ",", facts.endings[k], ending_name(static_cast<Ending>(k)));
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
    std::string text = fmt::format("{}: {}, {}\n", file,
                                   !filetype.empty() ? fmt::format("{} {}", filetype, survey.attribute("version"))
                                   : survey.kind == Survey::Kind::exr ? "EXR of another program"
                                                                      : "HDF5 of another program",
                                   app::bytes_text(survey.file_bytes));
    for (const auto& [name, value] : survey.attributes) {
        if (name == "filetype" || name == "version" || value.empty() || (name == "ledger" && has_ledger(survey)))
            continue;
        for (std::size_t at = 0; at < value.size();) {  // one line per input
            const std::size_t end = std::min(value.find('\n', at), value.size());
            text += fmt::format("  {:<18} {}\n", at == 0 ? name : "", value.substr(at, end - at));
            at = end + 1;
        }
    }
    if (has_cost(file)) {
        const Cost cost = read_cost(file);
        text += fmt::format("  {:<18} {}, {} of CPU, {} rays, {} samples, peak memory {}\n", "cost",
                            app::duration_text(cost.wall_s), app::duration_text(cost.cpu_s), cost.rays, cost.samples,
                            app::bytes_text(cost.peak_memory_bytes));
    }
    if (is_path_graph(survey)) text += graph_text(GraphFacts(read_path_graph(file)));
    if (is_clusters(survey)) text += ClusterFacts(file, graph).text();
    if (is_transient_cube(file)) text += CubeFacts(file).text();
    if (is_radiance_cache(survey)) text += cache_text(read_radiance_cache(file));
    if (is_gradient(survey)) text += gradient_text(read_gradient(file));
    if (is_fit(survey)) text += fit_text(read_fit(file));
    if (has_ledger(survey)) text += LedgerFacts(survey, file).text();
    std::size_t name_width = 7;
    for (const auto& d : survey.datasets) name_width = std::max(name_width, d.name.size());
    text += fmt::format("\n  {:<{}}  {:<9} {:>14}  {:<14} {:>11} {:>11} {:>11}\n", "dataset", name_width, "type",
                        "extent", "units", "min", "mean", "max");
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
    if (is_transient_cube(file)) CubeFacts(file).write(json);
    if (has_ledger(survey)) LedgerFacts(survey, file).write(json);
    json.begin_array("datasets");
    for (const auto& d : survey.datasets) dataset_json(d, json);
    json.end_array();
    json.end_object();
    return json.str();
}

}  // namespace loom::inspect
