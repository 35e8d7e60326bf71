#pragma once
#include "stages/core/math/vector.h"

namespace loom {

/// Returns the irradiance of the sun, through the atmosphere, on a surface that faces it, in linear sRGB.
/// [HosekWilkie2013]
/// in:      turbidity          1...10
///          sun_elevation_rad  0...pi/2; clamped to at least 2 degrees, as in Mitsuba 3
/// out:     W m^-2 nm^-1; blue is slightly negative for a sun at the horizon, outside the gamut of sRGB
Rgb<double> solar_irradiance(double turbidity, double sun_elevation_rad);

/// Returns the radiance of the sun's disk relative to its mean.                           [HosekWilkie2013]
/// in:      mu  0 (limb) ... 1 (centre): cosine between the line of sight and the normal of the sun's surface
Rgb<double> limb_darkening(double mu);

}  // namespace loom
