#include "stages/frames/frames.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <filesystem>

#include "formats/image.h"
#include "formats/io/error.h"
#include "stages/core/app/command.h"
#include "stages/core/plot/false_colours.h"
#include "stages/core/plot/gnuplot.h"
#include "stages/frames/doppler.h"
#include "stages/frames/images.h"
#include "stages/frames/movie.h"
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

Image frame_of(const TransientCube& cube, std::span<const float> values, std::span<const float> var_mean,
               std::size_t bin) {
    Image image;
    image.width = cube.film.width;
    image.height = cube.film.height;
    image.samples = cube.film.samples_per_pixel;
    std::vector<float> rgb(3 * cube.n_pixels()), var(rgb.size());
    for (std::size_t i = 0; i < rgb.size(); ++i) {
        const std::size_t at = 3 * (i / 3 * cube.time.n_bins + bin) + i % 3;
        rgb[i] = values[at], var[i] = var_mean[at];
    }
    image.set_layer("", "RGB", rgb);
    image.set_layer("VarMean", "RGB", var);
    return image;
}

/// Removes the images of derivatives that an earlier run left in `folder` and this run does not make. Folders with
/// other files stay.
void clear_derivatives(const fs::path& folder, const std::vector<std::string>& made, const std::string& strip,
                       const std::string& movie) {
    for (const auto& entry : fs::directory_iterator(folder)) {
        const std::string name = entry.path().filename();
        if (!entry.is_directory() || entry.is_symlink() || !name.starts_with("derivative-")) continue;
        if (std::find(made.begin(), made.end(), name) != made.end()) continue;
        std::error_code not_empty;
        for (const std::string& image :
             {strip, movie, std::string("streak-x.png"), std::string("streak-y.png"), std::string("steady.png"),
              std::string("curves.svg"), std::string("curves.png"), std::string("curves.tsv"),
              std::string("curves.gp")})
            if (!image.empty()) fs::remove(entry.path() / image, not_empty);
        if (fs::is_directory(entry.path() / "frames")) {
            clear_frames(entry.path() / "frames");
            fs::remove(entry.path() / "frames", not_empty);
        }
        fs::remove(entry.path(), not_empty);
    }
}

/// Draws curves, with a derivative below the value, and writes their commands.
void write_curves(const Options& options, const TransientCube& cube, const std::vector<std::size_t>& pixels,
                  const DerivativeView* derivative, const fs::path& folder, const app::Report& report) {
    const Plot plot = curves(cube, pixels, options.radius, derivative);
    // As a label: a newline in an argument would end the comment.
    const std::string command = label_of(report.command(), 10000);
    plot::make_pictures(
        folder,
        {{"curves.gp", fmt::format("# {}\n# gnuplot curves.gp\n{}", command, plot.commands)}, *plot.data.begin()},
        "curves.gp", plot.pictures);
}

void write_plots(const fs::path& folder, const std::vector<Plot>& plots) {
    for (const Plot& plot : plots) {
        auto passing = plot.data;
        passing["commands"] = plot.commands;
        plot::make_pictures(folder, {}, "commands", plot.pictures, passing);
    }
}

/// Where the images go and which pixels they show; equal for the value and all derivatives.
struct Selection {
    std::uint32_t row = 0, column = 0;
    std::vector<std::size_t> pixels, bins;  // of curves; of the strip
    InputId input;
};

struct Output {
    fs::path strip, movie;
    fs::path folder() const { return strip.parent_path(); }
};

/// Writes single frames and the movie, on request.
/// in:      what      label of the progress
///          write_as  writes a frame as PNG, and returns the size of that
template <class Write>
void write_frames(const Options& options, const TransientCube& cube, std::span<const float> values,
                  std::span<const float> var_mean, const Selection& selection, const Output& output, const char* what,
                  const Write& write_as, app::Report& report) {
    if (!options.png && !options.exr && options.movie.empty()) return;
    const fs::path frames = output.folder() / "frames";
    clear_frames(frames);
    app::Progress progress(report, what, cube.time.n_bins);
    std::pair<std::size_t, std::size_t> size;
    for (std::size_t bin = 0; bin < cube.time.n_bins; ++bin) {
        Image image = frame_of(cube, values, var_mean, bin);
        image.provenance = report.provenance(cube.provenance.seed, {selection.input}, image.provenance.plan);
        // Hundreds of files that are quickly remade: none is synced.
        if (options.exr) write_image(image, frame_path(frames, bin, ".exr"), Compression::zip, Sync::no);
        if (options.png || !options.movie.empty()) size = write_as(image, frame_path(frames, bin, ".png"));
        progress.add();
    }
    if (!options.movie.empty() && write_movie(frames, size.first, size.second, options.fps, output.movie, report))
        report.info("{}: {} frames; one second shows {:.4g} {}", output.movie.native(), cube.time.n_bins,
                    options.fps * cube.in_unit(cube.time.bin_width_opl), time_unit(cube));
    if (!options.png && !options.exr) fs::remove_all(frames);
}

