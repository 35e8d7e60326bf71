#include "stages/residual/residual.h"

#include <fmt/format.h>

#include <algorithm>
#include <filesystem>

#include "formats/io/error.h"
#include "stages/core/app/command.h"
#include "stages/core/app/values.h"
#include "stages/core/scene/build.h"
#include "stages/residual/chain_of_edits.h"
#include "stages/residual/edit_run.h"
#include "stages/residual/frames.h"
#include "stages/residual/two_level.h"

namespace loom::residual {
namespace {

constexpr const char* rgb[] = {"R", "G", "B"};

Defines both(const std::vector<std::string>& common, const std::vector<std::string>& own) {
    std::vector<std::string> all = common;
    all.insert(all.end(), own.begin(), own.end());
    return parse_defines(all);
}

}  // namespace

void check_endings(const Options& options) {
    const auto check = [](const std::string& flag, const std::string& file, const char* ending) {
        if (file.empty()) return;
        if (std::filesystem::path(file).extension() != ending)
            throw InputError(fmt::format("{}: {} must end in {}", file, flag, ending));
        check_output_path(file);
    };
    check("-o", options.output, ".exr");
    check("--new", options.new_picture, ".exr");
    check("--png", options.png, ".png");
    check("--residual-png", options.residual_png, ".png");
    if (!options.technique.empty() && options.method != Method::dynamic)
        throw InputError("--technique: needs --method dynamic");
    if (!options.technique.empty() && !options.new_picture.empty())
        throw InputError(
            "--technique: its paths are only a part of the residual and give no image of the new scene; leave out "
            "--new");
    if (options.as_printed && (options.method != Method::dynamic || options.no_mapping || !options.technique.empty()))
        throw InputError("--as-printed: needs --method dynamic, without --no-mapping or --technique");
    if (options.raw && options.technique.empty()) throw InputError("--raw: needs --technique");
    if (options.extra > 0 && options.method != Method::automatic && options.method != Method::correlated)
        throw InputError(
            "--extra: its pairs have the same random numbers in both scenes; give --method correlated or auto");
    if (options.extra > 0 && (options.parts || !options.residual.empty()))
        throw InputError("--extra: leave out --parts and --residual");
    if (options.parts && options.old_graph.empty() && options.method != Method::correlated)
        throw InputError(
            "--parts: needs pairs of paths with the same random numbers; give --old-graph or --method correlated");
    if (options.mask == Mask::first_hit && options.old_graph.empty())
        throw InputError("--mask first-hit: is by the first hits of a graph's samples; give --old-graph");
    if (options.parts && options.output.empty())
        throw InputError("--parts: Plus and Minus are layers of the residual; give -o");
    if (!options.residual.empty() && !options.output.empty())
        throw InputError(fmt::format("-o: the residual exists already, {}; give --new instead", options.residual));
    if (options.output.empty() && options.new_picture.empty())
        throw InputError("-o: missing (an .exr file), or --new with --old");
    if (!options.png.empty() && options.new_picture.empty())
        throw InputError("--png: is a preview of the new image; give --new and --old");
    if (!options.new_picture.empty() && options.old_picture.empty())
        throw InputError("--new: is the sum of the residual and the old image; give --old");
    if (!options.old_graph.empty() && !options.residual.empty())
        throw InputError("--old-graph: has no use with --residual, which traces nothing; leave out one of them");
    if (!options.old_graph.empty() && options.method != Method::automatic && options.method != Method::correlated)
        throw InputError(
            "--old-graph: its paths are traced again with the same random numbers; give --method correlated or auto");
    if (!options.new_picture.empty() && options.residual.empty() && options.old_graph.empty() && options.spp < 2)
        throw InputError("--spp 1: one sample has no variance, which --new must store; give at least 2");
}

void declare(app::Command& command, Options& options) {
    command.file("old", options.old_scene, "scene before the edit (Mitsuba XML, dialects 0.5 to 3)").required();
    command.file("new", options.new_scene, "scene after the edit (default: the same file, with --new-define)");
    command.option("-D,--define", options.defines, "NAME=VALUE of a scene parameter $NAME, in both scenes");
    command.option("--old-define", options.old_defines, "NAME=VALUE in the old scene only, after -D");
    command.option("--new-define", options.new_defines, "NAME=VALUE in the new scene only, after -D");
    command.file(
        "--frames", options.frames,
        "table of frames (.tsv: `frame` and names of $parameters, a row per frame). The old scene is what they "
        "share, as loom-trace --static makes it; each frame is a new scene, and % in the names of outputs its "
        "number, with four digits");
    command.option(
        "--only", options.only,
        "with --frames: FIRST:END, the frames from FIRST on below END; FIRST:END:STEP, each STEP-th of them");
    command.option("--graphs", options.n_graphs, "with --frames --plan: number of graphs that frames take in turn",
                   app::Range<std::uint64_t>{1, 1 << 20});
    command.option("--absent", options.absent,
                   "with --frames: a parameter with this value drops the shapes that use it from the frame");
    command.file(
        "--cache", options.cache,
        "with --frames: radiance cache of the static scene by loom-learn, in place of --old; the camera may move. "
        "The images are biased by the cache, whose error is their layer CacheError; see --correct");
    command.option("--correct", options.correct,
                   "with --cache: unbiased images with more noise. Paths end in the cache at their second vertex; this "
                   "share of them is traced on to correct it",
                   app::Range<double>{smallest_share, 1});
    command.option("--sensor", options.sensor,
                   "sensor of both scenes, by id or by number from 0 in the order of the file (default: the first)");
    command.file("--old", options.old_picture,
                 "image of the old scene (EXR with VarMean), or the --new of an edit before");
    command.files("--old-graph", options.old_graph,
                  "path graphs of the old scene by loom-trace (.h5; passes in order); only paths that the edit touches "
                  "are traced again. Samples, seed, sampler and roulette come from the graphs; --spp, --first-sample "
                  "and --seed are not used");
    command.file("--residual", options.residual,
                 "existing residual to add to --old (also of loom-merge or loom-denoise); nothing is traced");
    command.output("-o,--output", options.output,
                   "residual, new minus old: signed R, G, B with VarMean, and Albedo, N, Depth of the new scene");
    command.output("--new", options.new_picture, "image of the new scene: --old plus the residual");
    command.output("--png", options.png, "sRGB preview of --new (.png)");
    command.output("--residual-png", options.residual_png,
                   "residual in false colours (.png): blue is darker in the new scene, red is brighter");
    command.choice("--method", options.method,
                   "correlated: pairs of paths with the same random numbers; independent: with different ones; "
                   "dynamic: paths that hit the edit; auto: chosen by a pilot",
                   {{"auto", Method::automatic},
                    {"correlated", Method::correlated},
                    {"independent", Method::independent},
                    {"dynamic", Method::dynamic}});
    command.flag("--no-mapping", options.no_mapping,
                 "auto, dynamic: pair paths of the two scenes by their random numbers alone");
    command.option("--technique", options.technique,
                   "dynamic: write only the paths that this technique finds; list: print the techniques of this edit");
    command.flag("--as-printed", options.as_printed,
                 "dynamic: use the weights and limits of mappings as printed in the paper, to measure their bias");
    command.flag("--raw", options.raw, "with --technique: do not weight the paths against the other techniques");
    command.flag("--no-map", options.no_map,
                 "auto: spread camera paths evenly over the pixels, not by the pilot's variance");
    command.choice(
        "--mask", options.mask,
        "auto, --old-graph: weight of --old in --new. coverage: less where first hits differ, by rays of their "
        "own (auto: of least variance by a pilot); none: 1, --new is --old plus the residual; first-hit: 0 in "
        "pixels where the first hit of a sample of the graph differs, as in [HY], biased at edges",
        {{"coverage", Mask::coverage}, {"none", Mask::none}, {"first-hit", Mask::first_hit}});
    command.option("--extra", options.extra,
                   "adaptive pairs of paths, so many per pixel in the mean: on top of those of --old-graph, where the "
                   "difference is noisy; without it alone, in place of --spp, also fewer than one",
                   app::Range<double>{0, 1 << 20});
    command.flag(
        "--parts", options.parts,
        "correlated, --old-graph: also write the parts of the residual, Plus - Minus: what paths of the new scene "
        "bring that the edit touches, and those of the old scene");
    command.option("--spp", options.spp, "pairs of paths per pixel; auto: their cost is its budget",
                   app::Range<std::uint64_t>{1, 1u << 30});
    command.option("--first-sample", options.first_sample, "index of the first sample of each pixel");
    command.option(
        "--seed", options.seed,
        "seed of all random numbers, which differ from those of loom-trace and of earlier edits with the same seed");
    command.option("--max-depth", options.max_depth, "longest path in edges, in both scenes; -1: no limit",
                   app::Range<int>{-1, 1 << 20});
    command.threads(options.threads);
    command.flag("--plan", options.plan,
                 "print the edit and the plan, and stop; with --frames also how many samples of the static image suit "
                 "graphs of --spp");
    command.example("loom-residual old.xml new.xml --old old.exr --spp 8 -o residual.exr --new new.exr");
    command.example(
        "loom-residual scene.xml --frames frames.tsv --old static.exr --old-graph graph.h5 -o residual-%.exr --new "
        "frame-%.exr");
}

std::string plan_of(Method method, const Edit& edit) {
    const bool moves = edit.n_dynamic() + edit.n_ghosts() > 0;
    std::string sites;
    if (moves) sites += "paths from moved, added and removed shapes and from their ghosts (techniques 1 to 6), ";
    if (edit.n_repainted() > 0) sites += "paths from repainted shapes (techniques 1 to 3), ";
    std::string plan;
    switch (method) {
        case Method::automatic:
            plan =
                "on: camera paths with the same random numbers in both scenes, the old ones of those that the edit "
                "touches";
            if (!sites.empty()) plan += "; if a pilot finds that they pay: " + sites.substr(0, sites.size() - 2);
            break;
        case Method::dynamic:
            plan = "on: path tracing with paths that the edit cannot change left out; " + sites + "as requested";
            if (!moves) plan += "; off: ghosts (nothing moves)";
            break;
        case Method::correlated:
            plan =
                "on: correlated paths (same random numbers in both scenes, as requested: a path that hits nothing of "
                "the edit differs by 0); off: independent paths (more noise for all but the largest edits)";
            break;
        case Method::independent:
            plan =
                "on: independent paths (different random numbers in the two scenes, as requested); off: correlated "
                "paths (the noise of both images is in the residual)";
            break;
    }
    if (method != Method::independent && edit.old_emitters.size() != edit.new_emitters.size())
        plan += fmt::format(
            "; joint choice of lights is off ({} lights, now {}: the same random number picks another light)",
            edit.old_emitters.size(), edit.new_emitters.size());
    return plan;
}

namespace {

/// Sets the scene, links and samples of a sum.
void label_sum(Image& sum, const Image& old_picture, const Image& residual) {
    sum.scene = residual.ledger.back().scene;
    sum.ledger.clear();
    if (says_its_noise(residual)) {
        sum.ledger = ledger_of(old_picture);
        sum.ledger.push_back(residual.ledger.back());
    }
    sum.samples = old_picture.samples + residual.samples;
}

}  // namespace

Image add_residual(const Image& old_picture, const Image& residual) {
    Image sum = residual;
    label_sum(sum, old_picture, residual);
    for (const char* c : rgb)
        for (const std::string& channel : {std::string(c), std::string("VarMean.") + c}) {
            if (residual.find(channel).empty()) continue;  // denoised: the variance is unknown
            const auto before = old_picture.find(channel);
            const auto values = sum.add(channel);
            for (std::size_t i = 0; i < values.size(); ++i) values[i] += before[i];
        }
    return sum;
}

Image take_controlled(const Image& old_picture, const Image& residual, ControlledPicture controlled) {
    Image sum = std::move(controlled.image);
    sum.provenance = residual.provenance;
    label_sum(sum, old_picture, residual);
    for (LedgerLink& link : sum.ledger) link.var_mean *= controlled.old_variance;
    sum.ledger.back().var_mean = controlled.var_mean;
    return sum;
}

namespace {

/// Returns the output of --plan.
std::string answer_of(const Edit& edit, const std::string& plan) {
    std::string text = edit.nothing() ? "nothing differs" : fmt::format("{}", fmt::join(edit.changes, "\n"));
    text += "\n";
    for (const std::string& note : edit.notes) text += fmt::format("note: {}\n", note);
    if (!edit.nothing())
        text += fmt::format("shapes: {} dynamic, {} ghosts of them, {} repainted; lights: {} changed\n",
                            edit.n_dynamic(), edit.n_ghosts(), edit.n_dyed(), edit.n_emitters());
    return text + plan + "\n";
}

/// Returns the output of --technique list.
std::string technique_names(const Scenes& scenes, const Edit& edit) {
    std::string names;
    for (const Family& family : families_of(DynamicScenes(*scenes.old_scene, *scenes.new_scene, edit)))
        names += std::string(family.name) + "\n";
    return names;
}

}  // namespace

int max_depth_of(const Options& options, const SceneDescription& description) {
    return options.max_depth.value_or(read_view(*description.root).max_depth);
}

void run(const Options& options, app::Report& report) {
    if (!options.frames.empty()) {
        render_frames(options, report);
        return;
    }
    if (!options.only.empty()) throw InputError("--only: needs --frames");
    if (!options.absent.empty()) throw InputError("--absent: needs --frames");
    if (!options.cache.empty()) throw InputError("--cache: needs --frames");
    if (options.correct) throw InputError("--correct: needs --frames and --cache");
    if (!options.plan && options.technique != "list") check_endings(options);

    const std::string& new_file = options.new_scene.empty() ? options.old_scene : options.new_scene;
    SceneDescription old_description =
        read_scene(options.old_scene, both(options.defines, options.old_defines), options.sensor);
    EditJob job{read_scene(new_file, both(options.defines, options.new_defines), options.sensor),
                new_file,
                report.command(),
                {},
                1,
                {}};
    const Edit edit = find_edit(old_description, job.description);
    if (options.plan) {
        report.answer(answer_of(edit, plan_of(planned_method(options), edit)));
        return;
    }
    if (options.technique == "list") {
        report_edit(edit, report);
        const Scenes scenes{build_scene(std::move(old_description)), build_scene(std::move(job.description)), {}, {}};
        report.answer(technique_names(scenes, edit));
        return;
    }
    const int max_depth = max_depth_of(options, job.description);
    const Base base = read_base(options, std::move(old_description), max_depth, report);
    job.loading = report.cost();
    render_edit(options, base, std::move(job), edit, report);
}

}  // namespace loom::residual
