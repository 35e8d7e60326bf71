#include <fmt/format.h>

#include <filesystem>

#include "formats/io/cost.h"
#include "formats/io/error.h"
#include "stages/cluster/cluster.h"
#include "stages/core/app/command.h"
#include "stages/core/transport/cluster_quality.h"

namespace loom::cluster {
namespace {

/// Enough for figures to a percent; all of them would cost a fifth of the clustering.
constexpr std::size_t clusters_to_measure = 4096;

PathGraph read_graph(const std::string& file) {
    PathGraph graph = read_path_graph(file);
    // Their directions are not those of BSDF sampling, by whose densities neighbours are weighted.
    if (!graph.nlos.capture.empty()) throw InputError(fmt::format("{}: vertices of a capture around a corner cannot be shared; loom-transient reads it", file));
    return graph;
}

}  // namespace

void declare(app::Command& command, Options& options) {
    ClusterOptions& c = options.cluster;
    command.file("graph", options.graph, "path graph (.h5)");
    command.output("-o,--output", options.output, "clusters (.h5)");
    command.file("--with", options.with, "another path graph, of nearly the same scene, that is put into the same cells; for differences of the two");
    command.output("--with-output", options.with_output, "its clusters (.h5)");
    command.choice("--method", c.method, "median splits, or nearest of random centres",
                   {{"balanced", Method::balanced}, {"centres", Method::centres}});
    command.option("--k", c.k, "balanced: largest cluster; centres: mean size", app::Range<std::uint32_t>{1, 65536});
    command.option("--max-size", c.max_size, "largest cluster; 0: 2 k", app::Range<std::uint32_t>{0, 131072});
    command.option("--normal-weight", c.normal_weight,
                   "distance of normals in cluster radii per unit; 0: positions alone", app::Range<float>{0, 1e6f});
    command.option("--private-roughness", c.private_roughness, "vertices with a smaller microfacet alpha share nothing",
                   app::Range<float>{0, 1});
    command.option("--seed", c.seed, "another seed moves the borders");
    command.threads(c.threads);
    command.flag("--plan", options.plan, "print what is on and what is off, and stop");
    command.example("loom-cluster graph.h5 -o clusters.h5 --k 16");
    command.example("loom-cluster old.h5 --with new.h5 -o old.clusters.h5 --with-output new.clusters.h5");
}

void run(const Options& options, app::Report& report) {
    if (options.graph.empty()) throw InputError("no graph is named; loom-cluster GRAPH -o CLUSTERS, or --help");
    if (!options.plan) {
        if (options.output.empty()) throw InputError("--output: missing (a .h5 file)");
        check_output_path(options.output);
    }
    const bool joint = !options.with.empty();
    if (joint == options.with_output.empty() && !(options.plan && joint))
        throw InputError(joint ? fmt::format("--with {}: needs --with-output", options.with) : fmt::format("--with-output {}: needs --with", options.with_output));
    if (joint && !options.plan) {
        check_output_path(options.with_output);
        if (options.with_output == options.output) throw InputError(fmt::format("{}: is named twice", options.output));
    }
    const ClusterOptions& c = options.cluster;
    if (c.max_size != 0 && c.max_size < c.k)
        throw InputError(fmt::format("--max-size {}: smaller than --k {}", c.max_size, c.k));
    const PathGraph graph = read_graph(options.graph);
    const PathGraph with = joint ? read_graph(options.with) : PathGraph{};
    if (graph.n_vertices() + with.n_vertices() >= no_cluster)
        throw InputError(fmt::format("{}, {}: more than {} vertices together; trace fewer samples in a pass", options.graph, options.with, no_cluster));
    const std::string planned = plan(graph, joint ? &with : nullptr, c);
    if (options.plan) {
        report.answer(planned + "\n");
        return;
    }
    report.info("plan: {}", planned);

    const InputId id = identify(options.graph), with_id = joint ? identify(options.with) : InputId{};
    const auto write = [&](Clusters& clusters, const PathGraph& of, const std::string& output, const InputId& own, const std::vector<InputId>& inputs) {
        clusters.graph = own.hash;
        clusters.provenance.stage = report.name();
        clusters.provenance.command = report.command();
        clusters.provenance.seed = c.seed;
        clusters.provenance.inputs = inputs;
        clusters.provenance.plan = planned;
        write_clusters(clusters, output);
        report.info("{}", text_of(cluster_sizes(clusters)));
        report.info("{}", text_of(cluster_spread(of, clusters, clusters_to_measure)));
    };
    const auto done = [&](const Clusters& clusters) {
        return fmt::format("{} vertices in {} clusters, {} solitary", clusters.n_members(), clusters.n_clusters(), clusters.graph_vertices - clusters.n_members());
    };
    Cost cost;
    if (!joint) {
        Clusters clusters = make_clusters(graph, c);
        write(clusters, graph, options.output, id, {id});
        cost = report.cost();
        cost.parents = {parent_of(options.output, options.graph)};
        report.done("{}", done(clusters));
    } else {
        JointClusters clusters = make_joint_clusters(graph, with, c);
        write(clusters.first, graph, options.output, id, {id, with_id});
        write(clusters.second, with, options.with_output, with_id, {with_id, id});
        cost = report.cost();
        cost.parents = {parent_of(options.output, options.graph), parent_of(options.output, options.with)};
        // What both cost together is counted once, with the first.
        Cost second;
        second.stage = report.name();
        second.command = cost.command;
        second.plan = planned;
        second.bytes_written = std::filesystem::file_size(options.with_output);
        second.parents = {parent_of(options.with_output, options.output)};
        write_cost(second, options.with_output);
        report.done("{}; {}", done(clusters.first), done(clusters.second));
    }
    cost.plan = planned;
    cost.bytes_written = std::filesystem::file_size(options.output);
    write_cost(cost, options.output);
}

}  // namespace loom::cluster
