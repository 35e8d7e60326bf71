#include "stages/frames/doppler.h"

#include <fmt/format.h>

#include <cmath>

#include "stages/core/app/report.h"
#include "stages/core/plot/false_colours.h"
#include "stages/core/plot/gnuplot.h"

namespace loom::frames {
namespace {

namespace fs = std::filesystem;

/// Mean over all pixels of each bin, as lines: middle of the bin, luminance.
std::string mean_spectrum(const Column<float>& spectrum, const DopplerHeader::Bins& bins, double& peak) {
    std::vector<double> sums(bins.n);
    for (std::size_t i = 0; i < spectrum.size(); ++i) sums[i % bins.n] += double(spectrum[i]);
    std::string text;
    for (std::uint32_t k = 0; k < bins.n; ++k) {
        const double mean = sums[k] * bins.n / double(spectrum.size());
        peak = std::max(peak, mean);
        text += fmt::format("{:.9g}\t{:.6g}\n", bins.start + (k + 0.5) * bins.width, mean);
    }
    return text;
}

}  // namespace

Image velocity_image(const Doppler& doppler) {
    Image image;
    image.width = doppler.film.width;
    image.height = doppler.film.height;
    image.samples = doppler.film.samples_per_pixel;
    std::vector<float> rgb(3 * doppler.n_pixels());
    for (std::size_t i = 0; i < rgb.size(); ++i) rgb[i] = doppler.light[i / 3] > 0 ? doppler.velocity[i / 3] : NAN;
    image.set_layer("", "RGB", rgb);
    return image;
}

Plot spectra(const Doppler& doppler) {
    const bool has_beat = doppler.beat_bins.n > 0;
    double peak = 0, beat_peak = 0;
    Plot plot;
    plot.data["beat.tsv"] = "velocity m/s\tluminance\n" + mean_spectrum(doppler.spectrum, doppler.velocity_bins, peak);
    if (has_beat)
        plot.data["beat.tsv"] += "\n\nbeat Hz\tluminance\n" + mean_spectrum(doppler.beat, doppler.beat_bins, beat_peak);
    const auto panel = [](const std::string& label, const DopplerHeader::Bins& bins, double high, int block) {
        return fmt::format(
            "set xrange [{:.9g}:{:.9g}]\nset yrange [{:.6g}:{:.6g}]\nset xlabel {}\n"
            "plot 'beat.tsv' index {} every ::1 using 1:2 with histeps lw 1.5 lc rgb '#0072b2' notitle\n",
            bins.start, bins.start + bins.n * bins.width, high > 0 ? high * 3e-5 : 1e-6, high > 0 ? high * 1.5 : 1.0,
            plot::in_quotes(label), block);
    };
    std::string panels = panel("velocity (m/s), positive recedes", doppler.velocity_bins, peak, 0);
    if (has_beat)
        panels = "set multiplot layout 2,1\n" + panels + panel("beat frequency (Hz)", doppler.beat_bins, beat_peak, 1) +
                 "unset multiplot\n";
    plot.pictures = {"beat.svg", "beat.png"};
    plot.commands = fmt::format(
        "set encoding utf8\nset border lw 0.7 lc rgb '#444444'\nset tics out nomirror\nset grid lc rgb '#d8d8d8'\nset "
        "datafile separator '\\t'\nset lmargin 12\nset logscale y\nset format y '%.0e'\nset ylabel {0}\n"
        "do for [picture in 'svg png'] {{\n"
        "if (picture eq 'svg') {{\nset terminal svg size 860,{1} noenhanced font 'DejaVu Sans,14' background "
        "'#ffffff'\n"
        "}} else {{\nset terminal pngcairo size 1290,{2} noenhanced font 'DejaVu Sans,14' fontscale 1.5 linewidth 1.5 "
        "background '#ffffff'\n}}\nset output 'beat.'.picture\n{3}unset output\n}}\n",
        plot::in_quotes("W m⁻² sr⁻¹ per bin"), has_beat ? 760 : 400, has_beat ? 1140 : 600, panels);
    return plot;
}

void draw_doppler(const Options& options, app::Report& report) {
    const Doppler doppler = read_doppler(options.cube);
    const fs::path output = options.output;
    write_png(false_colours(velocity_image(doppler), "", 0), output);
    const Plot plot = spectra(doppler);
    plot::make_pictures(output.parent_path().empty() ? fs::path(".") : output.parent_path(),
                        {{"beat.gp", "# gnuplot beat.gp\n" + plot.commands}, *plot.data.begin()}, "beat.gp",
                        plot.pictures);
    report.done("{}: velocities of {} x {} pixels, and beat.svg", options.output, doppler.film.width,
                doppler.film.height);
}

}  // namespace loom::frames
