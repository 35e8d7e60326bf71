#include "stages/frames/pictures.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>

#include "formats/image.h"
#include "stages/core/math/vector.h"
#include "stages/core/plot/false_colours.h"
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

/// The signed colour map as a palette of gnuplot.
std::string signed_palette() {
    constexpr int n_colours = 65;
    std::string stops;
    for (int i = 0; i < n_colours; ++i) {
        const std::array<float, 3> linear = signed_colour(2.0 * i / (n_colours - 1) - 1);
        stops += fmt::format("{}{} '#", i == 0 ? "" : ", ", i);
        for (const float c : linear) stops += fmt::format("{:02x}", std::lround(255 * srgb_from_linear(double(c))));
        stops += "'";
    }
    return "set palette defined (" + stops + ")\n";
}

/// Unit of the derivative of one bin.
std::string per_bin(const DerivativeView& derivative) {
    const bool has_unit = !derivative.unit.empty() && derivative.unit != "1";
    return "W m⁻² sr⁻¹ per bin" + (has_unit ? " per " + derivative.unit : std::string());
}

std::string common() {
    return "set encoding utf8\nset border lw 0.7 lc rgb '#444444'\nset tics out nomirror textcolor rgb '#222222'\nset "
           "format '%g'\nunset key\n";
}

/// Luminance over time and position along a row and a column.
struct Streaks {
    std::vector<float> x;  // [bin, x]
    std::vector<float> y;  // [y, bin]
};

Streaks streaks_of(const TransientCube& cube, std::span<const float> values, std::size_t row, std::size_t column) {
    const std::size_t w = cube.film.width, h = cube.film.height, n = cube.time.n_bins;
    Streaks s{std::vector<float>(w * n), std::vector<float>(h * n)};
    for (std::size_t bin = 0; bin < n; ++bin) {
        for (std::size_t i = 0; i < w; ++i) s.x[bin * w + i] = float(luminance_of(values, n, row * w + i, bin));
        for (std::size_t i = 0; i < h; ++i) s.y[i * n + bin] = float(luminance_of(values, n, i * w + column, bin));
    }
    return s;
}

/// Draws streaks in the colours that `colours` sets.
Plot streak_plot(const TransientCube& cube, const Streaks& streaks, std::size_t row, std::size_t column,
                 const std::string& colours) {
    const std::size_t w = cube.film.width, h = cube.film.height, n = cube.time.n_bins;
    const double t0 = time_of(cube, 0), step = cube.in_unit(cube.time.bin_width_opl), first = t0 - step / 2,
                 last = first + step * double(n);
    Plot plot;
    plot.data = {{"streak-x.bin", bytes_of(streaks.x)}, {"streak-y.bin", bytes_of(streaks.y)}};
    plot.pictures = {"streak-x.png", "streak-y.png"};
    plot.commands = common() + colours;
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

}  // namespace

Plot streaks(const TransientCube& cube, std::size_t row, std::size_t column) {
    const Streaks s = streaks_of(cube, {cube.radiance.data(), cube.radiance.size()}, row, column);
    std::vector<float> lit;
    for (const auto* values : {&s.x, &s.y})
        for (float value : *values)
            if (value > 0) lit.push_back(value);
    std::sort(lit.begin(), lit.end());
    const double high = lit.empty() ? 1 : double(lit[std::size_t(0.995 * double(lit.size() - 1))]), low = high / 1000;
    return streak_plot(
        cube, s, row, column,
        brightness +
            fmt::format("set logscale cb\nset cbrange [{}:{}]\nset cblabel {}\nset format cb '%.0e'\n"
                        "set object 1 rectangle from graph 0,0 to graph 1,1 behind fc rgb '#000004' fs noborder\n",
                        low, high, in_quotes("luminance (W m⁻² sr⁻¹ per " + bin_words(cube) + ")")));
}

