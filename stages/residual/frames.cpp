#include "stages/residual/frames.h"

#include <fmt/format.h>

#include <algorithm>
#include <filesystem>

#include "formats/image.h"
#include "formats/io/cost.h"
#include "formats/io/error.h"
#include "stages/core/app/command.h"
#include "stages/core/edit/animation.h"
#include "stages/core/scene/build.h"
#include "stages/residual/cached_frames.h"
#include "stages/residual/edit_run.h"
#include "stages/residual/frame_plan.h"

namespace loom::residual {
namespace {

void check_frames(const Options& options) {
    if (!options.new_scene.empty() || !options.old_defines.empty() || !options.new_defines.empty())
        throw InputError("--frames: its rows are the new scenes; leave out NEW, --old-define and --new-define");
    if (!options.residual.empty() || !options.technique.empty())
        throw InputError("--frames: leave out --residual and --technique");
    if (options.correct && options.cache.empty())
        throw InputError("--correct: there is no cache to correct; give --cache, or leave it out");
    for (const auto& [flag, file] :
         {std::pair("-o", &options.output), std::pair("--new", &options.new_picture), std::pair("--png", &options.png),
          std::pair("--residual-png", &options.residual_png)})
        if (!file->empty() && file->find('%') == std::string::npos)
            throw InputError(fmt::format("{} {}: needs a % for the number of the frame", flag, *file));
}

/// Returns the output of --plan, a value per line: what moves, how to render it, and why.
std::string plan_of_frames(const Options& options, const Animation& animation,
                           const std::vector<Frames::Frame>& frames) {
    // No pilot: the static image and a graph cost more than the paths of one frame.
    if (frames.size() == 1)
        return fmt::format(
            "{}\nmethod: pt\nsamples of the static image: 2\nfor 1 frame, which shares them with no other\n",
            animation.describe());
    SceneDescription description = animation.still;
    const std::shared_ptr<const Scene> still = build_scene(std::move(description));
    PathOptions path;
    path.sampler = SamplerKind::independent;
    path.seed = streams::pilot(options.seed);
    path.rr_depth = still->rr_depth;
    path.max_depth = max_depth_of(options, animation.still);
    const FramePilot pilot = look_at_frames(animation, still, frames, path, options.spp);
    const FramePlan plan(pilot, options.spp, frames.size(), options.n_graphs);
    return fmt::format(
        "{}\nmethod: {}\nsamples of the static image: {}\ngain over path tracing of equal error: {:.3g}\n"
        "frames from which on it gains: {}\nfor {} frames and {} graphs of {} samples; variance of a path {:.3g}, of a "
        "frame's difference {:.3g}; {:.3g} % of the paths traced again\n",
        animation.describe(), plan.gain >= FramePlan::least_gain ? "hybrid" : "pt", plan.still_spp, plan.gain,
        plan.break_even > 0 ? std::to_string(plan.break_even) : "none", frames.size(), options.n_graphs, options.spp,
        pilot.fresh, pilot.difference, 100 * pilot.touched);
}

/// Adds the variances of a frame: of the static image in it, and of all.
void add_variances(const Ledger& ledger, double& of_still, double& of_all) {
    if (ledger.size() < 2) return;
    of_still += accumulated_var_mean(ledger, ledger.size() - 1);
    of_all += accumulated_var_mean(ledger, ledger.size());
}

/// Says how much of the frames' variance is that of the static image; warns where more samples of it would cost less than
/// what all frames take.
/// in:      frame_s  CPU time of a frame;  n_frames  of the table
void report_share(const Options& options, double share, double frame_s, std::size_t n_frames, app::Report& report) {
    report.info("variance: {:.3g} % is that of the static image, which all frames share", 100 * share);
    if (share <= 0.5 || !std::filesystem::exists(cost_path(options.old_picture))) return;
    const Cost cost = read_cost(options.old_picture);
    const double still_s = cost.cpu_s - cost.load_s, frames_s = frame_s * double(n_frames);
    if (still_s < frames_s)
        report.warn(
            "{}: its noise is {:.0f} % of the frames' variance; its samples took {:.3g} s of CPU time, {} frames take "
            "{:.3g} s: more samples of it make the frames better for less",
            options.old_picture, 100 * share, still_s, n_frames, frames_s);
}

/// Returns the options and command of a frame alone.
Options options_of_frame(const Options& options, const Frames::Frame& frame, std::string& command) {
    Options own = options;
    own.frame = std::uint64_t(frame.number);
    own.only = fmt::format("{}:{}", frame.number, frame.number + 1);
    for (std::string* file : {&own.output, &own.new_picture, &own.png, &own.residual_png})
        *file = app::name_of_part(*file, fmt::format("{:04}", frame.number));
    command = app::command_of_frame(std::move(command), options.frames, options.only, own.only);
    return own;
}

/// Number of frames whose pairs of paths are kept at once, so that reading the graph and what its vertices need costs each
/// of them little.
std::size_t frames_at_once(const Base& base) {
    constexpr std::size_t most = 8, bytes = std::size_t(1) << 30, bytes_of_pixel = 256;
    const std::size_t of_frame = bytes_of_pixel * base.scene->sensor.n_pixels();
    return std::clamp<std::size_t>(bytes / std::max<std::size_t>(of_frame, 1), 1, most);
}

}  // namespace

void render_frames(const Options& options, app::Report& report) {
    check_frames(options);
    if (!options.cache.empty()) {
        render_cached_frames(options, report);
        return;
    }
    const Frames table = read_frames(options.frames, options.absent);
    const std::vector<Frames::Frame> frames = frames_of(table, options.only);
    Animation animation = find_animation(options.old_scene, parse_defines(options.defines), options.sensor, table);
    if (options.plan) {
        report.answer(plan_of_frames(options, animation, frames));
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
    const Base base = read_base(options, std::move(animation.still), max_depth, report, std::move(animation.fixed));
    const Cost loading = report.cost();
    double of_still = 0, of_all = 0;
    app::Progress progress(report, "frames", frames.size());
    const auto start = [&](std::size_t i) {
        EditJob job{std::move(animation.frames[frames[i].row]),
                    options.old_scene,
                    commands[i],
                    loading,
                    1 / double(frames.size()),
                    {}};
        Edit edit = find_edit(base.description, job.description);
        job.known = parts_known_of(base, edit, job.description);
        return start_edit(of_frames[i], base, std::move(job), std::move(edit), report);
    };
    // Frames of a graph follow its paths together; the others are rendered one by one.
    const std::size_t at_once = options.old_graph.empty() ? 1 : frames_at_once(base);
    for (std::size_t begin = 0; begin < frames.size(); begin += at_once) {
        std::vector<std::unique_ptr<EditRun>> runs;
        std::vector<GraphJob> jobs;
        for (std::size_t i = begin; i < std::min(begin + at_once, frames.size()); ++i) {
            const Cost before = report.cost();
            runs.push_back(start(i));
            runs.back()->spent.add(before, report.cost());
            if (!options.old_graph.empty()) jobs.push_back(graph_job(*runs.back(), base));
        }
        const Cost before = report.cost();
        std::vector<GraphResidual> pairs;
        if (!jobs.empty()) pairs = render_residuals(*base.scene, jobs, base.graph, options.threads, report);
        const Cost after = report.cost();
        for (std::size_t i = 0; i < runs.size(); ++i) {
            runs[i]->spent.add(before, after, 1 / double(runs.size()));
            std::optional<GraphResidual> own;
            if (!pairs.empty()) own = std::move(pairs[i]);
            finish_edit(*runs[i], base, std::move(own), report);
            add_variances(runs[i]->residual.ledger_of_sum, of_still, of_all);
            runs[i].reset();
            progress.add(1);
        }
    }
    if (of_all > 0) {
        const double frame_s = (report.cost().cpu_s - loading.cpu_s) / double(frames.size());
        report_share(options, of_still / of_all, frame_s, table.frames.size(), report);
    }
}

}  // namespace loom::residual
