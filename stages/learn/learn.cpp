#include "stages/learn/learn.h"

#include <fmt/format.h>

#include <algorithm>

#include "formats/io/cost.h"
#include "formats/io/error.h"
#include "formats/io/hdf5_reader.h"
#include "stages/core/app/command.h"
#include "stages/core/compute/parallel.h"
#include "stages/core/graph/graph_reader.h"
#include "stages/learn/grid.h"
#include "stages/learn/points.h"

namespace loom::learn {
namespace {

/// Errors of some labels.
struct Errors {
    std::uint64_t n = 0;
    double squares = 0, of_cache = 0, of_labels = 0;

    void add(const Spectrum& y, const Spectrum& t) {
        ++n;
        for (int c = 0; c < 3; ++c) {
            squares += sqr(double(y[c]) - double(t[c])) / (sqr(double(t[c])) + 0.01) / 3;
            of_cache += double(y[c]);
            of_labels += double(t[c]);
        }
    }
    void add(const Errors& other) {
        n += other.n;
        squares += other.squares, of_cache += other.of_cache, of_labels += other.of_labels;
    }
    double relative_l2() const { return n > 0 ? squares / double(n) : 0; }
    double mean_ratio() const { return of_labels > 0 ? of_cache / of_labels : 1; }
};

}  // namespace

std::vector<Label> held_back_labels(const std::vector<LearnInput>& inputs, const LearnOptions& options) {
    std::vector<Label> labels;
    for (std::size_t g = 0; g < inputs.size(); ++g) {
        const LearnInput& in = inputs[g];
        const GraphReader reader(in.graph);
        const PreferredVertices preferred(in);
        for (const std::uint32_t j : in.clusters.member) {
            if (!is_held_back(options.seed, g, j)) continue;
            const ShadingPoint at = reader.vertex(j);
            if (!preferred(j, at.bsdf)) continue;
            const Spectrum L = rgb(in.radiance.L, j);
            if (is_cached(at.bsdf, options.smallest_roughness) && all_finite(L))
                labels.push_back({cache_query(at), L, in.graph.vertices.material[j]});
        }
    }
    return labels;
}

Validation validate(const CacheReader& reader, const std::vector<Label>& labels,
                    const std::vector<std::string>& materials, int threads) {
    std::vector<CacheQuery> queries;
    for (const Label& label : labels) queries.push_back(label.query);
    std::vector<CacheAnswer> answers(labels.size());
    parallel_chunks(labels.size(), 1024, threads, [&](std::uint64_t, std::uint64_t begin, std::uint64_t end) {
        reader.answer(std::span(queries).subspan(begin, end - begin), std::span(answers).subspan(begin, end - begin));
    });
    std::vector<Errors> errors(materials.size());
    std::vector<float> distances;
    for (std::size_t i = 0; i < labels.size(); ++i) {
        errors[labels[i].material_idx].add(answers[i].L, labels[i].L);
        distances.push_back(answers[i].distance);
    }
    Validation out;
    if (!distances.empty()) {
        const auto middle = distances.begin() + std::ptrdiff_t(distances.size() / 2);
        std::nth_element(distances.begin(), middle, distances.end());
        out.median_distance = *middle;
    }
    std::vector<std::uint64_t> n;
    std::vector<double> relative_l2, mean_ratio;
    Errors all;
    for (const Errors& e : errors) {
        n.push_back(e.n);
        relative_l2.push_back(e.relative_l2());
        mean_ratio.push_back(e.mean_ratio());
        all.add(e);
    }
    out.by_material.material = materials;
    out.by_material.vertices = std::move(n);
    out.by_material.relative_l2 = std::move(relative_l2);
    out.by_material.mean_ratio = std::move(mean_ratio);
    out.relative_l2 = all.relative_l2();
    out.mean_ratio = all.mean_ratio();
    return out;
}

PreferredVertices::PreferredVertices(const LearnInput& input)
    : is_first_(input.graph.n_vertices() + 1), counts_bounces_(input.radiance.settings.start == "zero") {
    for (const std::uint64_t j : input.graph.paths.first_vertex) is_first_[j] = true;
}

bool PreferredVertices::operator()(std::size_t vertex, const Bsdf<float>& bsdf) const {
    const BsdfKind kind = bsdf.model->kind;
    return is_first_[vertex] || (!counts_bounces_ && kind == BsdfKind::diffuse && bsdf.opacity == 1);
}

RadianceCache learn(const std::vector<LearnInput>& inputs, const LearnOptions& options, app::Report* report) {
    RadianceCache cache;
    cache.settings.method = options.method == Method::grid ? "grid" : "points";
    cache.settings.seed = options.seed;
    cache.settings.smallest_roughness = options.smallest_roughness;
    for (const LearnInput& in : inputs) cache.graphs.push_back(in.graph_id.hash);
    if (options.method == Method::grid)
        fill_grid(inputs, options, cache, report);
    else
        fill_points(inputs, options, cache);
    if (cache.settings.samples == 0) return cache;

    const std::unique_ptr<CacheReader> reader = make_cache_reader(std::move(cache));
    Validation found =
        validate(*reader, held_back_labels(inputs, options), inputs[0].graph.materials.id, options.threads);
    cache = std::move(*reader).take();
    cache.metric.median_distance = found.median_distance;
    cache.validation = std::move(found.by_material);
    return cache;
}

namespace {

/// Files of a run by their kind.
struct Files {
    std::vector<std::string> graphs, clusters, radiances;
};

Files sorted(const std::vector<std::string>& files) {
    Files out;
    for (const std::string& file : files) {
        const std::string type = filetype_of(file);
        if (type == PathGraph::format.name)
            out.graphs.push_back(file);
        else if (type == Clusters::format.name)
            out.clusters.push_back(file);
        else if (type == Radiance::format.name)
            out.radiances.push_back(file);
        else
            throw InputError(fmt::format("{}: is {}, expected a path_graph, its clusters or its radiance", file,
                                         type.empty() ? "no file of this project" : "a " + type));
    }
    if (out.graphs.empty()) throw InputError("no path graph among the inputs (loom-trace SCENE -o graph.h5)");
    return out;
}

/// Reads the file of `files` that was made from a graph.
/// in:      read  reads a file;  make  command that makes one
template <class Read>
auto of_graph(const std::vector<std::string>& files, const InputId& graph, const Read& read, const std::string& make,
              std::string& file) {
    for (const std::string& candidate : files) {
        auto found = read(candidate);
        if (found.graph != graph.hash) continue;
        file = candidate;
        return found;
    }
    throw InputError(fmt::format("{}: none of the inputs was made from it; run: {}", graph.name, make));
}

std::string plan_of(const std::vector<LearnInput>& inputs, const LearnOptions& options) {
    std::uint64_t clusters = 0;
    bool zero = false;
    for (const LearnInput& in : inputs)
        clusters += in.clusters.n_clusters(), zero |= in.radiance.settings.start == "zero";
    if (options.method == Method::grid) {
        bool directional = false, textured = false;
        for (const LearnInput& in : inputs) {
            directional |= needs_directions(in.graph);
            textured |= needs_demodulation(in.graph);
        }
        std::string on = options.seconds   ? fmt::format("{} s of training", *options.seconds)
                         : options.samples ? fmt::format("{} training samples", *options.samples)
                                           : "each vertex as two training samples";
        std::string off = "means of clusters (method grid)";
        (directional ? on : off) += directional ? ", inputs by direction" : ", inputs by direction (all is diffuse)";
        (textured ? on : off) += textured ? ", reflectance divided out" : ", division by reflectance (no textures)";
        return fmt::format("on: hash grid and network, {}; off: {}", on, off);
    }
    return fmt::format(
        "on: means of {} clusters of {} graphs, reflectance divided out{}; off: hash grid and network (method points)",
        clusters, inputs.size(),
        zero ? ", first hits alone where there are any (steps from zero: others lack a bounce)" : "");
}

}  // namespace

void declare(app::Command& command, Options& options) {
    command
        .files("files", options.files,
               "path graphs of one scene, and for each its clusters and its refined radiance (.h5), in any order")
        .required();
    command.output("-o,--output", options.output, "radiance cache (.h5)");
    command.choice("--method", options.learn.method,
                   "points: means of the clusters, no training; grid: hashed grids of features and a network, trained "
                   "on the vertices",
                   {{"points", Method::points}, {"grid", Method::grid}});
    command.option("--samples", options.learn.samples, "training samples of a grid (default: each vertex twice)",
                   app::Range<std::uint64_t>{1, std::uint64_t{1} << 40});
    command.option("--seconds", options.learn.seconds,
                   "CPU time of the training of a grid, in place of --samples; each run then learns another cache, and "
                   "names the --samples that repeat it",
                   app::Range<double>{0.1, 1e6, "s"});
    command.option("--smallest-roughness", options.learn.smallest_roughness,
                   "smallest microfacet alpha of a surface that the cache covers; smoother ones are to be followed to "
                   "the next surface",
                   app::Range<float>{0, 1});
    command.option("--seed", options.learn.seed, "seed of the choice of held-back vertices");
    command.threads(options.learn.threads);
    command.flag("--plan", options.plan, "print the plan and stop");
    command.example("loom-learn graph.h5 clusters.h5 radiance.h5 -o cache.h5");
    command.example("loom-learn view-*.h5 -o cache.h5");
    command.example("loom-learn view-*.h5 --method grid -o cache.h5");
}

void run(const Options& options, app::Report& report) {
    if (!options.plan) {
        if (options.output.empty()) throw InputError("--output: missing (a .h5 file)");
        check_output_path(options.output);
    }
    if (options.learn.method != Method::grid && (options.learn.samples || options.learn.seconds))
        throw InputError(fmt::format("--{}: needs --method grid", options.learn.samples ? "samples" : "seconds"));
    if (options.learn.samples && options.learn.seconds) throw InputError("--seconds: leave out --samples");
    // Read the inputs, and check that they belong together.
    const Files files = sorted(options.files);
    std::vector<LearnInput> inputs;
    std::vector<InputId> ids;
    std::vector<std::string> parents;
    for (const std::string& graph_file : files.graphs) {
        LearnInput& in = inputs.emplace_back();
        in.graph = read_path_graph(graph_file);
        if (!in.graph.nlos.capture.empty())
            throw InputError(fmt::format("{}: an NLOS capture has no clusters to learn from", graph_file));
        in.graph_id = identify(graph_file);
        const std::string name = app::base_name(graph_file);
        std::string clusters_file, radiance_file;
        in.clusters = of_graph(files.clusters, in.graph_id, read_clusters,
                               fmt::format("loom-cluster {} -o CLUSTERS", name), clusters_file);
        in.radiance = of_graph(files.radiances, in.graph_id, read_radiance,
                               fmt::format("loom-refine {} CLUSTERS -o RADIANCE", name), radiance_file);
        require_clusters_of(in.graph, in.graph_id, in.clusters, clusters_file);
        require_radiance_of(in.graph, in.graph_id, in.radiance, radiance_file);
        const auto& scene = in.graph.provenance.inputs;
        if (scene.empty()) throw InputError(fmt::format("{}: names no scene; trace it again", graph_file));
        if (scene[0].hash != inputs[0].graph.provenance.inputs[0].hash)
            throw InputError(fmt::format("{}: a graph of {} with content {}, but {} is of content {}", graph_file,
                                         scene[0].name, scene[0].hash, files.graphs[0],
                                         inputs[0].graph.provenance.inputs[0].hash));
        for (const std::string& file : {graph_file, clusters_file, radiance_file}) {
            ids.push_back(file == graph_file ? in.graph_id : identify(file));
            parents.push_back(file);
        }
    }
    const std::string plan = plan_of(inputs, options.learn);
    if (options.plan) {
        report.answer(plan + "\n");
        return;
    }
    report.info("plan: {}", plan);

    // Learn, and write.
    RadianceCache cache = learn(inputs, options.learn, &report);
    if (cache.settings.samples == 0)
        throw InputError(fmt::format("{}: no vertex of a cluster that a cache covers (mirrors and glass have none)",
                                     files.graphs[0]));
    if (cache.settings.nonfinite > 0)
        report.warn("{} vertices have radiance that is not finite; they were not learnt", cache.settings.nonfinite);
    cache.scene = inputs[0].graph.provenance.inputs[0].hash;
    cache.provenance = report.provenance(options.learn.seed, ids, plan);
    write_radiance_cache(cache, options.output);
    const auto& v = cache.validation;
    for (std::size_t m = 0; m < v.material.size(); ++m)
        if (v.vertices[m] > 0)
            report.info("{}: relative L2 {:.3g}, mean ratio {:.4g} on {} vertices held back", v.material[m],
                        v.relative_l2[m], v.mean_ratio[m], v.vertices[m]);
    Cost cost = report.cost(plan);
    cost.samples = cache.settings.samples;
    write_cost_of(options.output, cost, parents);
    if (cache.is_grid())
        report.done("{} training samples in {} batches", cache.settings.samples, cache.settings.batches);
    else
        report.done("{} points of {} vertices", cache.n_points(), cache.settings.samples);
}

}  // namespace loom::learn