Plot derivative_streaks(const TransientCube& cube, const DerivativeView& derivative, std::size_t row,
                        std::size_t column) {
    Streaks s = streaks_of(cube, derivative.values, row, column);
    std::vector<float> sizes;
    for (const auto* values : {&s.x, &s.y})
        for (const float value : *values)
            if (value != 0 && std::isfinite(value)) sizes.push_back(std::abs(value));
    std::sort(sizes.begin(), sizes.end());
    double reach = sizes.empty() ? 1 : double(sizes[std::size_t(0.995 * double(sizes.size() - 1))]);
    reach = std::stod(fmt::format("{:.0e}", reach));  // for round tics
    // The colour is asinh(d / linear) / asinh(reach / linear).
    constexpr double linear_share = 0.01;
    const double all = std::asinh(1 / linear_share);
    for (auto* values : {&s.x, &s.y})
        for (float& value : *values) value = float(std::asinh(double(value) / (linear_share * reach)) / all);
    std::string tics;
    for (const double share : {-1.0, -0.1, -0.01, 0.0, 0.01, 0.1, 1.0})
        tics += fmt::format("{}{} {}", tics.empty() ? "" : ", ",
                            in_quotes(share == 0 ? "0" : fmt::format("{:+.0e}", share * reach)),
                            std::asinh(share / linear_share) / all);
    const std::string title = fmt::format("derivative by {} ({})", derivative.name, per_bin(derivative));
    return streak_plot(
        cube, s, row, column,
        signed_palette() +
            fmt::format("set cbrange [-1:1]\nset rmargin 11\nset cbtics ({})\nset title {}\n", tics, in_quotes(title)));
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

namespace {

/// Layout of a strip, and how a tile is drawn.
struct Tiles {
    std::string title;
    std::string colours;                                   // commands before the first tile
    std::string format;                                    // of the numbers of a pixel, and how they are drawn
    std::function<std::string(std::size_t)> bytes_of_bin;  // [y, x]
    double foot = 0;                                       // px below the tiles
};

Plot tiled(const TransientCube& cube, const std::string& name, const std::vector<std::size_t>& bins,
           const Tiles& tiles) {
    const std::size_t w = cube.film.width, h = cube.film.height, columns = std::min<std::size_t>(4, bins.size()),
                      lines = (bins.size() + columns - 1) / columns;
    // A whole number of screen pixels per image pixel, where the image is small.
    const double zoom = w > 240 ? 240.0 / double(w) : std::ceil(240.0 / double(w)), tile_w = zoom * double(w),
                 tile_h = zoom * double(h);
    constexpr double gap = 8, head = 22, title = 34;
    const double width = double(columns) * (tile_w + gap) + gap,
                 height = double(lines) * (tile_h + head) + gap + title + tiles.foot;
    std::string bytes;
    Plot plot;
    plot.commands = common() + terminal(name, int(width), int(height)) + "unset tics\n" + tiles.colours +
                    fmt::format(
                        "set multiplot\nset xrange [0:{0}]\nset yrange [{1}:0]\nset label 1 {2} at screen 0.5, screen "
                        "{3} center\n",
                        w, h, in_quotes(tiles.title), 1 - 0.5 * title / height);
    if (tiles.foot > 0)
        plot.commands +=
            fmt::format("set colorbox horizontal user origin screen {}, screen {} size screen {}, screen {}\n", 0.2,
                        0.55 * tiles.foot / height, 0.6, 0.3 * tiles.foot / height);
    for (std::size_t i = 0; i < bins.size(); ++i) {
        const std::size_t skip = bytes.size();
        bytes += tiles.bytes_of_bin(bins[i]);
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
            "plot 'strip.bin' binary array=({},{}) skip={} origin=(0.5,0.5) dx=1 dy=1 {}\nunset label 1\nunset "
            "colorbox\n",
            w, h, skip, tiles.format);
    }
    plot.commands += "unset multiplot\n";
    plot.data = {{"strip.bin", bytes}};
    plot.pictures = {name};
    return plot;
}

}  // namespace

Plot strip(const TransientCube& cube, const std::string& name, const std::vector<std::size_t>& bins, double white) {
    Tiles tiles;
    tiles.title = fmt::format("frames, each a {}; white is {:.3g} W m⁻² sr⁻¹", bin_words(cube), white);
    tiles.format = "format='%uchar' using 1:2:3 with rgbimage";
    tiles.bytes_of_bin = [&](std::size_t bin) {
        std::string bytes;
        for (std::size_t pixel = 0; pixel < cube.n_pixels(); ++pixel)
            for (std::size_t c = 0; c < 3; ++c)
                bytes += char(std::lround(
                    255 * srgb_from_linear(double(cube.radiance[3 * (pixel * cube.time.n_bins + bin) + c]) / white)));
        return bytes;
    };
    return tiled(cube, name, bins, tiles);
}

