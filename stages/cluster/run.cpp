#include <fmt/format.h>

#include <algorithm>
#include <filesystem>
#include <memory>

#include "formats/io/cost.h"
#include "formats/io/error.h"
#include "stages/cluster/cluster.h"
#include "stages/core/app/command.h"
#include "stages/core/clusters/cluster_quality.h"
#include "stages/core/edit/animation.h"
#include "stages/core/graph/graph_reader.h"
#include "stages/core/scene/build.h"
#include "stages/core/scene/embree.h"

namespace loom::cluster {
namespace {

/// Enough for figures with an error of a percent; measuring all clusters would cost a fifth of the clustering.
constexpr std::size_t clusters_to_measure = 4096;

PathGraph read_graph(const std::string& file) {
    PathGraph graph = read_path_graph(file);
    // Their directions are not those of BSDF sampling, whose densities weight the neighbours.
    if (!graph.nlos.capture.empty())
        throw InputError(fmt::format(
            "{}: vertices of an NLOS capture cannot share samples; bin its paths with loom-transient", file));
    return graph;
}

std::string output_of(const std::string& name, const std::string& graph) {
    return app::name_of_part(name, std::filesystem::path(graph).stem().string());
}

void check(const Options& options) {
    if (options.graphs.empty())
        throw InputError("no input: give a path graph (loom-cluster GRAPH -o CLUSTERS); see --help");
    const bool joint = !options.with.empty();
    if (joint && options.with.size() != options.graphs.size())
        throw InputError(
            fmt::format("--with: {} for {} graphs; one for each", options.with.size(), options.graphs.size()));
    if (joint == options.with_output.empty() && !(options.plan && joint))
        throw InputError(joint ? fmt::format("--with {}: needs --with-output", options.with[0])
                               : fmt::format("--with-output {}: needs --with", options.with_output));
    if (!options.plan) {
        if (options.output.empty()) throw InputError("--output: missing (a .h5 file)");
        std::vector<std::string> outputs;
        const auto add = [&](const std::string& name, const std::vector<std::string>& graphs) {
            if (graphs.size() > 1 && name.find('%') == std::string::npos)
                throw InputError(name + ": needs a % for the names of the graphs, because several are given");
            for (const std::string& graph : graphs) {
                outputs.push_back(output_of(name, graph));
                check_output_path(outputs.back());
            }
        };
        add(options.output, options.graphs);
        add(options.with_output, options.with);
        std::sort(outputs.begin(), outputs.end());
        if (const auto twice = std::adjacent_find(outputs.begin(), outputs.end()); twice != outputs.end())
            throw InputError(fmt::format("{}: given twice", *twice));
    }
    if (options.scene.empty() && !options.defines.empty()) throw InputError("--define: needs --scene");
    if (options.scene.empty() && !options.static_frames.empty()) throw InputError("--static: needs --scene");
    if (!options.absent.empty() && options.static_frames.empty()) throw InputError("--absent: needs --static");
    if (joint && !options.static_frames.empty()) throw InputError("--static: leave out --with");
    if (options.with_scene.empty() && !options.with_defines.empty())
        throw InputError("--with-define: needs --with-scene");
    if (joint && options.scene.empty() != options.with_scene.empty())
        throw InputError("--scene, --with-scene: give both scenes or none");
    if (!joint && !options.with_scene.empty())
        throw InputError(fmt::format("--with-scene {}: needs --with", options.with_scene));
    const ClusterOptions& c = options.cluster;
    if (c.max_size != 0 && c.max_size < c.k)
        throw InputError(fmt::format("--max-size {}: smaller than --k {}", c.max_size, c.k));
}

/// Returns the command that makes the clusters of graph i alone.
std::string command_of(const Options& options, std::string command, std::size_t i) {
    if (options.graphs.size() == 1) return command;
    const auto words = [](const std::string& before, std::span<const std::string> graphs) {
        std::string all;
        for (const std::string& graph : graphs) all += before + app::shell_word(app::base_name(graph));
        return all;
    };
    std::vector<std::pair<std::string, std::string>> changes{
        {words(" ", options.graphs), words(" ", {&options.graphs[i], 1})}};
    if (!options.with.empty())
        changes.emplace_back(words(" --with ", options.with), words(" --with ", {&options.with[i], 1}));
    changes.emplace_back(fmt::format(" --seed {}", options.cluster.seed),
                         fmt::format(" --seed {}", options.cluster.seed + i));
    return app::command_of_part(std::move(command), changes);
}

/// Makes clusters of one graph, or of two, and writes them.
class Maker {
  public:
    Maker(const Options& options, app::Report& report, const Scene* scene, const Scene* with_scene)
        : options_(options), report_(report) {
        settings_ = options.cluster;
        settings_.scene = scene, settings_.with_scene = with_scene;
    }

