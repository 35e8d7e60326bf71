#pragma once
#include <array>

#include "stages/core/math/vector.h"

namespace loom {

inline constexpr int n_sky_coefficients = 9;

/// Shape and level of the Hosek-Wilkie sky dome in one channel of linear sRGB.
struct SkyCoefficients {
    std::array<double, n_sky_coefficients> shape{};  // A...I of sky_radiance()
    double radiance = 0;                             // level, in the unit of the data set (sky_unit in sunsky.cpp)
};

/// Interpolates the coefficients of the model.                                    [HosekWilkie2012]
///   quintic Bezier curve over t = (elevation / 90 degrees)^(1/3), linear in turbidity and albedo
/// in:      turbidity          1...10
///          albedo             0...1    of the ground, in this channel
///          sun_elevation_rad  0...pi/2
///          channel            0...2    R, G, B
SkyCoefficients sky_coefficients(double turbidity, double albedo, double sun_elevation_rad, int channel);

}  // namespace loom