Plot derivative_strip(const TransientCube& cube, const DerivativeView& derivative, const std::string& name,
                      const std::vector<std::size_t>& bins, double reach) {
    Tiles tiles;
    tiles.title =
        fmt::format("derivative by {} ({}), frames, each a {}", derivative.name, per_bin(derivative), bin_words(cube));
    tiles.colours = signed_palette() + fmt::format("set cbrange [{0}:{1}]\nset cbtics ({2} {0}, '0' 0, {3} {1})\n",
                                                   -reach, reach, in_quotes(fmt::format("{:+.2g}", -reach)),
                                                   in_quotes(fmt::format("{:+.2g}", reach)));
    tiles.format = "format='%float' using 1 with image";
    tiles.bytes_of_bin = [&](std::size_t bin) {
        std::vector<float> values(cube.n_pixels());
        for (std::size_t pixel = 0; pixel < values.size(); ++pixel)
            values[pixel] = float(luminance_of(derivative.values, cube.time.n_bins, pixel, bin));
        return bytes_of(values);
    };
    tiles.foot = 44;
    return tiled(cube, name, bins, tiles);
}

namespace {

/// Mean luminance over a square of pixels, and its standard error, per bin.
struct Curve {
    std::vector<double> Y, se;
};

Curve curve_of(const TransientCube& cube, std::span<const float> values, std::span<const float> var_mean,
               std::size_t pixel, std::size_t radius) {
    const std::size_t w = cube.film.width, h = cube.film.height, n = cube.time.n_bins;
    Curve curve{std::vector<double>(n), std::vector<double>(n)};
    const std::size_t x = pixel % w, y = pixel / w;
    const std::size_t x0 = x - std::min(radius, x), x1 = std::min(x + radius + 1, w), y0 = y - std::min(radius, y),
                      y1 = std::min(y + radius + 1, h);
    const double area = double((x1 - x0) * (y1 - y0));
    for (std::size_t bin = 0; bin < n; ++bin) {
        Rgb<double> var;
        for (std::size_t j = y0; j < y1; ++j)
            for (std::size_t i = x0; i < x1; ++i) {
                curve.Y[bin] += luminance_of(values, n, j * w + i, bin) / area;
                const float* v = var_mean.data() + 3 * ((j * w + i) * n + bin);
                var += Rgb<double>(v[0], v[1], v[2]);
            }
        // Channels of a path are correlated: their standard deviations add up.
        curve.se[bin] = luminance(Rgb<double>(std::sqrt(var[0]), std::sqrt(var[1]), std::sqrt(var[2]))) / area;
    }
    return curve;
}

/// Largest absolute mean of the curves; 1 when all are zero.
double reach_of(const std::vector<Curve>& curves) {
    double reach = 0;
    for (const Curve& curve : curves)
        for (const double Y : curve.Y)
            if (std::isfinite(Y)) reach = std::max(reach, std::abs(Y));
    return reach > 0 ? reach : 1;
}

}  // namespace