    /// in: loading  this graph's share of the cost of reading the scene
    void make(std::size_t i, const Cost& loading) {
        const Cost before = report_.cost();
        const std::string& file = options_.graphs[i];
        settings_.seed = options_.cluster.seed + i;
        command_ = command_of(options_, report_.command(), i);
        const bool joint = !options_.with.empty();
        const std::string with_file = joint ? options_.with[i] : std::string();
        const PathGraph graph = read_graph(file), with = joint ? read_graph(with_file) : PathGraph{};
        if (settings_.scene) require_scene_of(graph, file, *settings_.scene, options_.scene);
        if (settings_.with_scene) require_scene_of(with, with_file, *settings_.with_scene, options_.with_scene);
        if (graph.n_vertices() + with.n_vertices() >= no_cluster)
            throw InputError(fmt::format("{}, {}: more than {} vertices together; trace fewer samples in a pass", file,
                                         with_file, no_cluster));
        plan_ = plan(graph, joint ? &with : nullptr, settings_);
        if (options_.plan) {
            report_.answer(plan_ + "\n");
            return;
        }
        report_.info("plan: {}", plan_);
        if (!settings_.scene)
            report_.warn(
                "no --scene: visibility between members of a cluster is not tested, and light may leak through walls; "
                "give --scene");
        const std::string output = output_of(options_.output, file);
        const InputId id = identify(file);
        Cost cost;
        if (!joint) {
            Clusters clusters = make_clusters(graph, settings_, workspace_);
            write(clusters, graph, output, id, {id});
            cost = report_.cost(plan_);
            cost.rays = workspace_.n_rays;
            report_.done("{}", text_of_done(clusters));
        } else {
            const InputId with_id = identify(with_file);
            const std::string with_output = output_of(options_.with_output, with_file);
            JointClusters clusters = make_joint_clusters(graph, with, settings_);
            write(clusters.first, graph, output, id, {id, with_id});
            write(clusters.second, with, with_output, with_id, {with_id, id});
            cost = report_.cost(plan_);
            cost.rays = clusters.n_rays;
            // Cost of both graphs together is counted once, with the first.
            Cost second;
            second.stage = report_.name();
            second.command = cost.command;
            second.plan = plan_;
            write_cost_of(with_output, second, {output});
            report_.done("{}; {}", text_of_done(clusters.first), text_of_done(clusters.second));
        }
        cost.wall_s += loading.wall_s - before.wall_s;
        cost.cpu_s += loading.cpu_s - before.cpu_s;
        cost.load_s = loading.load_s;
        write_cost_of(output, cost, {file, with_file});
    }

  private:
    void write(Clusters& clusters, const PathGraph& of, const std::string& output, const InputId& own,
               const std::vector<InputId>& inputs) const {
        clusters.graph = own.hash;
        clusters.provenance = report_.provenance(settings_.seed, inputs, plan_);
        clusters.provenance.command = command_;
        write_clusters(clusters, output);
        report_.info("{}", text_of(cluster_sizes(clusters)));
        report_.info("{}", text_of(cluster_spread(of, clusters, clusters_to_measure)));
        report_.info("separated, of {} vertices: {}", clusters.n_members(), text_of(clusters.separation));
    }
    static std::string text_of_done(const Clusters& clusters) {
        return fmt::format("{} vertices in {} clusters, {} solitary", clusters.n_members(), clusters.n_clusters(),
                           clusters.graph_vertices - clusters.n_members());
    }

