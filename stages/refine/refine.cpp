#include "stages/refine/refine.h"

#include <fmt/format.h>

#include <cmath>
#include <filesystem>

#include "formats/io/cost.h"
#include "formats/io/error.h"
#include "stages/core/app/command.h"
#include "stages/core/clusters/cluster_quality.h"
#include "stages/core/clusters/sharing.h"
#include "stages/core/compute/parallel.h"
#include "stages/refine/west.h"

namespace loom::refine {
namespace {

/// Share of the energy above which the clamp's loss is a warning.
constexpr double clamped_share_to_warn = 0.01;

/// Largest depth limit that is kept exactly, with as many steps from zero radiance as it allows bounces.
constexpr int longest_exact_depth = 16;

struct Schedule {
    Start start;
    int iterations;
    bool counts_bounces;
    std::string why;
};

/// Chooses the steps. A depth limit ends light at a number of bounces from the camera, but a shared vertex has no
/// depth. Steps from zero radiance count bounces too: light of a first hit's continuation has one bounce less than the
/// first hit.
Schedule schedule(const PathGraph& graph, const Options& options) {
    const int depth = graph.tracing.max_depth;
    if (options.start == Start::automatic && depth >= 0 && depth <= longest_exact_depth)
        return {Start::zero, std::max(depth - 2, 0), true,
                fmt::format("from zero, {} steps: paths have at most {} edges", std::max(depth - 2, 0), depth)};
    if (options.start == Start::zero)
        return {Start::zero, options.iterations, false, fmt::format("from zero, {} steps", options.iterations)};
    return {Start::paths, options.iterations, false,
            fmt::format("from the radiance of the paths, {} steps", options.iterations)};
}

/// Interleaves value(j), the reflected Light of vertex j.
template <class Value>
std::vector<float> interleaved(std::size_t n, int threads, Value value) {
    std::vector<float> rgb(3 * n);
    parallel_chunks(n, 1 << 16, threads, [&](std::uint64_t, std::uint64_t begin, std::uint64_t end) {
        for (std::uint64_t j = begin; j < end; ++j) {
            const Light x = value(j);
            rgb[3 * j] = x.r, rgb[3 * j + 1] = x.g, rgb[3 * j + 2] = x.b;
        }
    });
    return rgb;
}

/// Returns value(j) of each path's first vertex, [path]; zero for a path without vertices.
template <class Value>
std::vector<float> of_first_vertices(const PathGraph& graph, int threads, Value value) {
    return interleaved(graph.n_paths(), threads, [&](std::size_t i) {
        const std::uint64_t j = graph.paths.first_vertex[i];
        return j < graph.paths.first_vertex[i + 1] ? value(j) : Light{};
    });
}

const char* name(Clamp clamp) {
    return clamp == Clamp::none ? "none" : clamp == Clamp::column ? "column" : "cluster";
}

}  // namespace

void declare(app::Command& command, Options& options) {
    command.file("graph", options.graph, "path graph (.h5)").required();
    command.file("clusters", options.clusters, "clusters of that graph (.h5); not for --method west");
    command.output("-o,--output", options.output, "radiance of all vertices (.h5)");
    command.choice("--method", options.method,
                   "fixed-point: sharing and propagation, iterated; west: the single filter of West et al.",
                   {{"fixed-point", Method::fixed_point}, {"west", Method::west}});
    command.option("--iterations", options.iterations, "number of Jacobi steps", app::Range<int>{0, 10000});
    command.choice("--reuse", options.reuse, "what neighbours reuse of a continuation: its direction or its end point",
                   {{"directions", Reuse::directions}, {"points", Reuse::points}});
    command.choice("--clamp", options.clamp,
                   "clamp that keeps the iteration from diverging: per edge, once; per cluster and iteration; or none",
                   {{"column", Clamp::column}, {"cluster", Clamp::cluster}, {"none", Clamp::none}});
    command.option("--epsilon", options.epsilon, "margin of the clamp: gains are limited to 1 - epsilon",
                   app::Range<float>{0, 0.5f});
    command.choice("--start", options.start, "first iterate: the paths' own radiance, or zero",
                   {{"auto", Start::automatic}, {"paths", Start::paths}, {"zero", Start::zero}});
    command.flag("--as-printed", options.as_printed,
                 "use the paper's equations as printed: densities over successful samples only (biased)");
    command.option("--neighbours", options.neighbours, "number of nearest neighbours of --method west",
                   app::Range<std::uint32_t>{1, max_lanes});
    command.option("--private-roughness", options.private_roughness,
                   "smallest microfacet alpha of a vertex that shares samples with --method west",
                   app::Range<float>{0, 1});
    command.threads(options.threads);
    command.flag("--plan", options.plan, "print the plan and stop");
    command.example("loom-refine graph.h5 clusters.h5 -o radiance.h5");
}

Radiance refine_radiance(const PathGraph& graph, const Clusters& clusters, const Options& options,
                         app::Report& report) {
    const Schedule plan = schedule(graph, options);
    System system = build_system(
        graph, clusters, {{options.reuse, options.as_printed}, options.clamp, options.epsilon, options.threads});
    if (system.largest_column_sum > 1)
        report.info("largest gain of an edge: {:.3f}; {} of {} edges clamped, {:.4f} % of the energy",
                    system.largest_column_sum, system.n_clamped, system.n_columns, 100 * system.clamped_share);

    std::vector<std::uint32_t> first_hits;
    first_hits.reserve(graph.n_paths());
    for (std::size_t i = 0; i < graph.n_paths(); ++i)
        if (graph.paths.first_vertex[i] < graph.paths.first_vertex[i + 1])
            first_hits.push_back(system.unknown[graph.paths.first_vertex[i]]);

    std::vector<double> residual, image_change;
    Radiance result;
    HugeArray<Light> indirect = path_radiance(system, graph, options.threads);
    result.indirect_path = interleaved(indirect.size(), options.threads, [&](std::size_t i) { return indirect[i]; });
    if (plan.start == Start::zero)
        for (std::size_t k = 0; k < system.n_unknowns; ++k) system.at[k].X = system.at[k].B;
    indirect = {};
    const auto log = solve(
        system, first_hits, {plan.iterations, options.clamp, options.epsilon, options.threads, plan.counts_bounces},
        radiance_of(system), [&](const Iteration& i) {
            residual.push_back(i.residual);
            image_change.push_back(std::isfinite(i.image_change)
                                       ? i.image_change
                                       : 1);  // infinite when the image turns black: its whole content changes
            result.clamped_share = i.clamped_share;
            report.info(
                "step {}: residual {:.3g}, image changes by {:.3g}{}", residual.size(), i.residual, i.image_change,
                i.clamped_share > 0 ? fmt::format(", {:.4f} % of the energy clamped", 100 * i.clamped_share) : "");
        });
    if (int(log.size()) < plan.iterations)
        report.warn("the iteration diverges at step {} of {}: use --clamp column", log.size() + 1, plan.iterations);
    if (options.clamp == Clamp::column) result.clamped_share = system.clamped_share;

    if (result.clamped_share >= clamped_share_to_warn)
        report.warn(
            "the clamp removed {:.1f} % of the energy, and the image is darker by up to that; --clamp none shows by "
            "how much",
            100 * result.clamped_share);

    result.graph_vertices = system.n_unknowns;
    result.L =
        interleaved(system.n_unknowns, options.threads, [&](std::size_t j) { return system.at[system.unknown[j]].X; });
    result.direct =
        of_first_vertices(graph, options.threads, [&](std::size_t j) { return system.at[system.unknown[j]].B; });
    result.residual = std::move(residual);
    result.image_change = std::move(image_change);
    result.settings = {"fixed-point",       options.reuse == Reuse::points ? "points" : "directions",
                       name(options.clamp), plan.start == Start::paths ? "paths" : "zero",
                       plan.iterations,     options.epsilon,
                       options.as_printed};
    return result;
}

Radiance west_radiance(const PathGraph& graph, const Options& options) {
    const SharingRule shares(graph, options.private_roughness);
    std::vector<std::uint32_t> members;
    for (std::size_t j = 0; j < graph.n_vertices(); ++j)
        if (shares(j)) members.push_back(std::uint32_t(j));
    const Filtered filtered =
        west_filter(graph, members, options.neighbours, {options.reuse, options.as_printed}, options.threads);
    Radiance result;
    result.graph_vertices = graph.n_vertices();
    result.L = interleaved(graph.n_vertices(), options.threads, [&](std::size_t j) { return filtered.L[j]; });
    result.direct = of_first_vertices(graph, options.threads, [&](std::size_t j) { return filtered.direct[j]; });
    result.settings.method = "west";
    result.settings.reuse = options.reuse == Reuse::points ? "points" : "directions";
    result.settings.clamp = "none";
    result.settings.as_printed = options.as_printed;
    return result;
}

void run(const Options& options, app::Report& report) {
    if (!options.plan) {
        if (options.output.empty()) throw InputError("--output: missing (a .h5 file)");
        check_output_path(options.output);
    }
    const PathGraph graph = read_path_graph(options.graph);
    // Their directions are not those of BSDF sampling, whose densities weight the neighbours.
    if (!graph.nlos.capture.empty())
        throw InputError(fmt::format(
            "{}: vertices of an NLOS capture cannot share samples; bin its paths with loom-transient", options.graph));
    const bool west = options.method == Method::west;
    const std::string plan =
        fmt::format("on: {}{}; off: {}",
                    west ? fmt::format("one aggregation over {} nearest neighbours", options.neighbours)
                         : fmt::format("{}; clamp {}", schedule(graph, options).why, name(options.clamp)),
                    options.as_printed ? ", equations as printed" : "",
                    west                         ? "propagation (--method west)"
                    : graph.vertices.eta.empty() ? "private dielectric lobes (no dielectric)"
                                                 : "nothing");
    if (options.plan) {
        report.answer(plan + "\n");
        return;
    }
    report.info("plan: {}", plan);
    const InputId graph_id = identify(options.graph);
    std::vector<InputId> inputs{graph_id};
    Radiance radiance;
    if (west) {
        if (!options.clusters.empty())
            throw InputError(options.clusters + ": --method west finds its own neighbours; leave out the clusters");
        radiance = west_radiance(graph, options);
    } else {
        if (options.clusters.empty()) throw InputError("clusters: missing (made by loom-cluster)");
        const Clusters clusters = read_clusters(options.clusters);
        require_clusters_of(graph, graph_id, clusters, options.clusters);
        if (clusters.settings.max_size > max_lanes)
            throw InputError(fmt::format("{}: clusters of up to {} vertices; at most {} can be refined",
                                         options.clusters, clusters.settings.max_size, max_lanes));
        report.info("clusters: separated, of {} vertices: {}", clusters.n_members(), text_of(clusters.separation));
        radiance = refine_radiance(graph, clusters, options, report);
        inputs.push_back(identify(options.clusters));
        radiance.clusters = inputs[1].hash;
    }
    radiance.graph = graph_id.hash;
    radiance.provenance = report.provenance(graph.provenance.seed, std::move(inputs), plan);
    write_radiance(radiance, options.output);

    Cost cost = report.cost(plan);
    cost.samples = graph.n_paths();
    write_cost_of(options.output, cost, {options.graph, options.clusters});
    report.done("{} vertices, {} iterations", graph.n_vertices(), radiance.residual.size());
}

}  // namespace loom::refine