Plot curves(const TransientCube& cube, const std::vector<std::size_t>& pixels, std::size_t radius,
            const DerivativeView* derivative) {
    constexpr std::array<const char*, 6> colours{"#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#555555"};
    const std::size_t w = cube.film.width, n = cube.time.n_bins, columns = derivative ? 6 : 3;
    std::vector<Curve> of_value, of_derivative;
    std::string head = fmt::format("bin\t{}", time_unit(cube)), bands, lines, signed_bands, signed_lines;
    for (std::size_t k = 0; k < pixels.size(); ++k) {
        of_value.push_back(curve_of(cube, {cube.radiance.data(), cube.radiance.size()},
                                    {cube.var_mean.data(), cube.var_mean.size()}, pixels[k], radius));
        const std::string name = fmt::format("{}:{}", pixels[k] % w, pixels[k] / w);
        head += fmt::format("\t{0}\t{0} low\t{0} high", name);
        const char* colour = colours[k % colours.size()];
        const std::size_t column = columns * k + 3;
        bands += fmt::format(
            "'curves.tsv' using 2:(bottom(${})):(bottom(${})) with filledcurves lc rgb '{}' fs transparent solid 0.25 "
            "noborder notitle, ",
            column + 1, column + 2, colour);
        lines += fmt::format("'curves.tsv' using 2:{} with lines lw 1.5 lc rgb '{}' title {}, ", column, colour,
                             in_quotes(name));
        if (!derivative) continue;
        of_derivative.push_back(curve_of(cube, derivative->values, derivative->var_mean, pixels[k], radius));
        head += fmt::format("\t{0} derivative\t{0} derivative low\t{0} derivative high", name);
        signed_bands += fmt::format(
            "'curves.tsv' using 2:{}:{} with filledcurves lc rgb '{}' fs transparent solid 0.25 noborder notitle, ",
            column + 4, column + 5, colour);
        signed_lines +=
            fmt::format("'curves.tsv' using 2:{} with lines lw 1.5 lc rgb '{}' notitle, ", column + 3, colour);
    }
    std::string data = head + '\n';
    for (std::size_t bin = 0; bin < n; ++bin) {
        data += fmt::format("{}\t{:.9g}", bin, time_of(cube, double(bin)));
        for (std::size_t k = 0; k < pixels.size(); ++k) {
            const double Y = of_value[k].Y[bin], se = of_value[k].se[bin];
            data += fmt::format("\t{:.6g}\t{:.6g}\t{:.6g}", Y, std::max(Y - 2 * se, 0.0), Y + 2 * se);
            if (!derivative) continue;
            const double d = of_derivative[k].Y[bin], d_se = of_derivative[k].se[bin];
            data += fmt::format("\t{:.6g}\t{:.6g}\t{:.6g}", d, d - 2 * d_se, d + 2 * d_se);
        }
        data += '\n';
    }
    lines.resize(lines.size() - 2);
    const double high = reach_of(of_value), low = high * 3e-4, step = cube.in_unit(cube.time.bin_width_opl);
    const std::string what = radius == 0 ? "single pixels" : fmt::format("squares of {0} x {0} pixels", 2 * radius + 1);
    std::string panels = fmt::format("plot {}", bands + lines);
    if (derivative) {
        signed_lines.resize(signed_lines.size() - 2);
        const double reach = 1.25 * reach_of(of_derivative);
        panels = fmt::format(
            "set multiplot layout 2,1\nset lmargin 14\nunset xlabel\n{0}\nunset logscale y\nset format y '%g'\nunset "
            "key\nset "
            "xlabel {5}\nset yrange [{1}:{2}]\nset title {3}\nset ylabel {6}\nset xzeroaxis lt 1 lw 0.8 lc "
            "rgb '#222222'\nplot {4}\nunset "
            "multiplot",
            panels, -reach, reach, in_quotes("derivative by " + derivative->name), signed_bands + signed_lines,
            in_quotes(time_words(cube)), in_quotes(per_bin(*derivative)));
    }
    Plot plot;
    plot.data = {{"curves.tsv", data}};
    plot.pictures = {"curves.svg", "curves.png"};
    plot.commands =
        common() + fmt::format(
                       "set datafile separator '\\t'\nset grid lc rgb '#d8d8d8'\nset xrange [{4}:{5}]\n"
                       "bottom(y) = y < {0} ? {0} : y\n"
                       "do for [picture in 'svg png'] {{\n"
                       "if (picture eq 'svg') {{\nset terminal svg size 860,{8} noenhanced font 'DejaVu "
                       "Sans,14' background '#ffffff'\n"
                       "}} else {{\nset terminal pngcairo size 1290,{9} noenhanced font 'DejaVu Sans,14' "
                       "fontscale 1.5 linewidth 1.5 background '#ffffff'\n}}\n"
                       "set output 'curves.'.picture\n"
                       "set xlabel {2}\nset key outside top center horizontal samplen 2\nset title {6} offset "
                       "0,-0.5\nset logscale y\n"
                       "set format y '%.0e'\nset yrange [{0}:{1}]\nset ylabel {3}\n{7}\nunset output\n}}\n",
                       low, 1.5 * high, in_quotes(time_words(cube)),
                       in_quotes("luminance (W m⁻² sr⁻¹ per " + bin_words(cube) + ")"), time_of(cube, 0) - step / 2,
                       time_of(cube, double(n)) - step / 2, in_quotes("means over " + what + ", ± 2 standard errors"),
                       panels, derivative ? 860 : 480, derivative ? 1290 : 720);
    return plot;
}

}  // namespace loom::frames
