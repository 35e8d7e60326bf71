#pragma once
// loom-frames: images of a transient cube.

#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "formats/transient_cube.h"

namespace loom::app {
class Command;
class Report;
}  // namespace loom::app

namespace loom::frames {

struct Options {
    std::string cube;                 // transient cube (.h5), or the first image of an animation (.exr)
    std::vector<std::string> images;  // further images
    std::string output;               // the strip of frames (.png); the other images lie beside it
    double exposure_ev = 0;
    double quantile = 0.99;                    // of the nonzero bins' luminance; displayed as white or as full colour
    std::uint32_t count = 12;                  // frames of the strip
    std::optional<std::uint32_t> row, column;  // of the streaks; default: the middle ones
    std::vector<std::string> pixels;           // X:Y, of the curves; default: three of the middle column
    std::uint32_t radius = 2;                  // a curve is the mean over (2 radius + 1)^2 pixels around its pixel
    bool png = false, exr = false;             // write each bin as an image in frames/
    std::string movie;                         // .mp4
    std::string parameter;                     // draws its derivative instead of the value
    bool derivatives = false;                  // also draws all derivatives, each in a folder of its own
    double fps = 30;
};

void declare(app::Command& command, Options& options);

/// Writes the strip and, beside it, streak-x.png, streak-y.png, peak.png (of a derivative steady.png), curves.svg, .png,
/// .tsv, .gp, and on request frames and a movie. Derivatives that are drawn besides the value lie in derivative-NAME/.
/// throws:  InputError for a file that is no cube, a row, column or pixel outside of it, a parameter that it lacks, or
///          when gnuplot is missing
void run(const Options& options, app::Report& report);

/// Derivative of a cube by one parameter.
struct DerivativeView {
    std::span<const float> values, var_mean;  // [y, x, bin, channel]
    std::span<const float> steady;            // [y, x, channel]
    std::string name, unit;                   // of the parameter, as labels
};
/// needs:   parameter_idx < number of the cube's parameters
DerivativeView derivative_view(const TransientCube& cube, std::size_t parameter_idx);
/// throws:  InputError when the cube has no derivatives, naming the commands that make some
void require_derivatives(const TransientCube& cube, const std::string& file);
/// Index of a parameter of the cube.
/// throws:  InputError naming those that are there
std::size_t parameter_of(const TransientCube& cube, const std::string& name, const std::string& file);
/// Folder of each parameter's images: derivative-NAME, NAME with other characters than letters, digits, '-', '_', '.'
/// replaced by '_', at most 80 of them; a number is added where two would agree.
std::vector<std::string> derivative_folders(const std::vector<std::string>& names);
/// A text from a file as a label: without control characters and invalid UTF-8, at most `longest` characters.
std::string label_of(const std::string& text, std::size_t longest = 40);

/// Luminance of a bin of a pixel.                                                     W m^-2 sr^-1
double luminance_of(const TransientCube& cube, std::size_t pixel, std::size_t bin);
double luminance_of(std::span<const float> values, std::size_t n_bins, std::size_t pixel, std::size_t bin);
/// Time of the middle of a bin's gate, in the cube's unit.
double time_of(const TransientCube& cube, double bin);
/// Label of the time axis, "optical path length (m)", and its unit "m" alone.
std::string time_words(const TransientCubeHeader& header);
std::string time_unit(const TransientCubeHeader& header);

/// Value that the fraction `share` of some values do not exceed; 0 without any. Reorders them.
double quantile_of(std::vector<float>& values, double share);
/// Luminance that the fraction `share` of the nonzero bins do not exceed; 0 when all bins are zero.
double luminance_quantile(const TransientCube& cube, double share);
/// Absolute luminance that the fraction `share` of the nonzero bins of a derivative do not exceed; 0 when all are zero.
double derivative_quantile(const TransientCube& cube, const DerivativeView& derivative, double share);
/// Time of the strongest bin of each pixel, in the cube's unit, after smoothing by (1 4 6 4 1) / 16. NaN where the sum
/// of all bins is below a hundredth of the median sum of the nonzero pixels.
///   out: [y, x]
std::vector<float> peak_times(const TransientCube& cube);
/// Bins of the strip, evenly from the arrival of 0.5 % of the light to that of 90 %. A directly visible emitter weighs
/// no more than any other pixel.
std::vector<std::size_t> strip_bins(const TransientCube& cube, std::size_t count);

}  // namespace loom::frames
