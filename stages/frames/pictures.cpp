#include "stages/frames/pictures.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>

#include "formats/image.h"
#include "stages/core/math/vector.h"
#include "stages/core/plot/gnuplot.h"

namespace loom::frames {
namespace {

using plot::in_quotes;

/// Perceived as even steps from dark to bright.
constexpr const char* brightness =
    "set palette defined (0 '#000004', 1 '#1b0c41', 2 '#4a0c6b', 3 '#781c6d', 4 '#a52c60', 5 '#cf4446', 6 '#ed6925', 7 "
    "'#fb9b06', 8 '#f7d13d', 9 '#fcffa4')\n";
/// A rainbow without its dark and bright bands.
constexpr const char* rainbow =
    "set palette defined (0 '#30123b', 1 '#4662d7', 2 '#36aaf9', 3 '#1ae4b6', 4 '#72fe5e', 5 '#c8ef34', 6 '#faba39', 7 "
    "'#f66b19', 8 '#ca2a04', 9 '#7a0403')\n";

std::string bytes_of(const std::vector<float>& values) {
    return {reinterpret_cast<const char*>(values.data()), values.size() * sizeof(float)};
}

std::string terminal(const std::string& picture, int width, int height) {
    return fmt::format(
        "set terminal pngcairo size {},{} noenhanced font 'DejaVu Sans,11' background '#ffffff'\nset output {}\n",
        width, height, in_quotes(picture));
}

std::string bin_words(const TransientCube& cube) {
    return fmt::format("bin of {:.4g} {}", cube.in_unit(cube.time.gate_opl), time_unit(cube));
}

std::string common() {
    return "set encoding utf8\nset border lw 0.7 lc rgb '#444444'\nset tics out nomirror textcolor rgb '#222222'\nset "
           "format '%g'\nunset key\n";
}

}  // namespace

Plot streaks(const TransientCube& cube, std::size_t row, std::size_t column) {
    const std::size_t w = cube.film.width, h = cube.film.height, n = cube.time.n_bins;
    std::vector<float> x(w * n), y(h * n), lit;
    for (std::size_t bin = 0; bin < n; ++bin) {
        for (std::size_t i = 0; i < w; ++i) x[bin * w + i] = float(luminance_of(cube, row * w + i, bin));
        for (std::size_t i = 0; i < h; ++i) y[i * n + bin] = float(luminance_of(cube, i * w + column, bin));
    }
    for (const auto* values : {&x, &y})
        for (float value : *values)
            if (value > 0) lit.push_back(value);
    std::sort(lit.begin(), lit.end());
    const double high = lit.empty() ? 1 : double(lit[std::size_t(0.995 * double(lit.size() - 1))]), low = high / 1000;
    const double t0 = time_of(cube, 0), step = cube.in_unit(cube.time.bin_width_opl), first = t0 - step / 2,
                 last = first + step * double(n);
    Plot plot;
    plot.data = {{"streak-x.bin", bytes_of(x)}, {"streak-y.bin", bytes_of(y)}};
    plot.pictures = {"streak-x.png", "streak-y.png"};
    plot.commands = common() + brightness +
                    fmt::format(
                        "set logscale cb\nset cbrange [{}:{}]\nset cblabel {}\nset format cb '%.0e'\n"
                        "set object 1 rectangle from graph 0,0 to graph 1,1 behind fc rgb '#000004' fs noborder\n",
                        low, high, in_quotes("luminance (W m⁻² sr⁻¹ per " + bin_words(cube) + ")"));
    plot.commands += terminal("streak-x.png", 760, 620) +
                     fmt::format(
                         "set xrange [0:{0}]\nset yrange [{2}:{3}]\nset xlabel {4}\nset ylabel {5}\n"
                         "plot 'streak-x.bin' binary array=({0},{1}) origin=(0.5,{6}) dx=1 dy={7} format='%float' "
                         "using 1 with image\n",
                         w, n, first, last, in_quotes(fmt::format("x along row {} (px)", row)),
                         in_quotes(time_words(cube)), t0, step);
    plot.commands += terminal("streak-y.png", 860, 480) +
                     fmt::format(
                         "set xrange [{2}:{3}]\nset yrange [{0}:0]\nset xlabel {5}\nset ylabel {4}\n"
                         "plot 'streak-y.bin' binary array=({1},{0}) origin=({6},0.5) dx={7} dy=1 format='%float' "
                         "using 1 with image\n",
                         h, n, first, last, in_quotes(fmt::format("y down column {} (px)", column)),
                         in_quotes(time_words(cube)), t0, step);
    return plot;
}

Plot peak(const TransientCube& cube) {
    const std::size_t w = cube.film.width, h = cube.film.height;
    const std::vector<float> times = peak_times(cube);
    std::vector<float> known;
    for (float t : times)
        if (std::isfinite(t)) known.push_back(t);
    std::sort(known.begin(), known.end());
    // A few late pixels must not use most of the colours.
    const double low = known.empty() ? 0 : double(known[std::size_t(0.005 * double(known.size() - 1))]),
                 high = known.empty() ? 1 : double(known[std::size_t(0.95 * double(known.size() - 1))]);
    const double area = 520 / std::max(1.0, double(h) / double(w));
    Plot plot;
    plot.data = {{"peak.bin", bytes_of(times)}};
    plot.pictures = {"peak.png"};
    plot.commands =
        common() + rainbow + terminal("peak.png", int(area) + 230, int(area * double(h) / double(w)) + 90) +
        fmt::format(
            "set size ratio -1\nset xrange [0:{0}]\nset yrange [{1}:0]\nset xlabel 'x (px)'\nset ylabel 'y (px)'\n"
            "set cbrange [{2}:{3}]\nset cblabel {4}\n"
            "set object 1 rectangle from graph 0,0 to graph 1,1 behind fc rgb '#000000' fs noborder\n"
            "plot 'peak.bin' binary array=({0},{1}) origin=(0.5,0.5) dx=1 dy=1 format='%float' using 1 with image\n",
            w, h, low, high > low ? high : low + 1, in_quotes("most light arrives at " + time_words(cube)));
    return plot;
}

Plot strip(const TransientCube& cube, const std::string& name, const std::vector<std::size_t>& bins, double white) {
    const std::size_t w = cube.film.width, h = cube.film.height, columns = std::min<std::size_t>(4, bins.size()),
                      lines = (bins.size() + columns - 1) / columns;
    // A whole number of screen pixels per image pixel, where the image is small.
    const double zoom = w > 240 ? 240.0 / double(w) : std::ceil(240.0 / double(w)), tile_w = zoom * double(w),
                 tile_h = zoom * double(h);
    constexpr double gap = 8, head = 22, title = 34;
    const double width = double(columns) * (tile_w + gap) + gap, height = double(lines) * (tile_h + head) + gap + title;
    std::string bytes;
    Plot plot;
    plot.commands =
        common() + terminal(name, int(width), int(height)) +
        fmt::format(
            "set multiplot\nunset tics\nset xrange [0:{0}]\nset yrange [{1}:0]\nset label 1 {2} at screen 0.5, screen "
            "{3} center\n",
            w, h, in_quotes(fmt::format("frames, each a {}; white is {:.3g} W m⁻² sr⁻¹", bin_words(cube), white)),
            1 - 0.5 * title / height);
    for (std::size_t i = 0; i < bins.size(); ++i) {
        const std::size_t skip = bytes.size();
        for (std::size_t pixel = 0; pixel < w * h; ++pixel)
            for (std::size_t c = 0; c < 3; ++c)
                bytes += char(std::lround(
                    255 *
                    srgb_from_linear(double(cube.radiance[3 * (pixel * cube.time.n_bins + bins[i]) + c]) / white)));
        const double left = gap + double(i % columns) * (tile_w + gap),
                     top = title + double(i / columns) * (tile_h + head) + head;
        plot.commands += fmt::format(
            "set lmargin at screen {}\nset rmargin at screen {}\nset tmargin at screen {}\nset bmargin at screen {}\n",
            left / width, (left + tile_w) / width, 1 - top / height, 1 - (top + tile_h) / height);
        plot.commands +=
            fmt::format("set label 2 {} at screen {}, screen {} center\n",
                        in_quotes(fmt::format("{:.2f} {}", time_of(cube, double(bins[i])), time_unit(cube))),
                        (left + tile_w / 2) / width, 1 - (top - 0.55 * head) / height);
        plot.commands += fmt::format(
            "plot 'strip.bin' binary array=({},{}) skip={} origin=(0.5,0.5) dx=1 dy=1 format='%uchar' using 1:2:3 with "
            "rgbimage\nunset label 1\n",
            w, h, skip);
    }
    plot.commands += "unset multiplot\n";
    plot.data = {{"strip.bin", bytes}};
    plot.pictures = {name};
    return plot;
}

Plot curves(const TransientCube& cube, const std::vector<std::size_t>& pixels, std::size_t radius) {
    constexpr std::array<const char*, 6> colours{"#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#555555"};
    const std::size_t w = cube.film.width, h = cube.film.height, n = cube.time.n_bins;
    struct Curve {
        std::vector<double> Y, se;
    };
    std::vector<Curve> all;
    std::string head = fmt::format("bin\t{}", time_unit(cube)), bands, lines;
    double high = 0;
    for (std::size_t k = 0; k < pixels.size(); ++k) {
        Curve curve{std::vector<double>(n), std::vector<double>(n)};
        const std::size_t x = pixels[k] % w, y = pixels[k] / w;
        const std::size_t x0 = x - std::min(radius, x), x1 = std::min(x + radius + 1, w), y0 = y - std::min(radius, y),
                          y1 = std::min(y + radius + 1, h);
        const double area = double((x1 - x0) * (y1 - y0));
        for (std::size_t bin = 0; bin < n; ++bin) {
            Rgb<double> var;
            for (std::size_t j = y0; j < y1; ++j)
                for (std::size_t i = x0; i < x1; ++i) {
                    curve.Y[bin] += luminance_of(cube, j * w + i, bin) / area;
                    const float* v = cube.var_mean.data() + 3 * ((j * w + i) * n + bin);
                    var += Rgb<double>(v[0], v[1], v[2]);
                }
            // Channels of a path are correlated: their standard deviations add up.
            curve.se[bin] = luminance(Rgb<double>(std::sqrt(var[0]), std::sqrt(var[1]), std::sqrt(var[2]))) / area;
            high = std::max(high, curve.Y[bin]);
        }
        all.push_back(std::move(curve));
        const std::string name = fmt::format("{}:{}", x, y);
        head += fmt::format("\t{0}\t{0} low\t{0} high", name);
        const char* colour = colours[k % colours.size()];
        bands += fmt::format(
            "'curves.tsv' using 2:(bottom(${})):(bottom(${})) with filledcurves lc rgb '{}' fs transparent solid 0.25 "
            "noborder notitle, ",
            3 * k + 4, 3 * k + 5, colour);
        lines += fmt::format("'curves.tsv' using 2:{} with lines lw 1.5 lc rgb '{}' title {}, ", 3 * k + 3, colour,
                             in_quotes(name));
    }
    if (!(high > 0)) high = 1;
    std::string data = head + '\n';
    for (std::size_t bin = 0; bin < n; ++bin) {
        data += fmt::format("{}\t{:.9g}", bin, time_of(cube, double(bin)));
        for (const Curve& curve : all)
            data += fmt::format("\t{:.6g}\t{:.6g}\t{:.6g}", curve.Y[bin],
                                std::max(curve.Y[bin] - 2 * curve.se[bin], 0.0), curve.Y[bin] + 2 * curve.se[bin]);
        data += '\n';
    }
    lines.resize(lines.size() - 2);
    const double low = high * 3e-4, step = cube.in_unit(cube.time.bin_width_opl);
    const std::string what = radius == 0 ? "single pixels" : fmt::format("squares of {0} x {0} pixels", 2 * radius + 1);
    Plot plot;
    plot.data = {{"curves.tsv", data}};
    plot.pictures = {"curves.svg", "curves.png"};
    plot.commands = common() + fmt::format(
                                   "set datafile separator '\\t'\nset grid lc rgb '#d8d8d8'\nset key outside top "
                                   "center horizontal samplen 2\nset title {6} offset 0,-0.5\n"
                                   "set logscale y\nset format y '%.0e'\nset xrange [{4}:{5}]\nset yrange "
                                   "[{0}:{1}]\nbottom(y) = y < {0} ? {0} : y\nset xlabel {2}\nset ylabel {3}\n"
                                   "do for [picture in 'svg png'] {{\n"
                                   "if (picture eq 'svg') {{\nset terminal svg size 860,480 noenhanced font 'DejaVu "
                                   "Sans,14' background '#ffffff'\n"
                                   "}} else {{\nset terminal pngcairo size 1290,720 noenhanced font 'DejaVu Sans,14' "
                                   "fontscale 1.5 linewidth 1.5 background '#ffffff'\n}}\n"
                                   "set output 'curves.'.picture\nplot {7}\nunset output\n}}\n",
                                   low, 1.5 * high, in_quotes(time_words(cube)),
                                   in_quotes("luminance (W m⁻² sr⁻¹ per " + bin_words(cube) + ")"),
                                   time_of(cube, 0) - step / 2, time_of(cube, double(n)) - step / 2,
                                   in_quotes("means over " + what + ", ± 2 standard errors"), bands + lines);
    return plot;
}

}  // namespace loom::frames
