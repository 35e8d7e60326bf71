#include "stages/frames/images.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "formats/image.h"
#include "formats/io/error.h"
#include "stages/core/app/command.h"
#include "stages/core/math/vector.h"
#include "stages/frames/movie.h"

namespace loom::frames {
namespace {

namespace fs = std::filesystem;

Image read_frame(const std::string& file, const Image* first) {
    Image image = read_image(file);
    if (first && (image.width != first->width || image.height != first->height))
        throw InputError(fmt::format("{}: {} x {} pixels, but the first image has {} x {}", file, image.width,
                                     image.height, first->width, first->height));
    return image;
}

/// Luminance that the fraction `share` of the lit pixels do not exceed; 0 where none is lit.
double luminance_quantile(const Image& image, double share) {
    const std::vector<float> rgb = image.interleaved("");
    std::vector<float> lit;
    for (std::size_t i = 0; i < image.n_pixels(); ++i)
        if (const float l = luminance(Rgb<float>(rgb[3 * i], rgb[3 * i + 1], rgb[3 * i + 2]));
            l > 0 && std::isfinite(l))
            lit.push_back(l);
    return quantile_of(lit, share);
}

/// Sets one image into a larger one.
void place(const Image& image, std::size_t column, std::size_t row, Image& sheet) {
    for (const char* name : {"R", "G", "B"}) {
        const std::span<const float> from = image.find(name);
        const std::span<float> to = sheet.add(name);
        for (std::size_t y = 0; y < image.height; ++y)
            std::copy_n(from.begin() + std::ptrdiff_t(y * image.width), image.width,
                        to.begin() + std::ptrdiff_t((row * image.height + y) * sheet.width + column * image.width));
    }
}

}  // namespace

bool is_images(const Options& options) {
    return !options.images.empty() || fs::path(options.cube).extension() == ".exr";
}

void draw_images(const Options& options, const fs::path& strip, app::Report& report) {
    if (options.exr || options.derivatives || !options.parameter.empty() || options.row || options.column ||
        !options.pixels.empty())
        throw InputError("--exr, --row, --column, --pixel, --parameter, --derivatives: for cubes, not for images");
    std::vector<std::string> files = {options.cube};
    files.insert(files.end(), options.images.begin(), options.images.end());
    const Image first = read_frame(files[0], nullptr);
    std::vector<double> whites;
    for (const std::string& file : files)
        whites.push_back(luminance_quantile(read_frame(file, &first), options.quantile));
    std::nth_element(whites.begin(), whites.begin() + std::ptrdiff_t(whites.size() / 2), whites.end());
    double white = whites[whites.size() / 2] * std::exp2(-options.exposure_ev);
    if (!(white > 0)) {
        report.warn("{}: most images are black; there is nothing to draw", options.cube);
        white = 1;
    }

    const fs::path frames = strip.parent_path() / "frames";
    const std::size_t n_shown = std::min<std::size_t>(options.count, files.size());
    const auto n_columns = std::size_t(std::ceil(std::sqrt(double(n_shown))));
    Image sheet;
    sheet.width = std::uint32_t(n_columns * first.width);
    sheet.height = std::uint32_t((n_shown + n_columns - 1) / n_columns * first.height);
    const bool single = options.png || !options.movie.empty();
    if (single) clear_frames(frames);
    app::Progress progress(report, "frames", files.size());
    std::size_t shown = 0;
    for (std::size_t i = 0; i < files.size(); ++i) {
        const Image image = read_frame(files[i], &first);
        // Evenly, from the first to the last.
        if (shown < n_shown && i * std::max<std::size_t>(n_shown - 1, 1) >= shown * (files.size() - 1)) {
            place(image, shown % n_columns, shown / n_columns, sheet);
            ++shown;
        }
        if (single) write_png(image, frame_path(frames, i, ".png"), -std::log2(white), Sync::no);
        progress.add();
    }
    write_png(sheet, strip, -std::log2(white));
    if (!options.movie.empty() && write_movie(frames, first.width, first.height, options.fps, options.movie, report))
        report.info("{}: {} frames, {:.4g} a second", options.movie, files.size(), options.fps);
    if (!options.png) fs::remove_all(frames);
    report.done("{}: {} of {} images, white is {:.4g}", options.output, n_shown, files.size(), white);
}

}  // namespace loom::frames
