#include "stages/gather/gather.h"

#include <filesystem>

#include "formats/io/cost.h"
#include "formats/io/error.h"
#include "stages/core/app/command.h"
#include "stages/core/transport/film.h"
#include "stages/core/transport/graph_reader.h"
#include "stages/core/transport/parallel.h"

namespace loom::gather {
namespace {

/// f cos / pdf of the BSDF sample that leads from vertex j (at) along wi, roulette folded in.
Spectrum continuation_weight(const GraphReader& reader, const ShadingPoint& at, std::size_t j, const Vector3f& wi) {
    const auto& v = reader.graph().vertices;
    const Lobe lobe = Lobe(v.lobe[j]);
    if (!is_delta(lobe)) return f_cos_pdf(at, wi).f_cos * (1 / v.pdf_w[j]);
    Spectrum value = delta_value(at.bsdf, at.wo_local, lobe) * (1 / v.pdf_w[j]);
    if (at.perturbed && lobe != Lobe::null) value *= bump_shadowing(at, wi, at.frame.to_local(wi).z);
    return value;
}

/// in: first light edge of the path; out: that of the next path
Spectrum path_radiance(const GraphReader& reader, std::size_t path, std::size_t& edge, FirstHit& first) {
    const PathGraph& g = reader.graph();
    const auto& e = g.light_edges;
    Spectrum L{g.paths.Le[3 * path], g.paths.Le[3 * path + 1], g.paths.Le[3 * path + 2]};
    Spectrum beta(1);
    const std::uint64_t begin = g.paths.first_vertex[path], end = g.paths.first_vertex[path + 1];
    for (std::uint64_t j = begin; j < end; ++j) {
        const ShadingPoint at = reader.vertex(j);
        if (j == begin) {
            const Point3f origin = g.paths.origin.empty()
                                       ? Point3f{float(g.sensor.origin[0]), float(g.sensor.origin[1]), float(g.sensor.origin[2])}
                                       : Point3f{g.paths.origin[3 * path], g.paths.origin[3 * path + 1], g.paths.origin[3 * path + 2]};
            first = {albedo(at.bsdf, at.wo_local), at.frame.n, length(at.p - origin)};
        }
        for (; edge < e.vertex.size() && e.vertex[edge] == j; ++edge) {
            const Vector3f wi = reader.light_direction(at.p, edge);
            const Spectrum Li{e.Li[3 * edge], e.Li[3 * edge + 1], e.Li[3 * edge + 2]};
            const float pdf_nee = e.pdf_nee_w[edge], pdf_bsdf = e.pdf_bsdf_w[edge];
            if (LightTechnique(e.technique[edge]) == LightTechnique::next_event)
                L += beta * f_cos_pdf(at, wi).f_cos * Li * (power_heuristic(pdf_nee, pdf_bsdf) / pdf_nee);
            else
                L += beta * continuation_weight(reader, at, j, wi) * Li * power_heuristic(pdf_bsdf, pdf_nee);
        }
        if (j + 1 < end) {
            const auto& wo = g.vertices.wo;
            beta *= continuation_weight(reader, at, j, {-wo[3 * j + 3], -wo[3 * j + 4], -wo[3 * j + 5]});
        }
    }
    return L;
}

/// First light edge at or after vertex j.
std::size_t first_edge(const PathGraph& g, std::uint64_t j) {
    const auto vertices = g.light_edges.vertex.values();
    return std::size_t(std::lower_bound(vertices.begin(), vertices.end(), j) - vertices.begin());
}

}  // namespace

void declare(app::Command& command, Options& options) {
    command.file("graph", options.graph, "path graph (.h5)");
    command.output("-o,--output", options.output, "image with layers (.exr)");
    command.output("--png", options.png, "also write a preview");
    command.option("--exposure", options.exposure_ev, "of the preview", app::Range<double>{-40, 40, "EV"});
    command.threads(options.threads);
    command.example("loom-gather graph.h5 -o image.exr --png image.png");
}

Image path_traced_image(const PathGraph& graph, int threads) {
    const GraphReader reader(graph);
    const std::uint64_t n_pixels = graph.n_pixels(), samples = graph.tracing.samples_per_pixel;
    Film film(graph.sensor.width, graph.sensor.height, samples);
    parallel_chunks(n_pixels, 1024, threads, [&](std::uint64_t, std::uint64_t begin, std::uint64_t end) {
        std::vector<PixelSums> sums(end - begin);
        for (std::uint64_t s = 0; s < samples; ++s) {
            std::size_t edge = first_edge(graph, graph.paths.first_vertex[s * n_pixels + begin]);
            for (std::uint64_t pixel = begin; pixel < end; ++pixel) {
                FirstHit first;
                const Spectrum L = path_radiance(reader, s * n_pixels + pixel, edge, first);
                sums[pixel - begin].add(L, first);
            }
        }
        for (std::uint64_t pixel = begin; pixel < end; ++pixel) film.set(pixel, sums[pixel - begin]);
    });
    return std::move(film).finish({});
}

void run(const Options& options, app::Report& report) {
    if (options.output.empty()) throw InputError("--output: missing (an .exr file)");
    check_output_path(options.output);
    const PathGraph graph = read_path_graph(options.graph);
    Image image = path_traced_image(graph, options.threads);
    image.provenance.stage = report.name();
    image.provenance.command = report.command();
    image.provenance.seed = graph.provenance.seed;
    image.provenance.inputs = {identify(options.graph)};
    image.provenance.plan = "on: own paths only; off: neighbours (no clusters given)";
    if (const std::size_t bad = count_nonfinite(image); bad > 0)
        report.warn("{} values of the image are not finite", bad);
    write_image(image, options.output);
    if (!options.png.empty()) write_png(image, options.png, options.exposure_ev);

    const app::Usage usage = report.usage();
    Cost cost;
    cost.stage = report.name();
    cost.wall_s = usage.wall_s;
    cost.cpu_s = usage.cpu_s;
    cost.samples = graph.n_paths();
    cost.peak_memory_bytes = usage.peak_memory_bytes;
    cost.bytes_written = std::filesystem::file_size(options.output);
    cost.parents = {std::filesystem::path(options.graph).filename()};
    write_cost(cost, options.output);
    report.done("{} paths, {} vertices", graph.n_paths(), graph.n_vertices());
}

}  // namespace loom::gather