/// Returns the luminance that is displayed as white.
double draw_value(const Options& options, const TransientCube& cube, const Selection& selection, const Output& output,
                  app::Report& report) {
    double white = luminance_quantile(cube, options.quantile) * std::exp2(-options.exposure_ev);
    if (!(white > 0)) {
        report.warn("{}: all bins are zero; there is nothing to draw", options.cube);
        white = 1;
    }
    write_plots(output.folder(), {strip(cube, output.strip.filename(), selection.bins, white),
                                  streaks(cube, selection.row, selection.column), peak(cube)});
    write_curves(options, cube, selection.pixels, nullptr, output.folder(), report);
    const auto write_as = [&](const Image& image, const fs::path& path) {
        write_png(image, path, -std::log2(white), Sync::no);
        return std::pair<std::size_t, std::size_t>(image.width, image.height);
    };
    write_frames(options, cube, {cube.radiance.data(), cube.radiance.size()},
                 {cube.var_mean.data(), cube.var_mean.size()}, selection, output, "frames", write_as, report);
    return white;
}

/// Returns the absolute luminance that is displayed in full colour.
double draw_derivative(const Options& options, const TransientCube& cube, std::size_t parameter_idx,
                       const Selection& selection, const Output& output, app::Report& report) {
    const DerivativeView derivative = derivative_view(cube, parameter_idx);
    double reach = derivative_quantile(cube, derivative, options.quantile) * std::exp2(-options.exposure_ev);
    if (!(reach > 0)) {
        report.warn("{}: the derivative by {} is zero in all bins; there is nothing to draw", options.cube,
                    derivative.name);
        reach = 1;
    }
    write_plots(output.folder(), {derivative_strip(cube, derivative, output.strip.filename(), selection.bins, reach),
                                  derivative_streaks(cube, derivative, selection.row, selection.column)});
    write_curves(options, cube, selection.pixels, &derivative, output.folder(), report);
    Image steady;
    steady.width = cube.film.width;
    steady.height = cube.film.height;
    steady.set_layer("", "RGB", std::vector<float>(derivative.steady.begin(), derivative.steady.end()));
    write_png(false_colours(steady, "", 0), output.folder() / "steady.png");
    const auto write_as = [&](const Image& image, const fs::path& path) {
        const Image colours = false_colours(image, "", reach);
        write_png(colours, path, 0, Sync::no);
        return std::pair<std::size_t, std::size_t>(colours.width, colours.height);
    };
    write_frames(options, cube, derivative.values, derivative.var_mean, selection, output, "frames of a derivative",
                 write_as, report);
    return reach;
}

}  // namespace

