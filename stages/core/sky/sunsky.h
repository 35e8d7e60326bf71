#pragma once
// The sun and the clear sky of the `sunsky` emitter of Mitsuba 0.6 and of Mitsuba 3, as a latitude-longitude map.
//
// Local frame: +y is up, +x east, -z north. A direction has a polar angle theta from +y and an azimuth phi from -z
// towards +x, like the columns of EnvironmentMap. In the frame of Mitsuba 3 +z is up: its x, y, z are the local z, x, y
// (sunsky_frame).

#include <string>
#include <vector>

#include "stages/core/math/frame.h"
#include "stages/core/math/vector.h"
#include "stages/core/sky/environment_map.h"

namespace loom {

class Object;

/// Place and time of the observer; the defaults are those of Mitsuba 0.6: Tokyo in summer, 3 pm.
struct SunTime {
    int year = 2010, month = 7, day = 10;      // Gregorian
    double hour = 15, minute = 0, second = 0;  // local time without daylight saving
    double latitude_deg = 35.6894;             // north positive
    double longitude_deg = 139.6917;           // east positive
    double timezone_h = 9;                     // local time minus universal time
};

/// Returns the unit local direction to the sun, with an error below 0.01 degrees between 1999 and 2015.   [Blanco2001]
/// differs: no refraction, like the source
Vector3<double> sun_direction_at(const SunTime& time);

/// Dialect of the model. Both have the same sky, except its unit (0.1 %) and negative values, which 0.6 sets to 0. The
/// sun of 0.6 is Preetham's. The sun of Mitsuba 3 is Hosek and Wilkie's, which is brighter by half, and by more near
/// the horizon.
enum class SunskyModel { mitsuba06, mitsuba3 };

struct Sunsky {
    SunskyModel model = SunskyModel::mitsuba06;
    double turbidity = 3;                                  // 1 (arctic) ... 10 (hazy)
    Rgb<double> albedo{0.2};                               // of the ground, 0...1
    Vector3<double> sun_direction = sun_direction_at({});  // local, unit; in 0.6 y >= 0
    double sky_scale = 1, sun_scale = 1;
    double sun_radius_scale = 1;  // factor on 0.2679 degrees, power kept; 0: the map has no sun
    bool limb_darkening = false;  // the disk is brighter at its centre, power kept; else it is uniform
    double stretch = 1;           // 1...2: factor on the zenith angles of sky and sun
    bool extend = false;          // the sky fades out below the horizon instead of ending there
    int width = 512, height = 256;
};

/// Reads the parameters of a `sunsky` emitter. `sun_direction` is in world space and becomes local by to_world; a sun
/// given by time and place is local already.
/// throws:  InputError at the parameter that is out of range, or when both kinds of position are given
Sunsky read_sunsky(const Object& emitter);

/// Returns the radiance of the sky alone from a local direction.                       [HosekWilkie2012]
///   L (1 + A e^(B / (cos theta + 0.01)))
///     (C + D e^(E gamma) + F cos^2 gamma + G chi(I, gamma) + H sqrt(cos theta))
///   chi(g, a) = (1 + cos^2 a) / (1 + g^2 - 2 g cos a)^(3/2)
/// in:      d   unit
/// out:     W m^-2 sr^-1 nm^-1, not negative, times sky_scale
/// differs: theta and gamma are the angles before stretching; below the horizon see Sunsky::extend
Rgb<double> sky_radiance(const Sunsky& sunsky, const Vector3<double>& d);

/// Returns the irradiance of the whole sun on a surface that faces it.       [Preetham1999] or [HosekWilkie2013]
///   0.6: the sun's radiance outside the atmosphere, times the transmittances of Rayleigh scattering, aerosol, ozone
///   and water vapour, as linear sRGB, times the solid angle of the unscaled disk; Mitsuba 3: solar_irradiance()
/// out:     W m^-2 nm^-1, times sun_scale
Rgb<double> sun_irradiance(const Sunsky& sunsky);

/// Computes sky and sun as a map (without its density). The integral over the sphere of the interpolated map contains
/// sun_irradiance() exactly, for any size of disk and map; in Mitsuba 3 without the part of the disk below the horizon.
/// A sun below the horizon gives a black map.
/// differs: `complex_sun` of Mitsuba 3 also dims the lower edge of a wide disk, as if it were the sun of that elevation
/// throws:  InputError when a member of `sunsky` is out of range
EnvironmentMap bake_sunsky(const Sunsky& sunsky);

/// Computes the map of a `sunsky` emitter.
/// throws:  InputError as read_sunsky(); also for sun_radius_scale = 0, whose directional sun no map can represent
/// out:     notes  when the sun is below the horizon
EnvironmentMap bake_sunsky(const Object& emitter, std::vector<std::string>& notes);

/// Returns the frame from local to world, for the axes of to_world of a `sunsky` emitter.
Frame<float> sunsky_frame(const Object& emitter, const Frame<float>& axes);

}  // namespace loom
