#include "stages/trace/trace.h"

#include <fmt/format.h>
#include <tbb/enumerable_thread_specific.h>

#include <filesystem>

#include "formats/image.h"
#include "formats/io/content_hash.h"
#include "formats/io/cost.h"
#include "formats/io/error.h"
#include "formats/path_graph.h"
#include "stages/core/app/command.h"
#include "stages/core/compute/parallel.h"
#include "stages/core/edit/animation.h"
#include "stages/core/scene/build.h"
#include "stages/core/scene/nlos.h"
#include "stages/core/tracing/film.h"
#include "stages/core/tracing/graph_builder.h"
#include "stages/trace/replay.h"

namespace loom::trace {
namespace {

PathOptions path_options(const Options& options, const Scene& scene) {
    PathOptions path;
    path.seed = options.seed;
    path.sampler = options.sampler;
    path.roulette = options.roulette;
    path.rr_depth = options.rr_depth.value_or(scene.rr_depth);
    path.max_depth = options.max_depth.value_or(scene.max_depth);
    path.laser_spot = options.laser_spot;
    return path;
}

/// State of one thread, reused between chunks.
struct Worker {
    PathBatch batch;
    std::vector<PathResult> results;
    Counts counts;
    Worker(const Scene& scene, const PathOptions& path) : batch(scene, path) {}
};

struct PictureWorker : Worker {
    tracing::NonfiniteLog& nonfinite;
    Film& film;
    PixelSums sums;
    PictureWorker(const Scene& scene, const PathOptions& path, tracing::NonfiniteLog& log, Film& onto)
        : Worker(scene, path), nonfinite(log), film(onto) {}

