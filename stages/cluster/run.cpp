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

}  // namespace

void declare(app::Command& command, Options& options) {
    ClusterOptions& c = options.cluster;
    command.file("graph", options.graph, "path graph (.h5)");
    command.output("-o,--output", options.output, "clusters (.h5)");
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
}

void run(const Options& options, app::Report& report) {
    if (options.graph.empty()) throw InputError("no graph is named; loom-cluster GRAPH -o CLUSTERS, or --help");
    if (!options.plan) {
        if (options.output.empty()) throw InputError("--output: missing (a .h5 file)");
        check_output_path(options.output);
    }
    const ClusterOptions& c = options.cluster;
    if (c.max_size != 0 && c.max_size < c.k)
        throw InputError(fmt::format("--max-size {}: smaller than --k {}", c.max_size, c.k));
    const PathGraph graph = read_path_graph(options.graph);
    // Their directions are not those of BSDF sampling, by whose densities neighbours are weighted.
    if (!graph.nlos.capture.empty()) throw InputError(fmt::format("{}: vertices of a capture around a corner cannot be shared; loom-transient reads it", options.graph));
    const std::string planned = plan(graph, c);
    if (options.plan) {
        report.answer(planned + "\n");
        return;
    }
    report.info("plan: {}", planned);

    Clusters clusters = make_clusters(graph, c);
    const InputId id = identify(options.graph);
    clusters.graph = id.hash;
    clusters.provenance.stage = report.name();
    clusters.provenance.command = report.command();
    clusters.provenance.seed = c.seed;
    clusters.provenance.inputs = {id};
    clusters.provenance.plan = planned;
    write_clusters(clusters, options.output);
    report.info("{}", text_of(cluster_sizes(clusters)));
    report.info("{}", text_of(cluster_spread(graph, clusters, clusters_to_measure)));

    Cost cost = report.cost();
    cost.plan = planned;
    cost.bytes_written = std::filesystem::file_size(options.output);
    cost.parents = {parent_of(options.output, options.graph)};
    write_cost(cost, options.output);
    report.done("{} vertices in {} clusters, {} solitary", clusters.n_members(), clusters.n_clusters(),
                graph.n_vertices() - clusters.n_members());
}

}  // namespace loom::cluster
