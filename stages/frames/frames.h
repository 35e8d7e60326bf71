#pragma once
// loom-frames: pictures of a transient cube.

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
    std::string output;  // the strip of frames (.png); the other pictures lie beside it
    double exposure_ev = 0;
    double quantile = 0.99;                    // of the lit bins' luminance: what is white
    std::uint32_t count = 12;                  // frames of the strip
    std::optional<std::uint32_t> row, column;  // of the streaks; the middle
    std::vector<std::string> pixels;           // X:Y, of the curves; three of the middle column
    std::uint32_t radius = 2;                  // a curve is the mean over (2 radius + 1)^2 pixels around its own
    bool png = false, exr = false;             // each bin as a picture in frames/
    std::string movie;                         // .mp4
    double fps = 30;
};

void declare(app::Command& command, Options& options);

/// Writes the strip and, beside it, streak-x.png, streak-y.png, peak.png, curves.svg, .png, .tsv, .gp, on request
/// frames and a movie.
/// throws:  InputError for a file that is no cube, a row, column or pixel outside of it, or when gnuplot is missing
void run(const Options& options, app::Report& report);

/// Luminance of a bin of a pixel.                                                     W m^-2 sr^-1
double luminance_of(const TransientCube& cube, std::size_t pixel, std::size_t bin);
/// Where a bin is in the middle of being open, in the cube's unit.
double time_of(const TransientCube& cube, double bin);
/// "optical path length (m)", and "m" alone.
std::string time_words(const TransientCubeHeader& header);
std::string time_unit(const TransientCubeHeader& header);

/// The luminance that `share` of the lit bins do not exceed; 0 when all is dark.
double luminance_quantile(const TransientCube& cube, double share);
/// When most light arrives at each pixel, in the cube's unit: the largest bin after smoothing by (1 4 6 4 1) / 16; NaN
/// where all bins together have less than a hundredth of what half of the lit pixels have.
///   out: [y, x]
std::vector<float> peak_times(const TransientCube& cube);
/// Bins of the strip: evenly from where 0.5 % of the light has arrived to where 90 % has, the lamp seen directly
/// weighing no more than any other pixel.
std::vector<std::size_t> strip_bins(const TransientCube& cube, std::size_t count);

}  // namespace loom::frames
