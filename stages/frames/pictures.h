#pragma once
// Commands and data with which gnuplot draws a cube.

#include <map>
#include <string>
#include <vector>

#include "stages/frames/frames.h"

namespace loom::frames {

/// Commands that make `pictures`, and the data that they read.
struct Plot {
    std::string commands;
    std::map<std::string, std::string> data;
    std::vector<std::string> pictures;
};

/// Plots luminance over time and position along row y and column x, on one logarithmic scale: streak-x.png,
/// streak-y.png.
Plot streaks(const TransientCube& cube, std::size_t row, std::size_t column);
/// Plots the times of the peak as colours: peak.png.
Plot peak(const TransientCube& cube);
/// Plots frames side by side under their times; luminance `white` is displayed as white.
Plot strip(const TransientCube& cube, const std::string& name, const std::vector<std::size_t>& bins, double white);
/// Plots luminance over time, of squares around given pixels, with bands of two standard errors: curves.svg,
/// curves.png; data curves.tsv. Pixels are independent of each other, so the bands are as reliable as the cube's
/// variances. With a derivative, plots it below the value.
Plot curves(const TransientCube& cube, const std::vector<std::size_t>& pixels, std::size_t radius,
            const DerivativeView* derivative = nullptr);

/// Plots a derivative over time and position, as streaks() does: blue below 0, white at 0, red above, on one signed
/// scale, linear within +-reach / 100 and logarithmic up to +-reach.
Plot derivative_streaks(const TransientCube& cube, const DerivativeView& derivative, std::size_t row,
                        std::size_t column);
/// Plots frames of a derivative as strip() does; full colour is +-reach.
Plot derivative_strip(const TransientCube& cube, const DerivativeView& derivative, const std::string& name,
                      const std::vector<std::size_t>& bins, double reach);

}  // namespace loom::frames
