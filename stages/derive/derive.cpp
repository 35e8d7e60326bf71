#include "stages/derive/derive.h"

#include <fmt/format.h>
#include <tbb/enumerable_thread_specific.h>

#include <algorithm>

#include "formats/io/cost.h"
#include "formats/io/error.h"
#include "stages/core/app/command.h"
#include "stages/core/compute/parallel.h"
#include "stages/core/graph/graph_reader.h"
#include "stages/core/graph/own_samples.h"
#include "stages/core/scene/build.h"
#include "stages/derive/boundary.h"
#include "stages/derive/interior.h"

namespace loom::derive {
namespace {

/// Interior rows of consecutive paths.
struct Rows {
    std::vector<std::uint32_t> edge, path;
    std::vector<float> dL, dopl, dLe, dopl_seen;
    std::uint64_t n_touched = 0;

    void add_edge(const InteriorRow& row) {
        edge.push_back(row.row);
        dL.insert(dL.end(), row.dL.begin(), row.dL.end());
        dopl.insert(dopl.end(), row.dopl.begin(), row.dopl.end());
    }
    void add_seen(const InteriorRow& row) {
        path.push_back(row.row);
        dLe.insert(dLe.end(), row.dL.begin(), row.dL.end());
        dopl_seen.insert(dopl_seen.end(), row.dopl.begin(), row.dopl.end());
    }
};

/// Joins one array of every chunk, in their order.
template <class T>
Column<T> joined(std::vector<Rows>& chunks, std::vector<T> Rows::*member) {
    std::size_t size = 0;
    for (const Rows& rows : chunks) size += (rows.*member).size();
    std::vector<T> all;
    all.reserve(size);
    for (Rows& rows : chunks) {
        all.insert(all.end(), (rows.*member).begin(), (rows.*member).end());
        std::vector<T>().swap(rows.*member);
    }
    return all;
}

void differentiate_interior(const PathGraph& graph, const Scene& scene, const SceneTangents& tangents, int threads,
                            app::Report& report, Derivative& out, std::uint64_t& n_touched) {
    constexpr std::uint64_t chunk = 4096;
    std::vector<Rows> chunks((graph.n_paths() + chunk - 1) / chunk);
    app::Progress progress(report, "interior", graph.n_paths());
    tbb::enumerable_thread_specific<InteriorWalker> walkers([&] { return InteriorWalker(graph, scene, tangents); });
    parallel_chunks(graph.n_paths(), chunk, threads, [&](std::uint64_t i, std::uint64_t begin, std::uint64_t end) {
        const InteriorWalker& walker = walkers.local();
        Rows& rows = chunks[i];
        std::size_t edge = first_light_edge(graph, graph.paths.first_vertex[begin]);
        for (std::size_t path = begin; path < end; ++path) {
            if (!walker.touches(path)) {
                while (edge < graph.n_light_edges() &&
                       graph.light_edges.vertex[edge] < graph.paths.first_vertex[path + 1])
                    ++edge;
                continue;
            }
            ++rows.n_touched;
            walker.walk(
                path, edge, [&](const InteriorRow& row) { rows.add_edge(row); },
                [&](const InteriorRow& row) { rows.add_seen(row); });
        }
        progress.add(end - begin);
    });
    for (const Rows& rows : chunks) n_touched += rows.n_touched;
    out.interior.edge = joined(chunks, &Rows::edge);
    out.interior.dL = joined(chunks, &Rows::dL);
    out.interior.dopl = joined(chunks, &Rows::dopl);
    out.seen.path = joined(chunks, &Rows::path);
    out.seen.dLe = joined(chunks, &Rows::dLe);
    out.seen.dopl = joined(chunks, &Rows::dopl_seen);
}

}  // namespace

Parts required_parts(const Scene& scene, const PathGraph& graph, const SceneTangents& tangents,
                     const std::vector<std::string>& off) {
    Parts parts;
    std::string on, out;
    const auto left_out = [&](const char* part) { return std::find(off.begin(), off.end(), part) != off.end(); };
    const auto add = [&](const char* part, const char* why_not) {
        const bool wanted = !*why_not && !left_out(part);
        (wanted ? on : out) += fmt::format("{}{}{}", (wanted ? on : out).empty() ? "" : ", ", part,
                                           wanted ? "" : fmt::format(" ({})", *why_not ? why_not : "--off"));
        return wanted;
    };
    const bool geometry = tangents.geometry();
    const bool surfaces = tangents.any_shape_moves() || tangents.camera_moves();
    const int depth = graph.tracing.max_depth;
    const char* still = geometry ? "" : "nothing moves";
    parts.interior = add("interior", "");
    parts.primary = add("primary", *still       ? still
                                   : scene.nlos ? "an NLOS capture"
                                   : surfaces   ? ""
                                                : "only lights move");
    parts.direct = add("direct", *still                    ? still
                                 : scene.nlos              ? "an NLOS capture without occlusion of the laser spot"
                                 : scene.emitters.empty()  ? "no emitter"
                                 : depth >= 0 && depth < 2 ? "no reflected light"
                                                           : "");
    parts.indirect = add("indirect", *still                    ? still
                                     : !surfaces               ? "only lights move"
                                     : scene.nlos              ? "an NLOS capture"
                                     : depth >= 0 && depth < 3 ? "light is reflected once"
                                                               : "");
    bool index = false;
    for (const auto& effects : tangents.materials)
        for (const auto& [p, t] : effects) index |= t.int_ior != 0;
    add("media", index ? "" : "no index of refraction changes");
    parts.plan = fmt::format("on: {}; off: {}", on.empty() ? "nothing" : on, out.empty() ? "nothing" : out);
    return parts;
}

Derivative differentiate(const PathGraph& graph, const Scene& scene, const SceneTangents& tangents, const Parts& parts,
                         const BoundaryOptions& boundary, app::Report& report, DeriveCounts& counts) {
    Derivative d;
    d.n_light_edges = graph.n_light_edges();
    d.n_paths = graph.n_paths();
    std::vector<double> values;
    for (const Parameter& parameter : tangents.parameters) {
        d.parameters.name.push_back(parameter.name);
        d.parameters.unit.push_back(parameter.unit);
        values.push_back(parameter.value);
    }
    d.parameters.value = std::move(values);
    d.boundary_samples = std::vector<std::uint64_t>(n_boundary_families, 0);
    if (parts.interior)
        differentiate_interior(graph, scene, tangents, boundary.threads, report, d, counts.touched_paths);
    differentiate_boundary(graph, scene, tangents, parts, boundary, report, d, counts);
    return d;
}

void declare(app::Command& command, Options& options) {
    command.file("scene", options.scene, "scene file of the graph (Mitsuba XML)");
    command.file("graph", options.graph, "path graph (.h5)");
    command.output("-o,--output", options.output, "derivatives (.h5), for loom-transient --derivative");
    command.option("--wrt", options.wrt,
                   "parameter: a $NAME of the scene file, or a part: shape:ID/pose, shape:ID/scale, shape:ID/normals, "
                   "shape:ID/vertices, shape:ID/radiance, shape:ID/bsdf/PARAMETER, bsdf:ID/PARAMETER, emitter:ID/pose, "
                   "emitter:ID/radiance, sensor/pose; may be repeated");
    command.option("-D,--define", options.defines, "NAME=VALUE of a scene parameter $NAME, as for the graph");
    command.option("--sensor", options.sensor,
                   "sensor of the graph, by id or by number from 0 in the order of the file (default: the first)");
    command.option("--off", options.off, "part to leave out: interior, primary, direct, indirect; may be repeated");
    command.option("--effort", options.effort, "boundary samples per path of the graph", app::Range<double>{1e-6, 1e6});
    command.option("--seed", options.seed, "seed of the boundary samples");
    command.threads(options.threads);
    command.flag("--plan", options.plan, "print the plan and stop");
    command.example("loom-derive scenes/edits.xml graph.h5 --wrt x -o d.h5");
}

void run(const Options& options, app::Report& report) {
    if (options.output.empty() && !options.plan) throw InputError("--output: missing (an .h5 file)");
    if (options.wrt.empty()) throw InputError("--wrt: missing; name a parameter of the scene");
    for (const std::string& part : options.off)
        if (part != "interior" && part != "primary" && part != "direct" && part != "indirect")
            throw InputError(fmt::format("--off {}: expected interior, primary, direct or indirect", part));
    if (!options.plan) check_output_path(options.output);
    const PathGraph graph = read_path_graph(options.graph);
    const InputId graph_id = identify_by_header(graph, options.graph);

    // Find what the parameters change.
    const double before_s = report.cost().cpu_s;
    const Defines defines = parse_defines(options.defines);
    const SceneDescription description = read_scene(options.scene, defines, options.sensor);
    const std::unique_ptr<Scene> scene = build_scene(description);
    require_scene_of(graph, options.graph, *scene, options.scene);
    const SceneTangents tangents =
        find_tangents(*scene, description, options.scene, defines, options.sensor, options.wrt);
    if (tangents.n() > max_parameters)
        throw InputError(fmt::format("--wrt: {} parameters, but one run differentiates by {} at most", tangents.n(),
                                     max_parameters));
    const double load_s = report.cost().cpu_s - before_s;
    if (const std::string missing = missing_columns(graph, *scene, tangents); !missing.empty())
        throw InputError(
            fmt::format("{}: lacks columns for these parameters; trace it with loom-trace {}", options.graph, missing));
    const Parts parts = required_parts(*scene, graph, tangents, options.off);
    if (options.plan) {
        report.answer(parts.plan + "\n");
        return;
    }
    report.info("plan: {}", parts.plan);

    DeriveCounts counts;
    Derivative derivative =
        differentiate(graph, *scene, tangents, parts, {options.effort, options.seed, options.threads}, report, counts);
    derivative.graph = graph_id.hash;
    derivative.provenance = report.provenance(
        options.seed, {{app::base_name(options.scene), graph.provenance.inputs[0].hash}, graph_id}, parts.plan);
    write_derivative(derivative, options.output);

    Cost cost = report.cost(parts.plan);
    cost.samples = graph.n_paths();
    cost.rays = counts.rays;
    cost.load_s = load_s;
    cost.sources = {options.scene};
    write_cost_of(options.output, cost, {options.graph});
    report.done("{} parameters; {} of {} paths touched, {} edges; {} boundary rows", tangents.n(), counts.touched_paths,
                graph.n_paths(), derivative.interior.edge.size(), derivative.boundary.pixel.size());
}

}  // namespace loom::derive
