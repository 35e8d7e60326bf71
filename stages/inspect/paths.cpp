#include <fmt/format.h>

#include <algorithm>
#include <array>

#include "formats/io/error.h"
#include "formats/io/octahedral.h"
#include "stages/core/app/values.h"
#include "stages/inspect/inspect.h"

namespace loom::inspect {
namespace {

constexpr std::array<std::string_view, 7> lobe_names{
    "none", "diffuse", "glossy reflection", "glossy transmission", "delta reflection", "delta transmission", "null"};

std::string triple(std::span<const float> v) {
    return fmt::format("({:.6g}, {:.6g}, {:.6g})", v[0], v[1], v[2]);
}

std::string normal(std::span<const std::int16_t> uv) {
    return triple(unit_from_octahedral(uv[0], uv[1]));
}

std::string halves(std::span<const Half> values) {
    std::string text;
    for (Half value : values) text += fmt::format("{}{:.4g}", text.empty() ? "" : ", ", float_from_half(value));
    return "(" + text + ")";
}

[[noreturn]] void refuse_path(const std::string& which, const std::string& why) {
    throw InputError(fmt::format("--path {}: {}", which, why));
}

std::uint64_t number(const std::string& text, const std::string& which) {
    const auto value = app::parse_number<std::uint64_t>(text);
    if (!value) refuse_path(which, "expected PIXEL,SAMPLE, for example 320:180,0 or 115520,0");
    return *value;
}

/// Returns the row of `paths` for "PIXEL,SAMPLE".
std::size_t path_index(const PathGraph& g, const std::string& which) {
    const auto comma = which.find(',');
    if (comma == std::string::npos) refuse_path(which, "expected PIXEL,SAMPLE, for example 320:180,0 or 115520,0");
    const std::string pixel_text = which.substr(0, comma);
    const auto colon = pixel_text.find(':');
    std::uint64_t pixel = 0;
    if (colon == std::string::npos) {
        pixel = number(pixel_text, which);
    } else {
        const std::uint64_t x = number(pixel_text.substr(0, colon), which),
                            y = number(pixel_text.substr(colon + 1), which);
        if (x >= g.sensor.width || y >= g.sensor.height) {
            refuse_path(which, fmt::format("the image has {} x {} pixels", g.sensor.width, g.sensor.height));
        }
        pixel = y * g.sensor.width + x;
    }
    if (pixel >= g.n_pixels()) refuse_path(which, fmt::format("the image has {} pixels", g.n_pixels()));
    const std::uint64_t sample = number(which.substr(comma + 1), which), first = g.tracing.first_sample;
    if (sample < first || sample - first >= g.tracing.samples_per_pixel) {
        refuse_path(which,
                    fmt::format("the file has samples {} to {}", first, first + g.tracing.samples_per_pixel - 1));
    }
    return (sample - first) * g.n_pixels() + pixel;
}

std::string vertex_text(const PathGraph& g, std::uint64_t j) {
    const auto& x = g.vertices;
    const std::uint16_t flags = x.flags[j];
    std::string text = fmt::format("  vertex {}\n    p       {} m\n    wo      {}\n    ns      {}\n", j,
                                   triple(x.p.row(j, 3)), triple(x.wo.row(j, 3)), normal(x.ns.row(j, 2)));
    if (!x.ng.empty()) text += fmt::format("    ng      {}\n", normal(x.ng.row(j, 2)));
    text += fmt::format("    on      {} of shape {}\n", g.materials.id[x.material[j]], g.shapes.id[x.shape[j]]);
    const auto parameter = [&](std::string_view name, const Column<Half>& column, std::size_t width) {
        if (!column.empty()) text += fmt::format("    {:<7} {}\n", name, halves(column.row(j, width)));
    };
    parameter("diffuse", x.diffuse, 3);
    parameter("specular", x.specular, 3);
    parameter("transmittance", x.transmittance, 3);
    parameter("alpha", x.alpha, 2);
    parameter("opacity", x.opacity, 1);
    if (!x.eta.empty()) text += fmt::format("    eta     {} on the way here\n", x.eta[j]);
    text += fmt::format("    sampled {} with density {:.6g}{}{}{}\n",
                        x.lobe[j] < lobe_names.size() ? lobe_names[x.lobe[j]] : "unknown lobe", x.pdf_w[j],
                        x.q.empty() ? "" : fmt::format(", roulette survived with {:.4g}", x.q[j]),
                        (flags & vertex_flag::attempted_nee) != 0 ? ", next-event estimation attempted" : "",
                        (flags & vertex_flag::attempted_bsdf) != 0 ? ", BSDF sample attempted" : "");
    return text;
}

std::string edge_text(const PathGraph& g, std::size_t k) {
    const auto& e = g.light_edges;
    const auto y = e.y.row(k, 4);
    return fmt::format("    light   {} {} at {}{}: Li {}, pdf_nee_w {:.6g}, pdf_bsdf_w {:.6g}\n",
                       e.technique[k] == 0 ? "next event on" : "BSDF hit of", g.emitters.id[e.emitter[k]],
                       triple(y.first(3)), y[3] == 0 ? " (direction)" : " m", triple(e.Li.row(k, 3)), e.pdf_nee_w[k],
                       e.pdf_bsdf_w[k]);
}

/// Returns the first light edge of a vertex or of a later one.
std::size_t first_edge(const PathGraph& g, std::uint64_t vertex) {
    const auto rows = g.light_edges.vertex.values();
    return static_cast<std::size_t>(std::lower_bound(rows.begin(), rows.end(), vertex) - rows.begin());
}

std::string vertex_line(std::span<const float> p) {
    return fmt::format("v {} {} {}\n", p[0], p[1], p[2]);
}

}  // namespace

std::string path_text(const PathGraph& graph, const std::string& which) {
    const std::size_t i = path_index(graph, which);
    const auto first = graph.paths.first_vertex[i], end = graph.paths.first_vertex[i + 1];
    const std::size_t pixel = i % graph.n_pixels();
    std::string text =
        fmt::format("path {}: pixel {}:{} (index {}), sample {}, {} vertices, directly visible Le {}\n", i,
                    pixel % graph.sensor.width, pixel / graph.sensor.width, pixel,
                    graph.tracing.first_sample + i / graph.n_pixels(), end - first, triple(graph.paths.Le.row(i, 3)));
    for (std::uint64_t j = first; j < end; ++j) {
        text += vertex_text(graph, j);
        for (std::size_t k = first_edge(graph, j); k < graph.n_light_edges() && graph.light_edges.vertex[k] == j; ++k) {
            text += edge_text(graph, k);
        }
    }
    if (end == first) return text + "  no vertex: the camera ray hit no surface with a BSDF\n";
    return text + fmt::format("  ending: {}\n", ending_name(ending_of(graph.vertices.flags[end - 1])));
}

std::string obj_text(const PathGraph& graph, std::uint64_t max_paths) {
    const std::size_t n_paths = graph.n_paths();
    const std::size_t n_shown = std::min<std::size_t>(max_paths, n_paths);
    std::string paths, lights;
    std::size_t n_points = 0;
    for (std::size_t shown = 0; shown < n_shown; ++shown) {
        const std::size_t i = shown * n_paths / n_shown;
        const auto first = graph.paths.first_vertex[i], end = graph.paths.first_vertex[i + 1];
        if (first == end) continue;
        const auto& pinhole = graph.sensor.origin;
        const std::array<float, 3> eye{static_cast<float>(pinhole[0]), static_cast<float>(pinhole[1]),
                                       static_cast<float>(pinhole[2])};
        paths += vertex_line(graph.paths.origin.empty() ? std::span<const float>(eye) : graph.paths.origin.row(i, 3));
        for (std::uint64_t j = first; j < end; ++j) paths += vertex_line(graph.vertices.p.row(j, 3));
        paths += "l";
        for (std::uint64_t j = first; j <= end; ++j) paths += fmt::format(" {}", ++n_points);
        paths += '\n';
        for (std::size_t k = first_edge(graph, first); k < graph.n_light_edges() && graph.light_edges.vertex[k] < end;
             ++k) {
            const auto y = graph.light_edges.y.row(k, 4);
            if (y[3] == 0) continue;
            // Negative indices count from the last point, so the number of the paths' points is not needed.
            lights += vertex_line(graph.vertices.p.row(graph.light_edges.vertex[k], 3)) + vertex_line(y.first(3)) +
                      "l -2 -1\n";
        }
    }
    return fmt::format("# {} of {} paths\no paths\n{}o light_edges\n{}", n_shown, n_paths, paths, lights);
}

}  // namespace loom::inspect
