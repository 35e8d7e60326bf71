#include "stages/gather/gather.h"

#include <fmt/format.h>
#include <tbb/enumerable_thread_specific.h>

#include <algorithm>
#include <filesystem>
#include <memory>
#include <optional>

#include "formats/clusters.h"
#include "formats/io/content_hash.h"
#include "formats/io/cost.h"
#include "formats/io/error.h"
#include "stages/core/app/command.h"
#include "stages/core/compute/parallel.h"
#include "stages/core/graph/own_samples.h"
#include "stages/core/scene/build.h"
#include "stages/core/scene/embree.h"
#include "stages/core/tracing/film.h"
#include "stages/core/tracing/vertex_rules.h"
#include "stages/gather/subset.h"

namespace loom::gather {
namespace {

FirstHit first_hit(const PathGraph& g, std::size_t path, const ShadingPoint& at) {
    return loom::first_hit(at, length(at.p - camera_origin(g, path)));
}

/// in: first light edge of the path; out: that of the next path
Spectrum path_radiance(const GraphReader& reader, std::size_t path, std::size_t& edge, FirstHit& first) {
    const PathGraph& g = reader.graph();
    Spectrum L = rgb(g.paths.Le, path);
    walk_path(
        OwnSamples(reader), path, edge,
        [&](std::size_t j, const ShadingPoint& at) {
            if (j == g.paths.first_vertex[path]) first = first_hit(g, path, at);
        },
        [&](std::size_t, std::size_t, const Spectrum& light) { L += light; });
    return L;
}

/// Light of one path, by source.
struct Estimates {
    Spectrum Le, direct_own, direct_cluster, indirect_path, indirect_own, indirect_cluster;
};

/// in:      edge   first light edge of the path
///          paths  also compute the path's own estimate of indirect light: the stored one, else by a walk along the
///          whole path
/// out:     edge   first light edge of the next path
Estimates estimates_of(const GraphReader& reader, const Radiance& radiance, bool paths, std::size_t path,
                       std::size_t& edge, FirstHit& first) {
    const PathGraph& g = reader.graph();
    const auto& e = g.light_edges;
    Estimates L;
    L.Le = rgb(g.paths.Le, path);
    const auto [begin, end] = vertices_of(g, path);
    if (begin < end) {
        L.direct_cluster = rgb(radiance.direct, path);
        L.indirect_cluster = rgb(radiance.L, begin) - L.direct_cluster;
        const OwnSamples samples(reader);
        const Spectrum beta = walk_vertices<float>(
            samples, {begin, begin + 1}, end, Spectrum(1), edge,
            [&](std::size_t, const ShadingPoint& at) { first = first_hit(g, path, at); },
            [&](std::size_t, std::size_t, const Spectrum& light) { L.direct_own += light; });
        if (begin + 1 < end) {
            L.indirect_own = beta * rgb(radiance.L, begin + 1);
            const bool stored = !radiance.indirect_path.empty();
            if (paths && stored) L.indirect_path = rgb(radiance.indirect_path, path);
            if (paths && !stored)
                walk_vertices<float>(
                    samples, {begin + 1, end}, end, beta, edge, [](std::size_t, const ShadingPoint&) {},
                    [&](std::size_t, std::size_t, const Spectrum& light) { L.indirect_path += light; });
        }
    }
    while (edge < e.vertex.size() && e.vertex[edge] < end) ++edge;
    return L;
}

/// Makes an image from value(path, edge, first) of each path, pixel by pixel.
template <class Value>
Image image_of(const PathGraph& graph, int threads, Value value) {
    const std::uint64_t n_pixels = graph.n_pixels(), samples = graph.tracing.samples_per_pixel;
    Film film(graph.sensor.width, graph.sensor.height, samples);
    parallel_chunks(n_pixels, 1024, threads, [&](std::uint64_t, std::uint64_t begin, std::uint64_t end) {
        std::vector<PixelSums> sums(end - begin);
        for (std::uint64_t s = 0; s < samples; ++s) {
            std::size_t edge = first_light_edge(graph, graph.paths.first_vertex[s * n_pixels + begin]);
            for (std::uint64_t pixel = begin; pixel < end; ++pixel) {
                FirstHit first;
                const Spectrum L = value(s * n_pixels + pixel, edge, first);
                sums[pixel - begin].add(L, first);
            }
        }
        for (std::uint64_t pixel = begin; pixel < end; ++pixel) film.set(pixel, sums[pixel - begin]);
    });
    return std::move(film).finish({});
}

}  // namespace

void declare(app::Command& command, Options& options) {
    command.file("graph", options.graph, "path graph (.h5)");
    command.file("radiance", options.radiance,
                 "refined radiance of that graph (.h5); without it: the paths' own samples only");
    command.file("clusters", options.clusters, "clusters of that graph (.h5), for subsets");
    command.output("-o,--output", options.output, "output image with layers (.exr)");
    command.output("--png", options.png, "also write an sRGB preview (.png)");
    command.option("--exposure", options.exposure_ev, "exposure of the preview", app::Range<double>{-40, 40, "EV"});
    command.choice("--direct", options.gather.direct,
                   "direct light at first hits: samples of the whole cluster, the path's own, or its own and those of "
                   "a random subset of members",
                   {{"cluster", Source::cluster}, {"own", Source::own}, {"subset", Source::subset}});
    command.choice("--indirect", options.gather.indirect, "indirect light at first hits, with the same choices",
                   {{"cluster", Source::cluster}, {"own", Source::own}, {"subset", Source::subset}});
    command.option("--members", options.gather.members,
                   "number of random members of a subset, besides the vertex itself",
                   app::Range<std::uint32_t>{1, max_lanes});
    command.choice("--reuse", options.gather.reuse,
                   "what a subset reuses of a member's continuation: its direction or its end point",
                   {{"directions", Reuse::directions}, {"points", Reuse::points}});
    command.flag("--occlusion", options.gather.occlusion,
                 "reconnect a subset's continuations and test their visibility by rays, which leaves only the bias of "
                 "the radiance; needs --scene");
    command.file("--scene", options.scene, "scene file of the graph");
    command.option("-D,--define", options.defines, "NAME=VALUE of a parameter $NAME of that scene");
    command.option("--sensor", options.sensor, "sensor of that scene, as given to loom-trace");
    command.flag("--estimates", options.gather.estimates,
                 "also write all estimates of direct and indirect light as layers that loom-merge blends");
    command.threads(options.threads);
    command.example("loom-gather graph.h5 -o image.exr --png image.png");
}

Image path_traced_image(const PathGraph& graph, int threads) {
    const GraphReader reader(graph);
    return image_of(graph, threads, [&](std::size_t path, std::size_t& edge, FirstHit& first) {
        return path_radiance(reader, path, edge, first);
    });
}

Image gathered_image(const PathGraph& graph, const Radiance& radiance, const GatherOptions& options, int threads,
                     const SubsetInputs& inputs, std::uint64_t* n_rays) {
    const GraphReader reader(graph);
    const bool subset_direct = options.direct == Source::subset, subset_indirect = options.indirect == Source::subset;
    std::optional<SubsetGather> subset;
    if (subset_direct || subset_indirect)
        subset.emplace(
            reader, *inputs.clusters, radiance,
            SubsetOptions{options.members, options.reuse, options.occlusion ? inputs.scene : nullptr, inputs.seed});
    tbb::enumerable_thread_specific<std::unique_ptr<SubsetGather::Worker>> workers([&] {
        flush_small_numbers();
        return std::make_unique<SubsetGather::Worker>(*subset);
    });
    const std::uint64_t n_pixels = graph.n_pixels();
    std::vector<std::vector<float>> layers(options.estimates ? estimate_layers.size() : 0,
                                           std::vector<float>(3 * n_pixels));
    const float inv_samples = 1.0f / float(graph.tracing.samples_per_pixel);
    Image image = image_of(graph, threads, [&](std::size_t path, std::size_t& edge, FirstHit& first) {
        Estimates L = estimates_of(reader, radiance, options.estimates, path, edge, first);
        if (subset && first.depth != 0) {
            const auto few = workers.local()->at(path, std::uint32_t(graph.paths.first_vertex[path]),
                                                 {L.direct_own, L.indirect_own}, subset_direct, subset_indirect);
            if (subset_direct) L.direct_cluster = few.direct;
            if (subset_indirect) (options.occlusion ? L.indirect_own : L.indirect_cluster) = few.indirect;
        }
        if (options.estimates) {
            const std::array values{L.Le,           L.direct_own,      L.direct_cluster, L.indirect_path,
                                    L.indirect_own, L.indirect_cluster};
            for (std::size_t i = 0; i < values.size(); ++i)
                for (int c = 0; c < 3; ++c) layers[i][3 * (path % n_pixels) + c] += values[i][c] * inv_samples;
        }
        return L.Le + (options.direct == Source::own ? L.direct_own : L.direct_cluster) +
               (options.indirect == Source::own || (subset_indirect && options.occlusion) ? L.indirect_own
                                                                                          : L.indirect_cluster);
    });
    if (n_rays)
        for (const auto& worker : workers) *n_rays += worker->rays();
    for (std::size_t i = 0; i < layers.size(); ++i) image.set_layer(estimate_layers[i], "RGB", layers[i]);
    return image;
}

void run(const Options& options, app::Report& report) {
    if (options.output.empty()) throw InputError("--output: missing (an .exr file)");
    check_output_path(options.output);
    const PathGraph graph = read_path_graph(options.graph);
    const InputId graph_id = identify(options.graph);
    const bool subsets = options.gather.direct == Source::subset || options.gather.indirect == Source::subset;
    if (subsets && options.clusters.empty())
        throw InputError("clusters: missing; a subset is drawn from them (make them with loom-cluster)");
    if (!subsets && !options.clusters.empty())
        throw InputError(
            fmt::format("{}: only subsets need clusters (--direct subset, --indirect subset)", options.clusters));
    const bool occlusion = options.gather.occlusion;
    if (occlusion && options.gather.indirect != Source::subset)
        throw InputError("--occlusion: needs --indirect subset");
    if (occlusion != !options.scene.empty())
        throw InputError(occlusion ? "--occlusion: needs --scene"
                                   : fmt::format("--scene {}: only --occlusion needs it", options.scene));
    std::unique_ptr<Scene> scene;
    std::uint64_t rays = 0;
    double load_s = 0;
    Image image;
    if (options.radiance.empty()) {
        image = path_traced_image(graph, options.threads);
    } else {
        const Radiance radiance = read_radiance(options.radiance);
        require_radiance_of(graph, graph_id, radiance, options.radiance);
        Clusters clusters;
        if (subsets) {
            clusters = read_clusters(options.clusters);
            require_clusters_of(graph, graph_id, clusters, options.clusters);
            for (std::size_t c = 0; c < clusters.n_clusters(); ++c)
                if (clusters.first[c + 1] - clusters.first[c] > max_lanes && options.gather.members >= max_lanes)
                    throw InputError(fmt::format("--members {}: {} has clusters of more than {} vertices",
                                                 options.gather.members, options.clusters, max_lanes));
        }
        if (occlusion) {
            const double before_s = report.cost().cpu_s;
            scene = load_scene(options.scene, parse_defines(options.defines), options.sensor);
            load_s = report.cost().cpu_s - before_s;
            require_scene_of(graph, options.graph, *scene, options.scene);
        }
        image = gathered_image(graph, radiance, options.gather, options.threads,
                               {&clusters, scene.get(), graph.provenance.seed}, &rays);
    }
    image.provenance =
        report.provenance(graph.provenance.seed, {graph_id}, "on: own paths only; off: neighbours (no radiance given)");
    if (!graph.provenance.inputs.empty()) image.scene = graph.provenance.inputs[0];
    if (!options.radiance.empty()) {
        const auto name = [&](Source source) {
            return source == Source::own       ? "own samples"
                   : source == Source::cluster ? "cluster"
                                               : fmt::format("own samples and {} members", options.gather.members);
        };
        image.provenance.inputs.push_back(identify(options.radiance));
        if (subsets) image.provenance.inputs.push_back(identify(options.clusters));
        const char* test = occlusion ? "on: occlusion rays, " : "on: ";
        const char* off = occlusion                                   ? "nothing"
                          : options.gather.indirect == Source::subset ? "occlusion rays (no --occlusion)"
                                                                      : "occlusion rays (no subset)";
        image.provenance.plan = fmt::format("{}direct light by {}, indirect by {}; off: {}", test,
                                            name(options.gather.direct), name(options.gather.indirect), off);
    }
    write_image(image, options.output);
    if (!options.png.empty()) write_png(image, options.png, options.exposure_ev);

    Cost cost = report.cost(image.provenance.plan);
    cost.samples = graph.n_paths();
    if (occlusion) cost.sources = {options.scene};
    cost.rays = rays;
    cost.load_s = load_s;
    write_cost_of(options.output, cost, {options.graph, options.radiance, subsets ? options.clusters : ""});
    report.done("{} paths, {} vertices", graph.n_paths(), graph.n_vertices());
}

}  // namespace loom::gather
