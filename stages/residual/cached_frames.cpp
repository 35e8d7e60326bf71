#include "stages/residual/cached_frames.h"

#include <fmt/format.h>

#include <filesystem>

#include "formats/io/content_hash.h"
#include "formats/io/cost.h"
#include "formats/io/error.h"
#include "formats/io/output_file.h"
#include "stages/core/app/command.h"
#include "stages/core/edit/animation.h"
#include "stages/core/sampling/streams.h"
#include "stages/core/scene/build.h"
#include "stages/residual/cached_estimator.h"
#include "stages/residual/edit_run.h"
#include "stages/residual/two_level.h"

namespace loom::residual {
namespace {

/// Share of far queries from which on a frame warns.
constexpr double most_far = 0.05;

void check(const Options& options) {
    const auto refuse = [](const char* flag, const char* why) {
        throw InputError(fmt::format("{}: has no use with --cache, {}", flag, why));
    };
    if (!options.old_picture.empty()) refuse("--old", "which stands for the image of the static scene");
    if (!options.old_graph.empty()) refuse("--old-graph", "whose camera may be another one");
    if (!options.output.empty()) refuse("-o", "whose frames are no sums of images; give --new");
    if (!options.residual_png.empty()) refuse("--residual-png", "whose frames are no sums of images");
    if (options.method != Method::automatic && options.method != Method::correlated)
        refuse("--method", "whose pairs are correlated");
    if (options.plan) return;
    if (options.new_picture.empty()) throw InputError("--new: missing (an .exr file with a % for the frame's number)");
    if (options.spp < 2)
        throw InputError("--spp 1: one sample has no variance, which --new must store; give at least 2");
}

std::string plan_of_frame(const RadianceCache& cache, const Edit& edit, std::optional<double> share) {
    if (share)
        return fmt::format(
            "on: paths that end in the radiance cache of the static scene ({}) at their second vertex, {:.3g} % of "
            "them "
            "traced on to correct it: unbiased; off: the cache at what the camera sees (less noise, biased), image and "
            "graph of the static scene",
            cache.settings.method, 100 * *share);
    return fmt::format(
        "on: radiance cache of the static scene ({}), biased: see CacheError; {}; off: image and graph of the static "
        "scene",
        cache.settings.method,
        edit.nothing()
            ? "nothing moves, so paths are traced only where the cache cannot be trusted"
            : "plus pairs of paths with the same random numbers; without the cache where the camera sees what "
              "moves, and where it cannot be trusted");
}

std::string summary(const CachedCounts& counted, bool with_pairs, bool is_corrected) {
    const auto percent = [](std::uint64_t a, std::uint64_t b) {
        return 100 * double(a) / double(std::max<std::uint64_t>(b, 1));
    };
    const double far = percent(counted.far, counted.queries);
    if (is_corrected)
        return fmt::format(
            "{:.3g} % of the paths come to the cache, {:.3g} % of these are traced on; {:.3g} % of the queries far "
            "from "
            "all points",
            percent(counted.queries, counted.samples), percent(counted.traced_on, counted.queries), far);
    std::string text = fmt::format("{:.3g} % of the queries far from all points, {:.3g} % not trusted and path-traced",
                                   far, percent(counted.untrusted, counted.queries));
    if (with_pairs)
        text += fmt::format(
            "; {:.3g} % of the samples see what moves, {:.3g} % of the paths are touched; cache against the "
            "frame's own paths: mean {:+.2g} %, error {:.2g} %",
            percent(counted.masked, counted.samples), percent(counted.touched, counted.samples), 100 * counted.bias,
            100 * counted.error);
    return text;
}

}  // namespace

void render_cached_frames(const Options& options, app::Report& report) {
    check(options);
    const Frames table = read_frames(options.frames, options.absent);
    const std::vector<Frames::Frame> frames = frames_of(table, options.only);
    Animation animation =
        find_animation(options.old_scene, parse_defines(options.defines), options.sensor, table, Cameras::each);
    RadianceCache file = read_radiance_cache(options.cache);
    if (options.plan) {
        report.answer(fmt::format("{}\n{}\n", animation.describe(), plan_of_frame(file, Edit(), options.correct)));
        return;
    }
    report.info("{}", animation.describe());

    // Read what all frames share.
    const InputId cache_id = identify(options.cache);
    const std::string name = app::base_name(options.old_scene);
    const auto images = std::make_shared<TextureCache>();
    const std::shared_ptr<Scene> still = build_scene(SceneDescription(animation.still), {{}, {}, images});
    require_scene_of(file, options.cache, *still, name);
    if (file.validation.material.size() != still->materials.size())
        throw InputError(fmt::format("{}: validation/material has {} rows, but {} has {} materials", options.cache,
                                     file.validation.material.size(), name, still->materials.size()));
    const std::unique_ptr<CacheReader> cache = make_cache_reader(std::move(file));
    const Cost loading = report.cost();
    app::Progress progress(report, "frames", frames.size());
    for (const Frames::Frame& frame : frames) {
        const Cost before = report.cost();
        const std::string number = fmt::format("{:04}", frame.number);
        const std::string output = app::name_of_part(options.new_picture, number);
        Options own = options;
        own.only = fmt::format("{}:{}", frame.number, frame.number + 1);
        own.new_picture = output;
        own.png = app::name_of_part(options.png, number);
        check_output_path(output);

        // Point the camera of both scenes.
        SceneDescription description = std::move(animation.frames[frame.row]);
        const Edit edit = find_edit(with_camera_of(animation.still, description), description);
        set_camera(*still, *description.root);
        std::shared_ptr<const Scene> now = still;
        if (!edit.nothing()) {
            KnownParts known = known_parts(still, edit);
            known.images = images;
            now = build_scene(std::move(description), known);
        }
        const double load_s = report.cost().cpu_s - before.cpu_s;

        // Render.
        PathOptions path;
        path.seed = streams::frame(streams::residual(options.seed), frame.number);
        path.rr_depth = now->rr_depth;
        path.max_depth = options.max_depth.value_or(now->max_depth);
        CachedCounts counted;
        const ScenePair scenes{*still, *now};
        const Work work{options.first_sample, options.spp, options.threads};
        Image image = options.correct
                          ? render_corrected(scenes, edit, *cache, *options.correct, path, work, report, counted)
                          : render_cached(scenes, edit, *cache, {}, path, work, report, counted);
        const std::string found = summary(counted, !edit.nothing(), options.correct.has_value());
        report.info("frame {}: {}", frame.number, found);
        if (!options.correct && double(counted.far) > most_far * double(counted.queries))
            report.warn(
                "frame {}: {:.3g} % of the queries are far from all points of {}, so they are path-traced, with more "
                "noise; add a view of the frame to the cache: loom-trace {} --static {} --only {} --spp 4 -o "
                "view-%.h5, "
                "then loom-cluster, loom-refine and loom-learn (make animation: CACHE_VIEWS)",
                frame.number, 100 * double(counted.far) / double(counted.queries), app::base_name(options.cache), name,
                app::base_name(options.frames), own.only);

        // Write.
        image.scene = {name, content_hash_text(now->content_hash)};
        image.provenance = report.provenance(options.seed, {image.scene, cache_id},
                                             plan_of_frame(cache->cache(), edit, options.correct) + "; " + found);
        image.provenance.command = app::command_of_frame(report.command(), options.frames, options.only, own.only);
        write_image(image, output);
        if (!own.png.empty()) write_png(image, own.png);
        Cost cost = report.cost(image.provenance.plan);
        const double share = 1 / double(frames.size());
        cost.wall_s += share * loading.wall_s - before.wall_s;
        cost.cpu_s += share * loading.cpu_s - before.cpu_s;
        cost.load_s = share * loading.cpu_s + load_s;
        cost.rays = counted.counts.rays;
        cost.samples = counted.samples;
        cost.sources = {options.old_scene};
        write_cost_of(output, cost, {options.cache});
        report.done("{}: {} samples, {} rays, {} samples not finite", std::filesystem::path(output).filename().string(),
                    counted.samples, counted.counts.rays, counted.counts.nonfinite);
        progress.add(1);
    }
}

}  // namespace loom::residual
