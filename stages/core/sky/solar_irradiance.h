#pragma once
#include "stages/core/math/vector.h"

namespace loom {

/// Irradiance of the sun on a surface that faces it, through the air, in linear sRGB.      [HosekWilkie2013]
/// in:      turbidity          1...10
///          sun_elevation_rad  0...pi/2; that of 2 degrees below 2 degrees, as in Mitsuba 3
/// out:     W m^-2 nm^-1; blue is slightly negative for a sun at the horizon, which sRGB cannot show
Rgb<double> solar_irradiance(double turbidity, double sun_elevation_rad);

/// Radiance of the disk relative to its mean.                                             [HosekWilkie2013]
/// in:      mu  0 (limb) ... 1 (centre): cosine between the line of sight and the normal of the sun's surface
Rgb<double> limb_darkening(double mu);

}  // namespace loom