void declare(app::Command& command, Options& options) {
    command
        .file(
            "cube", options.cube,
            "transient cube (.h5); velocities of loom-derive --doppler, drawn as one image; or the first image (.exr) "
            "of an animation")
        .required();
    command.files("images", options.images, "further images of an animation, in their order");
    command
        .output("-o,--output", options.output,
                "strip of frames (.png); of a cube beside it streak-x, streak-y, peak (.png), curves (.svg .png .tsv "
                ".gp); of "
                "velocities their colours, with the spectra in beat (.svg .png .tsv .gp)")
        .required();
    command.option("--exposure", options.exposure_ev, "exposure of frames and strip, on top of --quantile",
                   app::Range<double>{-50, 50, "EV"});
    command.option("--quantile", options.quantile,
                   "quantile of the lit bins that is drawn white, or of a derivative in full colour",
                   app::Range<double>{0, 1});
    command.option("--count", options.count, "number of frames in the strip", app::Range<std::uint32_t>{1, 1000});
    command.option("--row", options.row, "row of the streak over x and time (default: the middle)");
    command.option("--column", options.column, "column of the streak over y and time (default: the middle)");
    command.option("--pixel", options.pixels, "X:Y of a curve; repeat for more (default: three of the middle column)");
    command.option("--radius", options.radius,
                   "radius of the square of pixels over which a curve is averaged; 0: one pixel",
                   app::Range<std::uint32_t>{0, 1000, "px"});
    command.flag("--png", options.png, "also write each bin or image as frames/frame-NNNN.png, all with one exposure");
    command.flag("--exr", options.exr, "also write each bin as frames/frame-NNNN.exr, with its variance");
    command.output("--movie", options.movie, "also write a movie (.mp4); needs ffmpeg");
    command.option("--parameter", options.parameter,
                   "draw the derivative by this parameter instead of the value, blue below 0 and red above");
    command.flag("--derivatives", options.derivatives,
                 "also draw the derivative by each parameter of the cube, in derivative-NAME/ beside the strip");
    command.option("--fps", options.fps, "bins or images shown per second of the movie", app::Range<double>{0.1, 1000});
    command.example("loom-frames cube.h5 -o strip.png --row 64 --pixel 40:80 --pixel 90:20 --movie movie.mp4");
    command.example("loom-frames frame-*.exr -o strip.png --fps 24 --movie movie.mp4");
    command.example("loom-frames cube.h5 -o derivative/strip.png --parameter theta");
}

void run(const Options& options, app::Report& report) {
    const fs::path given = options.output;
    const Output output{given.parent_path().empty() ? fs::path(".") / given : given, options.movie};
    if (given.extension() != ".png") throw InputError(fmt::format("{}: the strip must end in .png", options.output));
    if (options.derivatives && !options.parameter.empty())
        throw InputError("--parameter and --derivatives exclude each other: one derivative, or the value and all");
    check_output_path(given);
    if (is_images(options)) {
        draw_images(options, output.strip, report);
        return;
    }
    if (is_doppler(options.cube)) {
        draw_doppler(options, report);
        return;
    }
    const TransientCube cube = read_transient_cube(options.cube);
    const std::uint32_t w = cube.film.width, h = cube.film.height;
    Selection selection;
    selection.row = line_of(options.row, h, "--row");
    selection.column = line_of(options.column, w, "--column");
    for (const std::string& text : options.pixels) selection.pixels.push_back(pixel_of(text, cube));
    if (selection.pixels.empty())
        for (const std::uint32_t eighths : {2u, 4u, 7u})
            selection.pixels.push_back(std::size_t(h * eighths / 8) * w + w / 2);
    selection.pixels.erase(std::unique(selection.pixels.begin(), selection.pixels.end()), selection.pixels.end());
    const std::optional<std::size_t> parameter_idx =
        options.parameter.empty() ? std::nullopt : std::optional(parameter_of(cube, options.parameter, options.cube));
    if (options.derivatives) require_derivatives(cube, options.cube);
    selection.bins = strip_bins(cube, options.count);
    if (options.png || options.exr || !options.movie.empty()) selection.input = identify(options.cube);
    if (parameter_idx) {
        const double reach = draw_derivative(options, cube, *parameter_idx, selection, output, report);
        report.done("{}: {} bins, full colour is {:.4g}", options.output, cube.time.n_bins, reach);
        return;
    }
    const double white = draw_value(options, cube, selection, output, report);
    std::string and_derivatives;
    if (options.derivatives) {
        const std::vector<std::string> folders = derivative_folders(cube.parameters.name);
        clear_derivatives(output.folder(), folders, given.filename(), output.movie.filename());
        for (std::size_t i = 0; i < folders.size(); ++i) {
            const fs::path folder = output.folder() / folders[i];
            fs::create_directories(folder);
            const fs::path movie = output.movie.empty() ? fs::path() : folder / output.movie.filename();
            draw_derivative(options, cube, i, selection, {folder / given.filename(), movie}, report);
        }
        and_derivatives = fmt::format("; {} derivatives", folders.size());
    }
    report.done("{}: {} bins, white is {:.4g}{}", options.output, cube.time.n_bins, white, and_derivatives);
}

}  // namespace loom::frames
