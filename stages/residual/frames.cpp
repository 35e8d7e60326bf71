#include "stages/residual/frames.h"

#include <fmt/format.h>

#include "formats/io/error.h"
#include "stages/core/app/command.h"
#include "stages/core/edit/animation.h"
#include "stages/core/scene/build.h"
#include "stages/residual/edit_job.h"
#include "stages/residual/frame_plan.h"

namespace loom::residual {
namespace {

void check_frames(const Options& options) {
    if (!options.new_scene.empty() || !options.old_defines.empty() || !options.new_defines.empty())
        throw InputError("--frames: its rows are the new scenes; leave out NEW, --old-define and --new-define");
    if (!options.residual.empty() || !options.technique.empty())
        throw InputError("--frames: leave out --residual and --technique");
    for (const auto& [flag, file] :
         {std::pair("-o", &options.output), std::pair("--new", &options.new_picture), std::pair("--png", &options.png),
          std::pair("--residual-png", &options.residual_png)})
        if (!file->empty() && file->find('%') == std::string::npos)
            throw InputError(fmt::format("{} {}: needs a % for the number of the frame", flag, *file));
}

/// Returns the output of --plan, a value per line: what moves, how to render it, and why.
std::string plan_of_frames(const Options& options, const Animation& animation, const Frames& table,
                           const std::vector<Frames::Frame>& frames, const Defines& defines) {
    SceneDescription description = animation.still;
    const std::shared_ptr<const Scene> still = build_scene(std::move(description));
    PathOptions path;
    path.sampler = SamplerKind::independent;
    path.seed = streams::pilot(options.seed);
    path.rr_depth = still->rr_depth;
    path.max_depth = max_depth_of(options, animation.still);
    const FramePilot pilot =
        look_at_frames(animation, still, table, frames, options.old_scene, defines, options.sensor, path, options.spp);
    const FramePlan plan(pilot, options.spp, frames.size());
    return fmt::format(
        "{}\nmethod: {}\nsamples of the static image: {}\ngain over path tracing of equal error: {:.3g}\n"
        "frames from which on it gains: {}\nfor {} frames and graphs of {} samples; variance of a path {:.3g}, of a "
        "frame's difference {:.3g}; {:.3g} % of the paths traced again\n",
        animation.describe(), plan.gain >= 1 ? "hybrid" : "pt", plan.still_spp, plan.gain,
        plan.break_even > 0 ? std::to_string(plan.break_even) : "none", frames.size(), options.spp, pilot.fresh,
        pilot.difference, 100 * pilot.touched);
}

/// Returns the options and command of a frame alone.
Options options_of_frame(const Options& options, const Frames::Frame& frame, std::string& command) {
    Options own = options;
    own.only = fmt::format("{}:{}", frame.number, frame.number + 1);
    for (std::string* file : {&own.output, &own.new_picture, &own.png, &own.residual_png})
        *file = app::name_of_part(*file, fmt::format("{:04}", frame.number));
    command = app::command_of_frame(std::move(command), options.frames, options.only, own.only);
    return own;
}

}  // namespace

void render_frames(const Options& options, app::Report& report) {
    check_frames(options);
    const Frames table = read_frames(options.frames);
    const std::vector<Frames::Frame> frames = frames_of(table, options.only);
    const Defines defines = parse_defines(options.defines);
    Animation animation = find_animation(options.old_scene, defines, options.sensor, table);
    if (options.plan) {
        report.answer(plan_of_frames(options, animation, table, frames, defines));
        return;
    }
    report.info("{}", animation.describe());
    std::vector<std::string> commands(frames.size(), report.command());
    std::vector<Options> of_frames;
    for (std::size_t i = 0; i < frames.size(); ++i) {
        of_frames.push_back(options_of_frame(options, frames[i], commands[i]));
        check_endings(of_frames.back());
    }
    const int max_depth = max_depth_of(options, animation.still);
    const Base base = read_base(options, std::move(animation.still), max_depth, report);
    const Cost loading = report.cost();
    app::Progress progress(report, "frames", frames.size());
    for (std::size_t i = 0; i < frames.size(); ++i) {
        const Cost before = report.cost();
        EditJob job{read_scene(options.old_scene, table.values_of(frames[i], defines), options.sensor),
                    options.old_scene,
                    commands[i],
                    loading,
                    1 / double(frames.size()),
                    before,
                    {}};
        const Edit edit = find_edit(base.description, job.description);
        job.known = known_parts(base.scene, edit);
        render_edit(of_frames[i], base, std::move(job), edit, report);
        progress.add(1);
    }
}

}  // namespace loom::residual
