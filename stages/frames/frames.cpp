#include "stages/frames/frames.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <stdexcept>

#include "formats/image.h"
#include "formats/io/error.h"
#include "formats/io/output_file.h"
#include "stages/core/app/command.h"
#include "stages/core/plot/gnuplot.h"
#include "stages/frames/pictures.h"

namespace loom::frames {
namespace {

namespace fs = std::filesystem;

std::size_t pixel_of(const std::string& text, const TransientCube& cube) {
    const auto colon = text.find(':');
    const auto x = app::parse_number<std::uint32_t>(text.substr(0, colon));
    const auto y = app::parse_number<std::uint32_t>(colon == std::string::npos ? "" : text.substr(colon + 1));
    if (!x || !y) throw InputError(fmt::format("--pixel {}: expected X:Y, 0:0 is top left", text));
    if (*x >= cube.film.width || *y >= cube.film.height)
        throw InputError(
            fmt::format("--pixel {}: the cube has {} x {} pixels", text, cube.film.width, cube.film.height));
    return std::size_t(*y) * cube.film.width + *x;
}

std::uint32_t line_of(std::optional<std::uint32_t> wanted, std::uint32_t n, const char* option) {
    if (wanted && *wanted >= n) throw InputError(fmt::format("{} {}: the cube has {}", option, *wanted, n));
    return wanted.value_or(n / 2);
}

Image frame_of(const TransientCube& cube, std::size_t bin) {
    Image image;
    image.width = cube.film.width;
    image.height = cube.film.height;
    image.samples = cube.film.samples_per_pixel;
    std::vector<float> rgb(3 * cube.n_pixels()), var(rgb.size());
    for (std::size_t i = 0; i < rgb.size(); ++i) {
        const std::size_t at = 3 * (i / 3 * cube.time.n_bins + bin) + i % 3;
        rgb[i] = cube.radiance[at], var[i] = cube.var_mean[at];
    }
    image.set_layer("", "RGB", rgb);
    image.set_layer("VarMean", "RGB", var);
    return image;
}

/// Creates the folder of single frames, and removes the frames of earlier runs.
void clear_frames(const fs::path& folder) {
    fs::create_directories(folder);
    for (const auto& entry : fs::directory_iterator(folder)) {
        const std::string name = entry.path().filename();
        if (name.starts_with("frame-") && (name.ends_with(".png") || name.ends_with(".exr"))) fs::remove(entry.path());
    }
}

fs::path frame_path(const fs::path& folder, std::size_t bin, const char* ending) {
    return folder / fmt::format("frame-{:04}{}", bin, ending);
}

/// Writes all frames as a movie; only a message where ffmpeg is not installed.
void write_movie(const Options& options, const TransientCube& cube, const fs::path& frames, app::Report& report) {
    OutputFile output(options.movie);
    const std::size_t zoom = std::max<std::size_t>(1, 480 / std::min(cube.film.width, cube.film.height));
    // Encoders require even sides.
    const std::string size = fmt::format("scale={}:{}:flags=neighbor", (zoom * cube.film.width + 1) / 2 * 2,
                                         (zoom * cube.film.height + 1) / 2 * 2);
    const fs::path log = fs::absolute(output.partial()).native() + ".log";
    const auto encode = [&](const std::vector<std::string>& codec) {
        std::vector<std::string> words{
            "ffmpeg",         "-y",  "-loglevel", "error", "-framerate", fmt::format("{}", options.fps), "-i",
            "frame-%04d.png", "-vf", size};
        words.insert(words.end(), codec.begin(), codec.end());
        for (const char* word : {"-pix_fmt", "yuv420p", "-threads", "1", "-fflags", "+bitexact", "-flags:v",
                                 "+bitexact", "-movflags", "+faststart", "-f", "mp4"})
            words.push_back(word);
        words.push_back(fs::absolute(output.partial()).native());
        return plot::run_program(fs::absolute(frames), words, log);
    };
    std::optional<int> status = encode({"-c:v", "libx264", "-crf", "16"});
    if (status && *status != 0) status = encode({"-c:v", "mpeg4", "-q:v", "2"});
    std::ifstream in(log);
    const std::string said(std::istreambuf_iterator<char>(in), {});
    fs::remove(log);
    if (status != 0) fs::remove(options.movie);  // a movie of another cube
    if (!status) {
        report.info("no movie: ffmpeg is not installed (Debian: apt install ffmpeg)");
        return;
    }
    if (*status != 0) throw std::runtime_error(fmt::format("{}: ffmpeg failed:\n{}", options.movie, said));
    output.commit();
    report.info("{}: {} frames; one second shows {:.4g} {}", options.movie, cube.time.n_bins,
                options.fps * cube.in_unit(cube.time.bin_width_opl), time_unit(cube));
}

}  // namespace

void declare(app::Command& command, Options& options) {
    command.file("cube", options.cube, "transient cube (.h5)").required();
    command
        .output("-o,--output", options.output,
                "strip of frames (.png); beside it streak-x, streak-y, peak (.png), curves (.svg .png .tsv .gp)")
        .required();
    command.option("--exposure", options.exposure_ev, "exposure of frames and strip, on top of --quantile",
                   app::Range<double>{-50, 50, "EV"});
    command.option("--quantile", options.quantile, "quantile of the lit bins that is drawn white",
                   app::Range<double>{0, 1});
    command.option("--count", options.count, "number of frames in the strip", app::Range<std::uint32_t>{1, 1000});
    command.option("--row", options.row, "row of the streak over x and time (default: the middle)");
    command.option("--column", options.column, "column of the streak over y and time (default: the middle)");
    command.option("--pixel", options.pixels, "X:Y of a curve; repeat for more (default: three of the middle column)");
    command.option("--radius", options.radius,
                   "radius of the square of pixels over which a curve is averaged; 0: one pixel",
                   app::Range<std::uint32_t>{0, 1000, "px"});
    command.flag("--png", options.png, "also write each bin as frames/frame-NNNN.png, all with one exposure");
    command.flag("--exr", options.exr, "also write each bin as frames/frame-NNNN.exr, with its variance");
    command.output("--movie", options.movie, "also write a movie (.mp4); needs ffmpeg");
    command.option("--fps", options.fps, "bins shown per second of the movie", app::Range<double>{0.1, 1000});
    command.example("loom-frames cube.h5 -o strip.png --row 64 --pixel 40:80 --pixel 90:20 --movie movie.mp4");
}

void run(const Options& options, app::Report& report) {
    const fs::path output = options.output,
                   folder = output.parent_path().empty() ? fs::path(".") : output.parent_path();
    if (output.extension() != ".png") throw InputError(fmt::format("{}: the strip must end in .png", options.output));
    check_output_path(output);
    const TransientCube cube = read_transient_cube(options.cube);
    const std::uint32_t w = cube.film.width, h = cube.film.height;
    const std::uint32_t row = line_of(options.row, h, "--row"), column = line_of(options.column, w, "--column");
    std::vector<std::size_t> pixels;
    for (const std::string& text : options.pixels) pixels.push_back(pixel_of(text, cube));
    if (pixels.empty())
        for (const std::uint32_t eighths : {2u, 4u, 7u}) pixels.push_back(std::size_t(h * eighths / 8) * w + w / 2);
    pixels.erase(std::unique(pixels.begin(), pixels.end()), pixels.end());

    double white = luminance_quantile(cube, options.quantile) * std::exp2(-options.exposure_ev);
    if (!(white > 0)) {
        report.warn("{}: all bins are zero; there is nothing to draw", options.cube);
        white = 1;
    }
    for (const Plot& plot : {strip(cube, output.filename(), strip_bins(cube, options.count), white),
                             streaks(cube, row, column), peak(cube)})
        plot::make_pictures(folder, {}, "commands", plot.pictures, [&] {
            auto passing = plot.data;
            passing["commands"] = plot.commands;
            return passing;
        }());
    const Plot of_pixels = curves(cube, pixels, options.radius);
    plot::make_pictures(
        folder,
        {{"curves.gp", fmt::format("# {}\n# gnuplot curves.gp\n{}", report.command(), of_pixels.commands)},
         *of_pixels.data.begin()},
        "curves.gp", of_pixels.pictures);

    const fs::path frames = folder / "frames";
    if (options.png || options.exr || !options.movie.empty()) {
        clear_frames(frames);
        const InputId input = identify(options.cube);
        app::Progress progress(report, "frames", cube.time.n_bins);
        for (std::size_t bin = 0; bin < cube.time.n_bins; ++bin) {
            Image image = frame_of(cube, bin);
            image.provenance = report.provenance(cube.provenance.seed, {input}, image.provenance.plan);
            // Hundreds of files that are quickly remade: none is synced.
            if (options.exr) write_image(image, frame_path(frames, bin, ".exr"), Compression::zip, Sync::no);
            if (options.png || !options.movie.empty())
                write_png(image, frame_path(frames, bin, ".png"), -std::log2(white), Sync::no);
            progress.add();
        }
        if (!options.movie.empty()) write_movie(options, cube, frames, report);
        if (!options.png && !options.exr) fs::remove_all(frames);
    }
    report.done("{}: {} bins, white is {:.4g}", options.output, cube.time.n_bins, white);
}

}  // namespace loom::frames