    const Options& options_;
    app::Report& report_;
    ClusterOptions settings_;
    Workspace workspace_;
    std::string plan_, command_;
};

}  // namespace

void declare(app::Command& command, Options& options) {
    ClusterOptions& c = options.cluster;
    command.files("graphs", options.graphs, "path graphs (.h5), each clustered by itself");
    command.output("-o,--output", options.output,
                   "clusters (.h5); % stands for the name of the graph without its ending");
    command.file("--scene", options.scene,
                 "scene file of the graphs; turns on the visibility test between members of a cluster");
    command.option("-D,--define", options.defines, "NAME=VALUE of a parameter $NAME of that scene");
    command.option("--absent", options.absent,
                   "with --static: a parameter with this value drops the shapes that use it from the frame");
    command.file(
        "--static", options.static_frames,
        "table of frames: the scene of the graphs is what the frames of --scene share, as in loom-trace --static");
    command.option("--sensor", options.sensor, "sensor of that scene, as given to loom-trace");
    command.files("--with", options.with,
                  "for each graph, a graph of an edited scene to cluster jointly with it, for differences of the two");
    command.output("--with-output", options.with_output,
                   "clusters of the --with graphs (.h5), named like those of --output");
    command.file("--with-scene", options.with_scene, "scene file of the --with graphs");
    command.option("--with-define", options.with_defines, "NAME=VALUE of a parameter $NAME of the --with scene");
    command.choice("--method", c.method, "balanced: median splits; centres: nearest of random centres",
                   {{"balanced", Method::balanced}, {"centres", Method::centres}});
    command.option("--k", c.k, "balanced: largest cluster; centres: mean size", app::Range<std::uint32_t>{1, 65536});
    command.option("--max-size", c.max_size, "largest cluster; 0: 2 k", app::Range<std::uint32_t>{0, 131072});
    command.option("--normal-weight", c.normal_weight,
                   "weight of a unit difference of normals, in cluster radii; 0: positions alone",
                   app::Range<float>{0, 1e6f});
    command.option("--private-roughness", c.private_roughness,
                   "smallest microfacet alpha of a vertex that shares samples", app::Range<float>{0, 1});
    command.option("--seed", c.seed,
                   "seed of the first graph (the next ones count up); moves the borders between clusters");
    command.threads(c.threads);
    command.flag("--plan", options.plan, "print the plan and stop");
    command.example("loom-cluster graph.h5 --scene scene.xml -o clusters.h5 --k 16");
    command.example("loom-cluster pass-0.h5 pass-1.h5 --scene scene.xml -o %.clusters.h5");
    command.example(
        "loom-cluster old.h5 --with new.h5 --scene old.xml --with-scene new.xml -o old.clusters.h5 --with-output "
        "new.clusters.h5");
}

void run(const Options& options, app::Report& report) {
    check(options);
    const auto load = [&](const std::string& file, const std::vector<std::string>& defines) {
        if (options.static_frames.empty() || file.empty())
            return file.empty() ? nullptr : load_scene(file, parse_defines(defines), options.sensor);
        return build_scene(find_animation(file, parse_defines(defines), options.sensor,
                                          read_frames(options.static_frames, options.absent), Cameras::each)
                               .still);
    };
    const double before_s = report.cost().cpu_s;
    const auto scene = load(options.scene, options.defines),
               with_scene = load(options.with_scene, options.with_defines);
    // Distribute the cost of reading the scene over the graphs.
    Cost loading = report.cost();
    const auto n = double(options.graphs.size());
    loading.load_s = (loading.cpu_s - before_s) / n;
    loading.wall_s /= n, loading.cpu_s /= n;
    Maker maker(options, report, scene.get(), with_scene.get());
    for (std::size_t i = 0; i < options.graphs.size(); ++i) maker.make(i, loading);
}

}  // namespace loom::cluster
