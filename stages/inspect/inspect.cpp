#include "stages/inspect/inspect.h"

#include <fmt/format.h>

#include <map>

#include "formats/documentation.h"
#include "formats/image.h"
#include "formats/io/error.h"
#include "formats/io/output_file.h"
#include "stages/core/app/command.h"
#include "stages/core/app/input_stamp.h"
#include "stages/core/description/description.h"
#include "stages/core/edit/animation.h"
#include "stages/core/scene/build.h"

namespace loom::inspect {

void declare(app::Command& command, Options& options) {
    command.files("file", options.files, "HDF5 or EXR file; a path_graph for --path and --obj, an image for --png");
    command.flag("--json", options.json, "print JSON instead of a table");
    command.option("--path", options.path,
                   "print one path of a graph: PIXEL,SAMPLE, the pixel as x:y (0:0 is top left) or as the "
                   "index y width + x");
    command.output("--obj", options.obj, "write paths of a graph as lines of a Wavefront OBJ");
    command.option("--max-paths", options.max_paths, "largest number of paths in the OBJ",
                   app::Range<std::uint64_t>{1, 10'000'000});
    command.output("--png", options.png, "write an sRGB preview of an image");
    command.option("--exposure", options.exposure_ev, "exposure of the preview", app::Range<double>{-50, 50, "EV"});
    command.file("--graph", options.graph, "path graph of a clusters file, for radii and spread of normals");
    command.flag("--iterations", options.iterations, "print the iterations of a radiance file as TSV");
    command.output("--stamp", options.stamp,
                   "write the content hashes of the given files as a prerequisite for make; a stamp that is up to date "
                   "is not rewritten");
    command.file("--scene", options.scene,
                 "with --stamp: also hash a scene file (Mitsuba XML) and all files that it names; with --frames: the "
                 "scene of the frames");
    command.file("--frames", options.frames,
                 "table of frames (.tsv, as for loom-residual): print a content hash of the static scene that they "
                 "share, and one of each frame by its number");
    command.option("--absent", options.absent,
                   "with --frames: a parameter with this value drops the shapes that use it from the frame");
    command.option("-D,--define", options.defines, "with --scene: NAME=VALUE of a scene parameter $NAME");
    command.option("--sensor", options.sensor, "with --scene: sensor, as given to loom-trace");
    command.flag("--check", options.check, "with --stamp: compare only; exit with 1 when contents differ");
    command.flag("--formats", options.formats, "print the documentation of all formats");
    command.example("loom-inspect graph.h5 --path 320:180,0");
}

std::string iterations_tsv(const Radiance& radiance) {
    std::string text = "iteration\tresidual\timage_change\n";
    for (std::size_t i = 0; i < radiance.residual.size(); ++i)
        text += fmt::format("{}\t{}\t{}\n", i + 1, radiance.residual[i], radiance.image_change[i]);
    return text;
}

namespace {

std::string hashes_of_frames(const Options& options) {
    if (options.scene.empty()) throw InputError("--frames: needs --scene");
    const Frames frames = read_frames(options.frames, options.absent);
    const Animation animation =
        find_animation(options.scene, parse_defines(options.defines), options.sensor, frames, Cameras::each);
    std::map<std::uint32_t, std::string> by_number;
    for (std::size_t i = 0; i < frames.frames.size(); ++i)
        by_number.emplace(frames.frames[i].number, animation.frame_hashes[i]);
    std::string text = fmt::format("static\t{}\n", animation.still_hash);
    for (const auto& [number, hash] : by_number) text += fmt::format("{}\t{}\n", number, hash);
    return text;
}

int stamp(const Options& options) {
    std::vector<std::string> files;
    if (!options.scene.empty()) files = read_scene(options.scene, parse_defines(options.defines), options.sensor).files;
    files.insert(files.end(), options.files.begin(), options.files.end());
    if (files.empty()) throw InputError("--stamp: no input; give files or --scene");
    if (options.check) return app::stamp_matches(options.stamp, files) ? app::exit_done : app::exit_no;
    app::update_stamp(options.stamp, files);
    return app::exit_done;
}

}  // namespace

int run(const Options& options, app::Report& report) {
    if (options.formats) {
        report.answer(formats_markdown());
        return app::exit_done;
    }
    if (!options.stamp.empty()) return stamp(options);
    if (!options.frames.empty()) {
        report.answer(hashes_of_frames(options));
        return app::exit_done;
    }
    if (!options.absent.empty()) throw InputError("--absent: needs --frames");
    if (options.check || !options.scene.empty() || !options.defines.empty() || !options.sensor.empty())
        throw InputError("--scene, --define, --sensor, --check: only with --stamp or --frames");
    if (options.files.empty()) throw InputError("no input: give a file (loom-inspect FILE); see --help");
    if (options.files.size() > 1)
        throw InputError(fmt::format("{}: second input; only --stamp takes several files", options.files[1]));
    const std::string& file = options.files[0];
    if (options.iterations) {
        report.answer(iterations_tsv(read_radiance(file)));
        return app::exit_done;
    }
    if (options.path.empty() && options.obj.empty() && options.png.empty()) {
        const Survey survey = survey_file(file);
        report.answer(options.json ? json_of(survey, file, options.graph) : text_of(survey, file, options.graph));
    }
    if (!options.path.empty() || !options.obj.empty()) {
        const PathGraph graph = read_path_graph(file);
        if (!options.path.empty()) report.answer(path_text(graph, options.path));
        if (!options.obj.empty()) {
            write_text_file(options.obj, obj_text(graph, options.max_paths));
            report.info("{}: {} of {} paths", options.obj, std::min<std::uint64_t>(options.max_paths, graph.n_paths()),
                        graph.n_paths());
        }
    }
    if (!options.png.empty()) {
        const std::size_t n_bad = write_png(read_image(file), options.png, options.exposure_ev);
        if (n_bad > 0) report.warn("{}: {} pixels hold a NaN or an infinity", file, n_bad);
    }
    return app::exit_done;
}

}  // namespace loom::inspect
