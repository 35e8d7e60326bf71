#pragma once
// What gnuplot is told and given to draw a cube.

#include <map>
#include <string>
#include <vector>

#include "stages/frames/frames.h"

namespace loom::frames {

/// Commands that make `pictures`, and what they read.
struct Plot {
    std::string commands;
    std::map<std::string, std::string> data;
    std::vector<std::string> pictures;
};

/// Luminance over time and place through row y and column x, on one logarithmic scale: streak-x.png, streak-y.png.
Plot streaks(const TransientCube& cube, std::size_t row, std::size_t column);
/// Times of the peak as colours: peak.png.
Plot peak(const TransientCube& cube);
/// Frames side by side under their times; `white` is shown as white.
Plot strip(const TransientCube& cube, const std::string& name, const std::vector<std::size_t>& bins, double white);
/// Luminance over time with bands of two standard errors, of squares of pixels around some: curves.svg, curves.png;
/// data curves.tsv. Pixels are independent of each other, so that the bands are as sure as the cube's variances.
Plot curves(const TransientCube& cube, const std::vector<std::size_t>& pixels, std::size_t radius);

}  // namespace loom::frames
