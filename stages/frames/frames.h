#pragma once
// loom-frames: images of a transient cube.

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "formats/transient_cube.h"

namespace loom::app {
class Command;
class Report;
}  // namespace loom::app

namespace loom::frames {

struct Options {
    std::string cube;    // transient cube (.h5)
    std::string output;  // the strip of frames (.png); the other images lie beside it
    double exposure_ev = 0;
    double quantile = 0.99;                    // of the nonzero bins' luminance; displayed as white
    std::uint32_t count = 12;                  // frames of the strip
    std::optional<std::uint32_t> row, column;  // of the streaks; default: the middle ones
    std::vector<std::string> pixels;           // X:Y, of the curves; default: three of the middle column
    std::uint32_t radius = 2;                  // a curve is the mean over (2 radius + 1)^2 pixels around its pixel
    bool png = false, exr = false;             // write each bin as an image in frames/
    std::string movie;                         // .mp4
    double fps = 30;
};

void declare(app::Command& command, Options& options);

/// Writes the strip and, beside it, streak-x.png, streak-y.png, peak.png, curves.svg, .png, .tsv, .gp, and on request
/// frames and a movie.
/// throws:  InputError for a file that is no cube, a row, column or pixel outside of it, or when gnuplot is missing
void run(const Options& options, app::Report& report);

/// Luminance of a bin of a pixel.                                                     W m^-2 sr^-1
double luminance_of(const TransientCube& cube, std::size_t pixel, std::size_t bin);
/// Time of the middle of a bin's gate, in the cube's unit.
double time_of(const TransientCube& cube, double bin);
/// Label of the time axis, "optical path length (m)", and its unit "m" alone.
std::string time_words(const TransientCubeHeader& header);
std::string time_unit(const TransientCubeHeader& header);

/// Luminance that the fraction `share` of the nonzero bins do not exceed; 0 when all bins are zero.
double luminance_quantile(const TransientCube& cube, double share);
/// Time of the strongest bin of each pixel, in the cube's unit, after smoothing by (1 4 6 4 1) / 16. NaN where the sum
/// of all bins is below a hundredth of the median sum of the nonzero pixels.
///   out: [y, x]
std::vector<float> peak_times(const TransientCube& cube);
/// Bins of the strip, evenly from the arrival of 0.5 % of the light to that of 90 %. A directly visible emitter weighs
/// no more than any other pixel.
std::vector<std::size_t> strip_bins(const TransientCube& cube, std::size_t count);

}  // namespace loom::frames
