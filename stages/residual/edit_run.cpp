#include "stages/residual/edit_run.h"

#include <fmt/format.h>

#include <algorithm>

#include "formats/io/content_hash.h"
#include "formats/io/error.h"
#include "stages/core/app/report.h"
#include "stages/core/app/values.h"
#include "stages/core/edit/animation.h"
#include "stages/core/plot/false_colours.h"
#include "stages/core/sampling/streams.h"
#include "stages/residual/adaptive_pairs.h"
#include "stages/residual/chain_of_edits.h"
#include "stages/residual/control/coverage.h"
#include "stages/residual/sky_pair.h"

namespace loom::residual {
namespace {

constexpr const char* rgb[] = {"R", "G", "B"};

}  // namespace

bool says_its_noise(const Image& image) {
    return std::none_of(std::begin(rgb), std::end(rgb),
                        [&](const char* c) { return image.find(std::string("VarMean.") + c).empty(); });
}

Method planned_method(const Options& options) {
    return options.old_graph.empty() && !(options.extra > 0) ? options.method : Method::correlated;
}

void report_edit(const Edit& edit, app::Report& report) {
    for (const std::string& note : edit.notes) report.info("{}", note);
    if (edit.nothing()) report.info("edit: nothing differs");
    for (const std::string& line : edit.changes) report.info("edit: {}", line);
}

namespace {

/// Reads an image with variance and the film of a scene.
/// in:      writers      programs that write such images, as text
///          or_denoised  accept a denoised image without variance
Image read_noisy_picture(const std::string& file, const Scene& scene, const std::string& scene_name,
                         const char* writers, bool or_denoised = false) {
    Image image = read_image(file);
    if (image.width != scene.sensor.width || image.height != scene.sensor.height)
        throw InputError(fmt::format("{}: is {} x {}, but the film of {} has {} x {} pixels", file, image.width,
                                     image.height, scene_name, scene.sensor.width, scene.sensor.height));
    if (!says_its_noise(image) && !(or_denoised && image.provenance.stage == "loom-denoise"))
        throw InputError(fmt::format("{}: has no variance (channels VarMean.R, G, B); {} write them", file, writers));
    return image;
}

/// Reads the old image and checks that it shows the old scene, if the image stores its scene.
Image read_old_picture(const std::string& file, const Scene& old_scene, const std::string& scene_name,
                       app::Report& report) {
    Image image = read_noisy_picture(file, old_scene, scene_name, "loom-trace -o x.exr and loom-merge");
    if (image.samples < 2)
        throw InputError(
            fmt::format("{}: has no variance (samples per pixel: {}; VarMean needs two)", file, image.samples));
    if (image.ledger.size() == 1)
        throw InputError(fmt::format("{}: is a residual, not an image of {}; --new writes one", file, scene_name));
    // Images from before images stored their scene.
    if (image.scene.hash.empty() && image.provenance.stage == "loom-trace" && !image.provenance.inputs.empty())
        image.scene = image.provenance.inputs[0];
    const std::string hash = content_hash_text(old_scene.content_hash);
    if (image.scene.hash.empty())
        report.info("{}: names no scene and is taken for an image of {}", file, scene_name);
    else if (image.scene.hash != hash)
        throw InputError(fmt::format(
            "{}: is an image of {} with content {}, not of {} with these values, whose content is {}; {}", file,
            image.scene.name, image.scene.hash, scene_name, hash,
            image.ledger.empty() ? "trace it again"
                                 : "as the old scene, give the new scene of the edit before, with its values"));
    return image;
}

/// Returns the index of the named family among those that an edit requires.
std::size_t family_of(const std::string& name, const std::vector<Family>& families) {
    const auto found =
        std::find_if(families.begin(), families.end(), [&](const Family& family) { return family.name == name; });
    if (found != families.end()) return std::size_t(found - families.begin());
    std::vector<const char*> names;
    for (const Family& family : families) names.push_back(family.name);
    throw InputError(
        fmt::format("--technique {}: unknown; the techniques of this edit are {}", name, fmt::join(names, ", ")));
}

/// Reads an existing residual with its link, and checks that it leads to the new scene, if the residual stores its
/// scene.
Image read_residual(const std::string& file, const Scene& new_scene, const std::string& scene_name) {
    Image image =
        read_noisy_picture(file, new_scene, scene_name, "loom-residual and loom-merge of two or more passes", true);
    if (!image.scene.hash.empty())
        throw InputError(fmt::format("{}: is an image of {}, not a residual", file, image.scene.name));
    image.ledger = {link_of_residual(image)};
    if (image.ledger[0].method == part_method)
        throw InputError(fmt::format("{}: holds the paths of one technique only, not a whole residual", file));
    const InputId& leads_to = image.ledger[0].scene;
    const std::string hash = content_hash_text(new_scene.content_hash);
    if (!leads_to.hash.empty() && leads_to.hash != hash)
        throw InputError(
            fmt::format("{}: leads to {} with content {}, not to {} with these values, whose content is {}", file,
                        leads_to.name, leads_to.hash, scene_name, hash));
    return image;
}

/// in:      old_picture  null, or the control variate of the new image
///          plan         distribution of the effort of the added samples
Image render_by_dynamic_paths(const ScenePair& scenes, const Edit& edit, const Options& options,
                              const PathOptions& path, const Image* old_picture, app::Report& report, Counts& counts,
                              std::string& plan, std::optional<ControlledPicture>& controlled) {
    if (scenes.old_scene.nlos || scenes.new_scene.nlos)
        throw InputError("NLOS captures have no dynamic paths; give --method correlated");
    DynamicOptions dynamic;
    dynamic.pairs.mapping = !options.no_mapping;
    dynamic.pairs.limits.d_min = 0.01f * scenes.new_scene.radius;
    dynamic.pilot = options.method == Method::automatic;
    dynamic.adaptive_map = !options.no_map;
    dynamic.old_picture = options.mask == Mask::none ? nullptr : old_picture;
    dynamic.pairs.as_printed = options.as_printed;
    if (options.as_printed)
        plan +=
            "; as printed in [RP]: both paths of a pair with the weight of the one found, mappings limited one way: "
            "biased";
    if (!options.technique.empty()) {
        dynamic.only_family =
            int(family_of(options.technique, families_of(DynamicScenes(scenes.old_scene, scenes.new_scene, edit))));
        dynamic.weighted = !options.raw;
        plan += fmt::format(
            "; a part of it: only paths found by {}, {}", options.technique,
            options.raw ? "raw: over the density of that technique alone" : "weighted against all techniques");
    }
    DynamicCounts counted;
    Image image = render_dynamic(scenes, edit, dynamic, path, {options.first_sample, options.spp, options.threads},
                                 report, counted);
    counts = counted.counts;
    if (!counted.effort.empty()) plan += "; " + counted.effort;
    if (counts.nonfinite > 0) report.warn("{} paths are not finite and left out", counts.nonfinite);
    if (counted.n_unrelocated > 0)
        report.info("{} samples of ghosts cannot be reached along their segment (coincident surfaces)",
                    counted.n_unrelocated);
    if (counted.controlled) {
        const std::string weights = fmt::format("weight of the old image {:.3g} to {:.3g}", counted.controlled->least,
                                                counted.controlled->most);
        report.info("{}", weights);
        plan += "; " + weights;
        controlled = std::move(counted.controlled);
    }
    image.ledger = {link_of_residual(image)};
    image.ledger[0].method = options.technique.empty() ? method_name(options.method) : part_method;
    image.ledger[0].seed = path.seed;
    image.ledger[0].var_sample = counted.var_sample;
    return image;
}

std::string text_of(const Edit& edit) {
    return edit.nothing() ? "nothing differs" : fmt::format("{}", fmt::join(edit.changes, "; "));
}

PathOptions path_options(const Options& options, const Scene& new_scene, const Ledger& before) {
    PathOptions path;
    path.seed = streams::edit(options.seed, std::max<std::size_t>(before.size(), 1));
    path.rr_depth = new_scene.rr_depth;
    path.max_depth = options.max_depth.value_or(new_scene.max_depth);
    return path;
}

/// Traces pairs of paths on top of those of a graph.
ExtraPairs add_extra_pairs(EditRun& run, const Base& base, const ControlSums* control, app::Report& report) {
    const Options& options = run.options;
    const Scenes& scenes = run.scenes;
    Residual& residual = run.residual;
    if (scenes.new_scene->nlos) throw InputError("--extra: not for NLOS captures");
    if (residual.same_samples)
        throw InputError(fmt::format(
            "{}: has the samples of the graph, to which --extra adds others; give an image with another --seed",
            options.old_picture));
    AdaptiveOptions adaptive{options.extra, false, base.graph.path, options.threads};
    adaptive.path.seed = streams::extra(adaptive.path.seed);
    ExtraPairs extra =
        trace_extra_pairs(scenes.pair(), run.edit, adaptive, residual.image, base.graph.spp, control, report);
    residual.counts.add(extra.counts);
    residual.n_extra = extra.n;
    residual.plan += "; " + extra.summary;
    report.info("{}", extra.summary);
    return extra;
}

/// Takes what the old graph's pairs of paths say.
void take_pairs(EditRun& run, const Base& base, GraphResidual pairs, app::Report& report) {
    const Options& options = run.options;
    const Scenes& scenes = run.scenes;
    Residual& residual = run.residual;
    std::optional<ControlSums>& control = run.control;
    residual.of_graph = std::move(pairs);
    residual.image = residual.of_graph.image;
    residual.counts = residual.of_graph.counts;
    residual.plan += "; old graph: " + residual.of_graph.summary();
    report.info("old graph: {}", residual.of_graph.summary());
    if (!run.seen.empty()) {
        run.seen.add_to(residual.image);
        residual.image.ledger.back().var_mean = mean_var_mean(residual.image);
        residual.counts.rays += run.seen.n_rays();
        const std::string seen =
            fmt::format("emission that the camera sees by rays of its own in {} pixels", run.seen.n_pixels());
        report.info("{}", seen);
        residual.plan += "; " + seen;
    }
    std::vector<float> covered;
    if (control && options.mask == Mask::coverage)
        for (const Spectrum& alpha : control->alpha) covered.push_back(1 - alpha.r);
    // By weights before they are fitted to samples.
    ControlSums* const weights_of_old = control ? &*control : nullptr;
    std::optional<ExtraPairs> extra;
    if (options.extra > 0) extra = add_extra_pairs(run, base, weights_of_old, report);
    if (control && control->fits) control->fit(scenes.new_scene->sensor, base.image.samples);
    if (extra) add_pairs(extra->sums, base.graph.spp, residual.image, weights_of_old);
    if (control) {
        residual.controlled = controlled_picture(base.image, residual.image, *control, &run.seen);
        if (!covered.empty()) std::ranges::copy(covered, residual.controlled->image.add("Coverage.A").begin());
        const auto n_below =
            std::count_if(control->alpha.begin(), control->alpha.end(), [](const Spectrum& a) { return a.r < 1; });
        const std::string weights =
            control->fits ? fmt::format("weight of the old image {:.3g} to {:.3g}, as lights differ",
                                        residual.controlled->least, residual.controlled->most)
            : options.mask == Mask::first_hit
                ? fmt::format(
                      "weight of the old image 0 in {} pixels, where the first hit of a sample differs: biased at "
                      "edges, as requested",
                      n_below)
                : fmt::format("weight of the old image below 1 in {} pixels, where first hits differ", n_below);
        report.info("{}", weights);
        residual.plan += "; " + weights;
    }
    if (options.mask == Mask::none && !options.new_picture.empty())
        residual.plan += "; weight of the old image 1, as requested";
    if (residual.same_samples)
        report.info("{}: has the samples of the graph, so the sum is the new scene's image of these samples",
                    options.old_picture);
}

/// Renders a residual of --extra pairs alone.
void render_by_sparse_pairs(EditRun& run, const Base& base, app::Report& report) {
    const Options& options = run.options;
    const Scenes& scenes = run.scenes;
    Residual& residual = run.residual;
    if (scenes.new_scene->nlos) throw InputError("--extra: not for NLOS captures");
    AdaptiveOptions adaptive{options.extra, options.no_map, residual.path, options.threads};
    adaptive.path.seed = streams::extra(residual.path.seed);
    if (!options.frames.empty()) adaptive.path.seed = streams::frame(adaptive.path.seed, options.frame);
    std::optional<ControlSums> control;
    if (!options.new_picture.empty()) {
        const EditReach reach(*scenes.old_scene, *scenes.new_scene, run.edit);
        if (options.mask == Mask::coverage)
            control = graph_control(scenes.pair(), reach, adaptive.path.seed, options.threads);
        if (!control) control.emplace(std::vector<Spectrum>(scenes.new_scene->sensor.n_pixels(), Spectrum(1)));
    }
    SparseResidual sparse = render_sparse_residual(scenes.pair(), run.edit, adaptive,
                                                   control ? control->alpha : std::vector<Spectrum>{}, report);
    residual.image = std::move(sparse.image);
    residual.counts = sparse.counts;
    residual.n_extra = sparse.n;
    residual.plan += "; " + sparse.summary;
    report.info("{}", sparse.summary);
    if (!control) return;
    residual.controlled = controlled_picture(base.image, sparse.weighted, *control);
    if (options.mask != Mask::coverage) return;
    const auto covered = residual.controlled->image.add("Coverage.A");
    for (std::size_t p = 0; p < covered.size(); ++p) covered[p] = 1 - control->alpha[p].r;
}

/// Checks that the random streams of a residual differ from those of the old image, or are the same samples.
/// in, out: residual  path is set
void check_streams(const Options& options, const Base& base, Residual& residual) {
    const bool has_graph = !options.old_graph.empty();
    if (has_graph) {
        residual.path.seed = base.graph.path.seed;
        residual.same_samples = !options.old_picture.empty() && base.image.ledger.empty() &&
                                same_samples(base.image, options.old_picture, base.graph);
    }
    if (residual.existed)
        check_numbers(base.ledger, residual.image.ledger[0].method, residual.image.ledger[0].seed);
    else if (!residual.same_samples)
        check_numbers(base.ledger, has_graph ? old_graph_method : method_name(options.method), residual.path.seed);
}

/// Gives the skies of two scenes light samples in common where that leaves less noise.
/// in:      keeps_old  the old scene's paths exist already
/// in, out: new_scene  that of `scenes`
void pair_skies(const Edit& edit, bool keeps_old, Scene& new_scene, app::Report& report, Scenes& scenes,
                std::string& plan) {
    const int sky = scenes.old_scene->environment_idx;
    if (sky < 0 || !edit.old_emitters[std::size_t(sky)].changed) return;
    const SkyPair pair = find_sky_pair(*scenes.old_scene, *scenes.new_scene);
    if (pair.shared) {
        new_scene.emitters[std::size_t(new_scene.environment_idx)].proposals = pair.shared;
        if (!keeps_old) scenes.old_scene = with_proposals(*scenes.old_scene, pair.shared);
    }
    if (const std::string text = pair.describe(); !text.empty()) {
        report.info("{}", text);
        plan += "; " + text;
    }
}

/// Stores the inputs and settings of the residual in it.
/// in:      command  that makes it alone
void label_residual(const Options& options, const Scenes& scenes, const Edit& edit, const OldGraph& graph,
                    const std::string& command, const app::Report& report, Residual& residual) {
    Image& image = residual.image;
    const std::string how = residual.existed ? image.provenance.plan : residual.plan;
    const std::uint64_t seed = residual.existed             ? image.provenance.seed
                               : !options.old_graph.empty() ? residual.path.seed
                                                            : options.seed;
    std::vector<InputId> inputs{{scenes.old_name, content_hash_text(scenes.old_scene->content_hash)},
                                {scenes.new_name, content_hash_text(scenes.new_scene->content_hash)}};
    for (std::size_t i = 0; i < graph.passes.size(); ++i)
        inputs.push_back(identify_by_header(graph.passes[i], graph.files[i]));
    image.provenance = report.provenance(
        seed, std::move(inputs), how.starts_with("edit: ") ? how : fmt::format("edit: {}; {}", text_of(edit), how));
    image.provenance.command = command;
    image.ledger.back().what = text_of(edit);
    image.ledger.back().scene = image.provenance.inputs[1];
}

Cost cost_of(const EditRun& run, const app::Report& report) {
    const Residual& residual = run.residual;
    Cost cost = report.cost(residual.image.provenance.plan);
    cost.wall_s = run.job.share * run.job.loading.wall_s + run.spent.wall_s;
    cost.cpu_s = run.job.share * run.job.loading.cpu_s + run.spent.cpu_s;
    cost.load_s = run.job.share * run.job.loading.cpu_s + residual.load_s;
    cost.rays = residual.counts.rays;
    cost.samples = residual.existed                 ? 0
                   : !run.options.old_graph.empty() ? residual.of_graph.touched + residual.n_extra
                   : run.options.extra > 0          ? residual.n_extra
                                                    : run.scenes.new_scene->sensor.n_pixels() * run.options.spp;
    cost.sources = {run.scenes.old_name};
    if (run.scenes.new_name != run.scenes.old_name) cost.sources.push_back(run.scenes.new_name);
    return cost;
}

/// Returns the image of the new scene; a weighted one is moved out of the residual.
Image new_image(const Options& options, const Image& old_picture, Residual& residual) {
    Image sum = residual.controlled     ? take_controlled(old_picture, residual.image, std::move(*residual.controlled))
                : residual.same_samples ? add_residual_of_same_samples(old_picture, residual.image, residual.of_graph)
                                        : add_residual(old_picture, residual.image);
    // They are of the residual.
    std::erase_if(sum.channels, [](const Image::Channel& channel) {
        return channel.name.starts_with("Plus.") || channel.name.starts_with("Minus.");
    });
    sum.provenance.inputs.push_back(identify(options.old_picture));
    if (residual.existed) sum.provenance.inputs.push_back(identify(options.residual));
    return sum;
}

/// Writes the outputs.
/// out:     name of the last file that has a cost
std::string write_outputs(const Options& options, const Image& old_picture, const Cost& cost, app::Report& report,
                          Residual& residual) {
    std::string last_output;
    const auto write = [&](const Image& image, const std::string& file, std::vector<std::string> parents) {
        write_image(image, file);
        parents.insert(parents.end(), options.old_graph.begin(), options.old_graph.end());
        write_cost_of(file, cost, parents);
        last_output = file;
    };
    if (!options.output.empty()) write(residual.image, options.output, {});
    if (!options.residual_png.empty()) write_png(false_colours(residual.image, "", 0), options.residual_png);
    if (options.new_picture.empty()) return last_output;
    const Image sum = new_image(options, old_picture, residual);
    residual.ledger_of_sum = sum.ledger;
    // Frames are no chain of edits.
    if (!sum.ledger.empty() && options.frames.empty()) say_standing(sum.ledger, options, report);
    // The new image carries the cost of this run, whether or not the residual is stored.
    write(sum, options.new_picture, {options.old_picture, options.residual});
    if (!options.png.empty()) write_png(sum, options.png);
    return last_output;
}

}  // namespace

KnownParts parts_known_of(const Base& base, const Edit& edit, const SceneDescription& new_scene) {
    if (!base.fixed) return known_parts(base.scene, edit);
    return known_parts(base.fixed, find_edit(*base.fixed_description, new_scene));
}

Base read_base(const Options& options, SceneDescription description, int max_depth, app::Report& report,
               std::optional<SceneDescription> fixed) {
    Base base;
    base.description = description;
    KnownParts known;
    if (fixed) {
        base.fixed_description = fixed;
        base.fixed = build_scene(std::move(*fixed), {{}, {}, base.images});
        known = known_parts(base.fixed, find_edit(*base.fixed_description, description));
    }
    known.images = base.images;
    base.scene = build_scene(std::move(description), known);
    base.name = app::base_name(options.old_scene);
    if (!options.old_picture.empty()) {
        base.image = read_old_picture(options.old_picture, *base.scene, base.name, report);
        base.ledger = ledger_of(base.image);
    }
    if (options.old_graph.empty()) return base;
    base.graph = read_old_graph(options.old_graph, *base.scene, base.name, max_depth);
    if (!options.new_picture.empty() && base.graph.spp < 2)
        throw InputError(
            fmt::format("{}: one sample per pixel has no variance, which --new must store; at least 2 are needed",
                        options.old_graph[0]));
    return base;
}

std::unique_ptr<EditRun> start_edit(Options options, const Base& base, EditJob job, Edit edit, app::Report& report) {
    auto run = std::make_unique<EditRun>(
        EditRun{std::move(options), std::move(job), std::move(edit), {}, {}, {}, {}, {}, {}, {}});
    const bool has_graph = !run->options.old_graph.empty();
    Residual& residual = run->residual;
    residual.plan = plan_of(planned_method(run->options), run->edit);
    report_edit(run->edit, report);
    if (run->options.residual.empty()) report.info("plan: {}", residual.plan);

    // Build the new scene.
    const double before_s = report.cost().cpu_s;
    run->job.known.images = base.images;
    Scenes& scenes = run->scenes;
    const std::shared_ptr<Scene> built = build_scene(std::move(run->job.description), run->job.known);
    scenes = {base.scene, built, base.name, app::base_name(run->job.file)};
    residual.load_s = report.cost().cpu_s - before_s;
    for (const std::string& note : scenes.new_scene->notes) report.info("{}", note);

    // Check its random streams, and prepare its pairs of paths.
    residual.path = path_options(run->options, *scenes.new_scene, base.ledger);
    residual.existed = !run->options.residual.empty();
    if (residual.existed) residual.image = read_residual(run->options.residual, *scenes.new_scene, scenes.new_name);
    check_streams(run->options, base, residual);
    // What both skies' light samples have in common has no parts.
    if (!residual.existed && !residual.same_samples && !run->options.parts &&
        (run->options.method == Method::correlated || run->options.method == Method::automatic))
        pair_skies(run->edit, has_graph && !(run->options.extra > 0), *built, report, scenes, residual.plan);
    if (has_graph || run->options.parts)
        run->reach = std::make_unique<EditReach>(*scenes.old_scene, *scenes.new_scene, run->edit);
    if (run->options.parts) {
        if (scenes.old_scene->nlos || scenes.new_scene->nlos) throw InputError("--parts: NLOS captures have none");
        run->parts = std::make_unique<PartSums>(scenes.pair(), *run->reach, run->edit);
        residual.plan += "; parts: Plus - Minus";
    }
    if (!has_graph) return run;
    if (!residual.same_samples && !run->options.parts && !(run->options.extra > 0) && !scenes.new_scene->nlos &&
        residual.path.max_depth != 0)
        run->seen =
            SeenEmission(scenes.pair(), *run->reach, base.graph.path.seed, base.graph.spp, run->options.threads);
    // With the graph's own samples any weight makes the same image.
    if (!run->options.new_picture.empty() && run->options.mask != Mask::none && !residual.same_samples &&
        !scenes.new_scene->nlos)
        run->control = run->options.mask == Mask::coverage
                           ? graph_control(scenes.pair(), *run->reach, base.graph.path.seed, run->options.threads)
                           : first_hit_control(scenes.pair(), *run->reach, base.graph.path.sampler,
                                               base.graph.path.seed, base.graph.samples(), run->options.threads);
    return run;
}

GraphJob graph_job(EditRun& run, const Base& base) {
    return {*run.scenes.new_scene,
            *run.reach,
            run.residual.same_samples ? &base.image : nullptr,
            run.control ? &*run.control : nullptr,
            run.parts.get(),
            &run.seen};
}

namespace {

void make_residual(EditRun& run, const Base& base, std::optional<GraphResidual> pairs, app::Report& report) {
    const Options& options = run.options;
    Residual& residual = run.residual;
    if (residual.existed) return;
    if (pairs) return take_pairs(run, base, std::move(*pairs), report);
    if (options.extra > 0) return render_by_sparse_pairs(run, base, report);
    if (options.method == Method::automatic || options.method == Method::dynamic)
        residual.image = render_by_dynamic_paths(run.scenes.pair(), run.edit, options, residual.path,
                                                 options.new_picture.empty() ? nullptr : &base.image, report,
                                                 residual.counts, residual.plan, residual.controlled);
    else
        residual.image = render_residual(run.scenes.pair(), options.method, residual.path,
                                         {options.first_sample, options.spp, options.threads}, report, residual.counts,
                                         run.parts.get());
}

}  // namespace

void finish_edit(EditRun& run, const Base& base, std::optional<GraphResidual> pairs, app::Report& report) {
    const Options& options = run.options;
    Residual& residual = run.residual;
    const Cost before = report.cost();
    make_residual(run, base, std::move(pairs), report);
    label_residual(options, run.scenes, run.edit, base.graph, run.job.command, report, residual);
    run.spent.add(before, report.cost());
    const Cost cost = cost_of(run, report);
    const std::string last_output = write_outputs(options, base.image, cost, report, residual);
    report.done("{}: {} pairs of paths, {} vertices, {} rays, {} samples not finite", app::base_name(last_output),
                cost.samples, residual.counts.vertices, residual.counts.rays, residual.counts.nonfinite);
}

void render_edit(const Options& options, const Base& base, EditJob job, const Edit& edit, app::Report& report) {
    const auto run = start_edit(options, base, std::move(job), edit, report);
    std::optional<GraphResidual> pairs;
    if (!options.old_graph.empty()) {
        const GraphJob of_graph = graph_job(*run, base);
        pairs = std::move(render_residuals(*base.scene, {&of_graph, 1}, base.graph, options.threads, report)[0]);
    }
    run->spent.add(run->job.loading, report.cost());
    finish_edit(*run, base, std::move(pairs), report);
}

}  // namespace loom::residual
