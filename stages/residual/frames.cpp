#include "stages/residual/frames.h"

#include <fmt/format.h>

#include <array>
#include <ranges>

#include "formats/io/error.h"
#include "stages/core/app/command.h"
#include "stages/core/edit/animation.h"
#include "stages/core/scene/build.h"
#include "stages/residual/edit_job.h"

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

/// Returns the frames whose numbers --only names.
std::vector<Frames::Frame> chosen_frames(const Frames& frames, const std::string& only) {
    if (only.empty()) return frames.frames;
    std::array<std::uint32_t, 3> numbers = {0, 0, 1};  // first, end, step
    std::size_t n = 0;
    bool readable = true;
    for (const auto part : std::views::split(only, ':')) {
        const auto number = app::parse_number<std::uint32_t>(std::string(part.begin(), part.end()));
        readable &= n < 3 && number;
        if (readable) numbers[n] = *number;
        ++n;
    }
    const auto [first, end, step] = numbers;
    if (!readable || n < 2 || first >= end || step == 0)
        throw InputError(
            fmt::format("--only {}: expected FIRST:END or FIRST:END:STEP, numbers of frames, FIRST below END, "
                        "STEP from 1",
                        only));
    std::vector<Frames::Frame> chosen;
    for (const Frames::Frame& frame : frames.frames)
        if (frame.number >= first && frame.number < end && (frame.number - first) % step == 0) chosen.push_back(frame);
    if (chosen.empty())
        throw InputError(fmt::format("--only {}: {} has no frame with such a number", only, frames.file));
    return chosen;
}

/// Returns the options and command of a frame alone.
Options options_of_frame(const Options& options, const Frames::Frame& frame, std::string& command) {
    Options own = options;
    own.only = fmt::format("{}:{}", frame.number, frame.number + 1);
    for (std::string* file : {&own.output, &own.new_picture, &own.png, &own.residual_png})
        *file = app::name_of_part(*file, fmt::format("{:04}", frame.number));
    const std::string only = " --only " + own.only,
                      frames = " --frames " + app::shell_word(app::base_name(options.frames));
    command = app::command_of_part(
        std::move(command),
        {options.only.empty() ? std::pair(frames, frames + only) : std::pair(" --only " + options.only, only)});
    return own;
}

}  // namespace

void render_frames(const Options& options, app::Report& report) {
    check_frames(options);
    const Frames table = read_frames(options.frames);
    const std::vector<Frames::Frame> frames = chosen_frames(table, options.only);
    const Defines defines = parse_defines(options.defines);
    Animation animation = find_animation(options.old_scene, defines, options.sensor, table);
    if (options.plan) {
        report.answer(animation.describe() + "\n");
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