    void trace(std::span<const PathId> ids) {
        results.resize(ids.size());
        batch.trace(ids, results);
    }
    void add(std::size_t k, PathId id) {
        nonfinite.check(results[k].L, id);
        sums.add(results[k].L, results[k].first);
        counts.add(results[k]);
    }
    void finish(std::uint64_t pixel) {
        film.set(pixel, sums);
        sums = {};
    }
};

struct GraphWorker : Worker {
    using Worker::Worker;
    std::vector<PathId> ids;
    PathRecords records;
};

std::uint64_t pass_number(const Options& options, std::uint64_t pass) {
    return options.first_sample / options.spp + pass;
}

std::string output_of_pass(const Options& options, std::uint64_t pass) {
    return app::name_of_part(options.output, std::to_string(pass_number(options, pass)));
}

/// Returns the command that makes this pass alone.
std::string command_of_pass(const Options& options, std::string command, std::uint64_t pass) {
    return app::command_of_part(std::move(command),
                                {{fmt::format(" --passes {}", options.passes), ""},
                                 {fmt::format(" --first-sample {}", options.first_sample),
                                  fmt::format(" --first-sample {}", options.first_sample + pass * options.spp)}});
}

}  // namespace

Image render_image(const Scene& scene, const PathOptions& path, const Work& work, app::Report& report, Counts& counts) {
    Film film(scene.sensor.width, scene.sensor.height, work.spp);
    tracing::NonfiniteLog nonfinite(report, scene.sensor.width, path.seed);
    app::Progress progress(report, "tracing", scene.sensor.n_pixels() * work.spp);
    tbb::enumerable_thread_specific<PictureWorker> workers([&] { return PictureWorker(scene, path, nonfinite, film); });
    tracing::trace_pixels(
        workers, scene.sensor.n_pixels(), double(work.spp), work.threads,
        [&](std::uint64_t) {
            return tracing::SampleRange{work.first_sample, work.spp};
        },
        progress);
    counts = {0, 0, nonfinite.count()};
    for (const PictureWorker& worker : workers) counts.add(worker.counts);
    return std::move(film).finish({});
}

PathGraphInPieces render_graph(const Scene& scene, const PathOptions& path, const Work& work, app::Report& report,
                               Counts& counts, std::shared_ptr<Arena> memory, const OptionalColumns& columns) {
    const std::uint64_t n_pixels = scene.sensor.n_pixels(), n_paths = n_pixels * work.spp;
    GraphBuilder builder(scene, path, (n_paths + PathBatch::capacity - 1) / PathBatch::capacity, std::move(memory),
                         columns);
    tracing::NonfiniteLog nonfinite(report, scene.sensor.width, path.seed);
    counts = {};
    {
        app::Progress progress(report, "tracing", n_paths);
        tbb::enumerable_thread_specific<GraphWorker> workers([&] { return GraphWorker(scene, path); });
        parallel_chunks(n_paths, PathBatch::capacity, work.threads,
                        [&](std::uint64_t chunk, std::uint64_t begin, std::uint64_t end) {
                            GraphWorker& worker = workers.local();
                            worker.records.keeps_misses = columns.misses;
                            worker.ids.resize(end - begin);
                            for (std::uint64_t i = begin; i < end; ++i)
                                worker.ids[i - begin] = {i % n_pixels, work.first_sample + i / n_pixels};
                            worker.results.resize(worker.ids.size());
                            worker.batch.trace(worker.ids, worker.results, worker.records);
                            for (std::size_t k = 0; k < worker.ids.size(); ++k) {
                                nonfinite.check(worker.results[k].L, worker.ids[k]);
                                worker.counts.add(worker.results[k]);
                            }
                            builder.set(chunk, worker.records);
                            progress.add(end - begin);
                        });
        for (const GraphWorker& worker : workers) counts.add(worker.counts);
    }
    counts.nonfinite = nonfinite.count();
    return std::move(builder).finish(work.first_sample, work.spp);
}

void declare(app::Command& command, Options& options) {
    command.file("scene", options.scene, "scene file (Mitsuba XML, dialects 0.5 to 3)");
    command.output("-o,--output", options.output,
                   "path graph (.h5) or path-traced image (.exr); % stands for the pass number");
    command.option("-D,--define", options.defines, "NAME=VALUE of a scene parameter $NAME");
    command.option("--sensor", options.sensor,
                   "sensor to render, by id or by number from 0 in the order of the file (default: the first)");
    command.option("--spp", options.spp, "samples per pixel", app::Range<std::uint64_t>{1, 1u << 30});
    command.option("--first-sample", options.first_sample, "index of the first sample of each pixel");
    command.option("--passes", options.passes, "number of files to write, with --spp samples per pixel each",
                   app::Range<std::uint64_t>{1, 1u << 20});
    command.option("--seed", options.seed, "seed of all random numbers");
    command.choice("--sampler", options.sampler, "sampler of the random numbers",
                   {{"sobol", SamplerKind::sobol}, {"independent", SamplerKind::independent}});
    command.choice("--roulette", options.roulette,
                   "survival probability of roulette: the vertex's albedo, or the path's throughput",
                   {{"albedo", Roulette::albedo}, {"throughput", Roulette::throughput}, {"off", Roulette::off}});
    command.option("--rr-depth", options.rr_depth, "first vertex at which roulette may end a path",
                   app::Range<int>{1, 1 << 20});
    command.option("--max-depth", options.max_depth, "longest path in edges; -1: no limit",
                   app::Range<int>{-1, 1 << 20});
    command.choice("--laser-spot", options.laser_spot,
                   "area of a sampled laser spot in an NLOS capture: 1 m² (as in mitransient), or the true area of the "
                   "beam's section",
                   {{"unit", LaserSpot::unit_area}, {"true", LaserSpot::true_area}});
    command.flag("--misses", options.columns.misses,
                 "also store failed light samples (+10 % bytes); makes loom-residual --old-graph several times faster");
    command.flag("--primitives", options.columns.primitives,
                 "also store the triangle of each vertex (+4 bytes per vertex), for derivatives");
    command.flag("--media", options.columns.media,
                 "also store the material of each segment's medium (+2 bytes per vertex and edge), for derivatives by "
                 "the index of refraction");
    command.file(
        "--static", options.static_frames,
        "table of frames (.tsv: `frame` and names of $parameters, a row per frame): trace the static scene that "
        "they share, for loom-residual --frames; with --only from the camera of each of those frames, a path graph for "
        "a "
        "radiance cache (loom-learn), with random numbers of its own; % in the output's name is the frame's number");
    command.file(
        "--frames", options.frames,
        "table of frames: trace each by itself, with random numbers of its own, into an image; % in the output's "
        "name is its number, with four digits");
    command.option(
        "--only", options.only,
        "with --frames, --static: FIRST:END, the frames from FIRST on below END; FIRST:END:STEP, each STEP-th of them");
    command.option("--absent", options.absent,
                   "with --frames, --static: a parameter with this value drops the shapes that use it from the frame");
    command.threads(options.threads);
    command.flag("--plan", options.plan, "print the plan and stop");
    command.option("--replay", options.replay, "X,Y,SAMPLE: trace that path alone and print it");
    command.example("loom-trace scenes/cornell-box.xml --spp 4 -o graph.h5");
}

namespace {

/// Describes the medium around the camera.
std::string camera_medium(const Scene& scene) {
    if (scene.sensor_media.varies) return "camera in media that differ from ray to ray";
    const MediumStack& media = scene.sensor_media.everywhere;
    std::string shapes;
    for (const MediumStack::Entry& entry : media.entries()) {
        const std::string& id = scene.shapes[entry.shape_idx].id;
        shapes += fmt::format("{}shape {}", shapes.empty() ? "" : " and ",
                              id.empty() ? fmt::format("number {}", entry.shape_idx + 1) : "'" + id + "'");
    }
    return fmt::format("camera {}(index {:.4g})", shapes.empty() ? "in a medium " : "inside of " + shapes + " ",
                       media.medium().ior);
}

}  // namespace

std::string plan(const Scene& scene, const PathOptions& path, const OptionalColumns* graph) {
    const SceneFeatures& f = scene.features;
    std::string on, off;
    const auto say = [&](bool yes, const char* what, const char* why) {
        (yes ? on : off) += fmt::format("{}{}{}", (yes ? on : off).empty() ? "" : ", ", what, yes ? "" : why);
    };
    say(true,
        path.roulette == Roulette::off
            ? "no roulette"
            : fmt::format("roulette by {} from depth {}", roulette_name(path.roulette), path.rr_depth).c_str(),
        "");
    say(!scene.emitters.empty(), "next-event estimation", " (no emitter)");
    say(scene.environment_idx >= 0, "environment", " (no emitter at infinity)");
    if (scene.nlos) {
        say(scene.nlos->laser_sampling,
            path.laser_spot == LaserSpot::unit_area ? "laser sampling (spot of unit area)"
                                                    : "laser sampling (spot of true area)",
            " (not requested)");
        say(scene.nlos->hidden_probability > 0,
            fmt::format("hidden geometry at {:.4g} % of the vertices", 100 * scene.nlos->hidden_probability).c_str(),
            " (not requested)");
    }
    if (graph) {
        say(f.smooth_normals, "geometric normals", " (all surfaces flat)");
        say(f.perturbed_normals, "unperturbed normals", " (no bump or normal map)");
        say(f.anisotropic, "tangents", " (nothing anisotropic)");
        say(f.textured_diffuse, "diffuse column", " (no texture)");
        say(f.textured_specular, "specular column", " (no texture)");
        say(f.textured_alpha, "roughness column", " (no texture)");
        say(f.textured_opacity, "opacity column", " (no texture)");
        if (f.textured_exponent) say(true, "exponent column", "");
        if (f.textured_index) say(true, "conductor index columns", "");
        say(f.dielectric, "index of refraction", " (no dielectric)");
        if (graph->media) say(f.dielectric, "materials of media", " (no dielectric)");
        if (graph->primitives) say(true, "triangles", "");
        if (!scene.sensor_media.vacuum) say(true, camera_medium(scene).c_str(), "");
    }
    return "on: " + on + "; off: " + (off.empty() ? "nothing" : off);
}

namespace {

void check_output(const Options& options, const std::string& ending) {
    if (options.output.empty()) throw InputError("--output: missing (a .h5 or .exr file)");
    if (ending != ".h5" && ending != ".exr")
        throw InputError(fmt::format("{}: the output must end in .h5 (path graph) or .exr (image)", options.output));
    if (options.passes > 1 && options.output.find('%') == std::string::npos)
        throw InputError(options.output + ": --passes needs a % in the name of the output, for the pass number");
    if (options.passes > 1 && options.first_sample % options.spp != 0)
        throw InputError(
            fmt::format("--first-sample {}: passes are numbered by it, so it must be a multiple of --spp {}",
                        options.first_sample, options.spp));
    check_output_path(options.output);
    if (options.frames.empty()) {
        if (!options.absent.empty() && options.static_frames.empty())
            throw InputError("--absent: needs --frames or --static");
        if (options.only.empty()) return;
        if (options.static_frames.empty()) throw InputError("--only: needs --frames or --static");
        if (options.passes > 1) throw InputError("--only: makes one graph of each frame; leave out --passes");
        if (options.output.find('%') == std::string::npos)
            throw InputError(fmt::format("{}: needs a % for the number of the frame", options.output));
        return;
    }
    if (!options.static_frames.empty()) throw InputError("--frames: traces whole scenes; leave out --static");
    if (ending != ".exr" || options.passes > 1)
        throw InputError("--frames: makes one image (.exr) of each frame; leave out --passes");
    if (options.output.find('%') == std::string::npos)
        throw InputError(fmt::format("{}: needs a % for the number of the frame", options.output));
}

/// Parameters that all passes share.
struct Passes {
    const Options& options;
    const Scene& scene;
    PathOptions path;
    std::string command, plan, ending;
    Cost loading;                                               // cost of reading the scene
    std::shared_ptr<Arena> memory = std::make_shared<Arena>();  // of a graph, reused by the next pass
};

/// Traces one pass into its file.
Counts trace_pass(const Passes& of, std::uint64_t pass, const std::string& output, app::Report& report) {
    const Options& options = of.options;
    Provenance provenance = report.provenance(
        options.seed, {{app::base_name(options.scene), content_hash_text(of.scene.content_hash)}}, of.plan);
    provenance.command = command_of_pass(options, of.command, pass);
    const Work work{options.first_sample + pass * options.spp, options.spp, options.threads};
    Counts counts;
    if (of.ending == ".exr") {
        Image image = render_image(of.scene, of.path, work, report, counts);
        image.scene = provenance.inputs[0];
        image.provenance = std::move(provenance);
        write_image(image, output);
        return counts;
    }
    PathGraphInPieces graph = render_graph(of.scene, of.path, work, report, counts, of.memory, options.columns);
    graph.provenance = std::move(provenance);
    write_path_graph(graph, output);
    std::uint64_t bytes = 0;
    for (const ColumnBytes& column : column_bytes(graph)) bytes += column.bytes;
    report.info("graph: {} vertices, {} light edges, {:.1f} bytes per vertex", graph.n_vertices(),
                graph.n_light_edges(), double(bytes) / double(std::max<std::size_t>(graph.n_vertices(), 1)));
    return counts;
}

/// Writes the cost of a pass beside its file; each pass has a share of the cost of reading the scene.
/// in:      before  cost of the stage before the pass
void finish_pass(const Passes& of, const std::string& output, const Counts& counts, const Cost& before,
                 app::Report& report) {
    const double n_passes = double(of.options.passes);
    Cost cost = report.cost(of.plan);
    cost.wall_s += of.loading.wall_s / n_passes - before.wall_s;
    cost.cpu_s += of.loading.cpu_s / n_passes - before.cpu_s;
    cost.load_s = of.loading.cpu_s / n_passes;
    cost.rays = counts.rays;
    cost.samples = of.scene.sensor.n_pixels() * of.options.spp;
    cost.sources = {of.options.scene};
    write_cost_of(output, cost, {});
    report.done("{}: {} paths, {} vertices, {} rays, {} samples not finite",
                std::filesystem::path(output).filename().string(), cost.samples, counts.vertices, counts.rays,
                counts.nonfinite);
}

/// in, out: of_frames  what is added to the plan
std::unique_ptr<Scene> load(const Options& options, std::string& of_frames) {
    const Defines defines = parse_defines(options.defines);
    if (options.static_frames.empty()) return load_scene(options.scene, defines, options.sensor);
    Animation animation =
        find_animation(options.scene, defines, options.sensor, read_frames(options.static_frames, options.absent));
    of_frames = "; " + animation.describe();
    return build_scene(std::move(animation.still));
}

/// Traces each frame as a scene of its own. A frame has the same bytes alone and among others.
void trace_frames(const Options& options, app::Report& report) {
    if (options.plan || !options.replay.empty())
        throw InputError("--frames: leave out --plan and --replay, or name a frame's values by -D");
    const Frames table = read_frames(options.frames, options.absent);
    const std::vector<Frames::Frame> frames = frames_of(table, options.only);
    const Defines defines = parse_defines(options.defines);
    const auto images = std::make_shared<TextureCache>();
    app::Progress progress(report, "frames", frames.size());
    Cost before = report.cost();
    for (const Frames::Frame& frame : frames) {
        Options own = options;
        own.only = fmt::format("{}:{}", frame.number, frame.number + 1);
        own.output = app::name_of_part(options.output, fmt::format("{:04}", frame.number));
        const auto scene =
            build_scene(read_frame(options.scene, table, frame, defines, options.sensor), {{}, {}, images});
        PathOptions path = path_options(options, *scene);
        path.seed = streams::frame(options.seed, frame.number);
        const Cost loaded = report.cost();
        Cost loading;
        loading.wall_s = loaded.wall_s - before.wall_s, loading.cpu_s = loaded.cpu_s - before.cpu_s;
        const Passes pass{own,
                          *scene,
                          path,
                          app::command_of_frame(report.command(), options.frames, options.only, own.only),
                          plan(*scene, path, nullptr),
                          ".exr",
                          loading};
        const Counts counts = trace_pass(pass, 0, own.output, report);
        finish_pass(pass, own.output, counts, loaded, report);
        before = report.cost();
        progress.add(1);
    }
}

/// Traces the static scene from the cameras of some frames. A view has the same bytes alone and among others.
void trace_views(const Options& options, const std::string& ending, app::Report& report) {
    if (options.plan || !options.replay.empty()) throw InputError("--only: leave out --plan and --replay");
    const Frames table = read_frames(options.static_frames, options.absent);
    const std::vector<Frames::Frame> frames = frames_of(table, options.only);
    const Defines defines = parse_defines(options.defines);
    Animation animation = find_animation(options.scene, defines, options.sensor, table, Cameras::each);
    const std::string of_frames = animation.describe();
    const std::unique_ptr<Scene> scene = build_scene(std::move(animation.still));
    for (const std::string& note : scene->notes) report.info("{}", note);
    Cost loading = report.cost();
    loading.wall_s /= double(frames.size()), loading.cpu_s /= double(frames.size());
    for (const Frames::Frame& frame : frames) {
        const Cost before = report.cost();
        set_camera(*scene, *animation.frames[frame.row].root);
        Options own = options;
        own.output = app::name_of_part(options.output, fmt::format("{:04}", frame.number));
        own.seed = streams::frame(options.seed, frame.number);
        const PathOptions path = path_options(own, *scene);
        const Passes view{
            own,
            *scene,
            path,
            app::command_of_part(report.command(), {{" --only " + options.only,
                                                     fmt::format(" --only {}:{}", frame.number, frame.number + 1)}}),
            plan(*scene, path, ending == ".h5" ? &options.columns : nullptr) + "; " + of_frames,
            ending,
            loading};
        finish_pass(view, own.output, trace_pass(view, 0, own.output, report), before, report);
    }
}

}  // namespace

void run(const Options& options, app::Report& report) {
    const std::string ending = std::filesystem::path(options.output).extension();
    if (!options.plan && options.replay.empty()) check_output(options, ending);
    if (!options.frames.empty()) {
        trace_frames(options, report);
        return;
    }
    if (!options.static_frames.empty() && !options.only.empty()) {
        trace_views(options, ending, report);
        return;
    }

    // Read the scene.
    std::string of_frames;
    const auto scene = load(options, of_frames);
    for (const std::string& note : scene->notes) report.info("{}", note);
    const PathOptions path = path_options(options, *scene);
    const std::string planned = plan(*scene, path, ending != ".exr" ? &options.columns : nullptr) + of_frames;
    if (!options.replay.empty()) {
        report.answer(replay(*scene, path, options.replay));
        return;
    }
    if (options.columns.misses && scene->nlos)
        throw InputError("--misses: an NLOS capture stores no failed light samples; leave out --misses");
    if (options.plan) {
        report.answer(planned + "\n");
        return;
    }
    report.info("plan: {}", planned);

    // Trace pass by pass.
    const Passes passes{options, *scene, path, report.command(), planned, ending, report.cost()};
    std::uint64_t n_nonfinite_passes = 0;
    for (std::uint64_t pass = 0; pass < options.passes; ++pass) {
        const Cost before = report.cost();
        const std::string output = output_of_pass(options, pass);
        try {
            const Counts counts = trace_pass(passes, pass, output, report);
            finish_pass(passes, output, counts, before, report);
        } catch (const NonfiniteError& kept) {
            // Keep the other passes.
            if (options.passes == 1) throw;
            report.error("{}", kept.what());
            ++n_nonfinite_passes;
        }
    }
    if (n_nonfinite_passes > 0)
        throw NonfiniteError(
            fmt::format("{} of {} passes hold values that are NaN or infinite", n_nonfinite_passes, options.passes));
}

}  // namespace loom::trace
