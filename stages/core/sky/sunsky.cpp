#include "stages/core/sky/sunsky.h"

#include <tbb/parallel_for.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <string>
#include <vector>

#include "formats/io/error.h"
#include "stages/core/description/description.h"
#include "stages/core/description/spectrum.h"
#include "stages/core/sky/sky_coefficients.h"
#include "stages/core/sky/solar_irradiance.h"

namespace loom {
namespace {

constexpr double half_pi = pi_double / 2, two_pi = 2 * pi_double, rad_per_deg = pi_double / 180;
constexpr double sun_radius_rad = 0.5358 / 2 * rad_per_deg;  // mean over the year, as in Mitsuba 0.6
// The data set is an integral over the observer. This is the integral of the observer's y (in 0.6 the sum at 1 nm), so
// that radiances are per nm like the sun's.
double sky_unit(SunskyModel model) {
    return model == SunskyModel::mitsuba06 ? 106.856980 : 106.7502593994140625;
}
constexpr int max_width = 16384;

double polar_angle(const Vector3<double>& d) {
    return std::acos(clamp(d.y, -1.0, 1.0));
}
double azimuth(const Vector3<double>& d) {
    return std::atan2(d.x, -d.z);
}

/// The sky dome of a Sunsky with computed coefficients.
class Dome {
  public:
    explicit Dome(const Sunsky& s)
        : stretch_(s.stretch),
          scale_(s.sky_scale / sky_unit(s.model)),
          lowest_(s.model == SunskyModel::mitsuba06 ? 0.0 : -std::numeric_limits<double>::infinity()),
          extend_(s.extend) {
        sun_theta_ = polar_angle(s.sun_direction);
        sun_phi_ = azimuth(s.sun_direction);
        for (int c = 0; c < 3; ++c)
            channels_[c] = sky_coefficients(s.turbidity, s.albedo[c], std::max(half_pi - sun_theta_, 0.0), c);
    }

    /// Returns the zenith angle at which the sky ends.
    double horizon() const { return stretch_ * half_pi; }

    /// Returns the radiance at a polar angle of the map; beyond the horizon that of the horizon.
    Rgb<double> radiance(double theta, double phi) const {
        const double sky_theta = std::min(theta / stretch_, half_pi);
        const double cos_theta = std::max(std::cos(sky_theta), 0.0), sin_theta = std::sin(sky_theta);
        const double cos_gamma = clamp(
            cos_theta * std::cos(sun_theta_) + sin_theta * std::sin(sun_theta_) * std::cos(phi - sun_phi_), -1.0, 1.0);
        const double gamma = std::acos(cos_gamma), cos2_gamma = cos_gamma * cos_gamma;
        Rgb<double> result;
        for (int c = 0; c < 3; ++c) {
            const auto& [a, b, cc, d, e, f, g, h, i] = channels_[c].shape;
            const double chi = (1 + cos2_gamma) / std::pow(1 + i * i - 2 * i * cos_gamma, 1.5);
            const double shape = (1 + a * std::exp(b / (cos_theta + 0.01))) *
                                 (cc + d * std::exp(e * gamma) + f * cos2_gamma + g * chi + h * std::sqrt(cos_theta));
            result[c] = std::max(shape * channels_[c].radiance, lowest_) * scale_ * fade(theta);
        }
        return result;
    }

  private:
    double fade(double theta) const {
        if (!extend_) return 1;
        const double t = clamp(2 - theta / half_pi, 0.0, 1.0);
        return t * t * (3 - 2 * t);
    }

    double stretch_, scale_, lowest_;
    bool extend_;
    double sun_theta_ = 0, sun_phi_ = 0;
    SkyCoefficients channels_[3];
};

/// Evaluates a curve of (nm, value) pairs, linear between them; 0 outside.
double curve_at(const SampledSpectrum& curve, double nm) {
    if (nm < curve.front().first || nm > curve.back().first) return 0;
    std::size_t i = 1;
    while (i + 1 < curve.size() && curve[i].first < nm) ++i;
    const auto& [x0, y0] = curve[i - 1];
    const auto& [x1, y1] = curve[i];
    return y0 + (y1 - y0) * (nm - x0) / (x1 - x0);
}

/// Returns the sun's radiance outside the atmosphere, W m^-2 sr^-1 nm^-1.          [Preetham1999] table 2
const SampledSpectrum& sun_outside() {
    static const SampledSpectrum curve = [] {
        constexpr double first_nm = 380, step_nm = 10;
        constexpr double values[] = {16559.0, 16233.7, 21127.5, 25888.2, 25829.1, 24232.3, 26760.5, 29658.3,
                                     30545.4, 30057.5, 30663.7, 28830.4, 28712.1, 27825.0, 27100.6, 27233.6,
                                     26361.3, 25503.8, 25060.2, 25311.6, 25355.9, 25134.2, 24631.5, 24173.2,
                                     23685.3, 23212.1, 22827.7, 22339.8, 21970.2, 21526.7, 21097.9, 20728.3,
                                     20240.4, 19870.8, 19427.2, 19072.4, 18628.9, 18259.2};
        SampledSpectrum samples;
        for (double value : values) samples.emplace_back(first_nm + step_nm * double(samples.size()), value);
        return samples;
    }();
    return curve;
}

/// Returns the absorption by ozone, cm^-1, over the wavelengths of sun_outside().  [Preetham1999]
const SampledSpectrum& ozone() {
    static const SampledSpectrum curve = {
        {355, 0},     {445, 0.003}, {450, 0.003}, {455, 0.004}, {460, 0.006}, {465, 0.008}, {470, 0.009},
        {475, 0.012}, {480, 0.014}, {485, 0.017}, {490, 0.021}, {495, 0.025}, {500, 0.03},  {505, 0.035},
        {510, 0.04},  {515, 0.045}, {520, 0.048}, {525, 0.057}, {530, 0.063}, {535, 0.07},  {540, 0.075},
        {545, 0.08},  {550, 0.085}, {555, 0.095}, {560, 0.103}, {565, 0.11},  {570, 0.12},  {575, 0.122},
        {580, 0.12},  {585, 0.118}, {590, 0.115}, {595, 0.12},  {600, 0.125}, {605, 0.13},  {610, 0.12},
        {620, 0.105}, {630, 0.09},  {640, 0.079}, {650, 0.067}, {660, 0.057}, {670, 0.048}, {680, 0.036},
        {690, 0.028}, {700, 0.023}, {710, 0.018}, {720, 0.014}, {730, 0.011}, {740, 0.01},  {750, 0.009}};
    return curve;
}

/// Returns the absorption by water vapour, cm^-1, over the wavelengths of sun_outside().   [Preetham1999]
const SampledSpectrum& water_vapour() {
    static const SampledSpectrum curve = {{689, 0}, {690, 0.016}, {700, 0.024}, {710, 0.0125},
                                          {720, 1}, {730, 0.87},  {740, 0.061}, {750, 0.001}};
    return curve;
}

/// Returns the radiance of the sun through the atmosphere. Absorption by mixed gases is left out: its bands begin at
/// 759 nm, beyond the end of the sun's table.   [Preetham1999]
SampledSpectrum sun_radiance(double turbidity, double sun_theta) {
    constexpr double ozone_cm = 0.35, water_cm = 2, aerosol_exponent = 1.3;
    const double beta = 0.04608365822050 * turbidity - 0.04586025928522;  // amount of aerosol
    const double air_mass = 1 / (std::cos(sun_theta) + 0.15 * std::pow(93.885 - sun_theta / rad_per_deg, -1.253));
    SampledSpectrum result;
    for (double nm = 350; nm <= 800; nm += 5) {
        const double um = nm / 1000;
        const double water = curve_at(water_vapour(), nm) * water_cm * air_mass;
        const double optical_depth =
            air_mass * (0.008735 * std::pow(um, -4.08) + beta * std::pow(um, -aerosol_exponent) +
                        curve_at(ozone(), nm) * ozone_cm) +
            0.2385 * water / std::pow(1 + 20.07 * water, 0.45);
        result.emplace_back(nm, curve_at(sun_outside(), nm) * std::exp(-optical_depth));
    }
    return result;
}

/// Returns the fraction of the disk's power in each texel. The disk is integrated by lines of latitude, whose ends have
/// a closed form: no sample can miss a small sun, and a large one has no noise.
std::vector<double> disk_shares(double sun_theta, double sun_phi, double radius, int width, int height) {
    radius = std::max(radius, 1e-6);  // far below a texel, far above rounding
    const double low = std::max(sun_theta - radius, 0.0), high = std::min(sun_theta + radius, pi_double);
    const double row_rad = pi_double / (height - 1), column_rad = two_pi / width;
    const int n_lines = std::max(1024, int(std::ceil((high - low) / row_rad)) * 64);
    std::vector<double> shares(std::size_t(width) * height);
    double total = 0;
    for (int line = 0; line < n_lines; ++line) {
        const double theta = low + (high - low) * (line + 0.5) / n_lines;
        const double sin_theta = std::sin(theta), sin_product = sin_theta * std::sin(sun_theta);
        // Haversine of half the line: cos would cancel for a small disk.
        const double above = sqr(std::sin(radius / 2)) - sqr(std::sin((theta - sun_theta) / 2));
        const double half =
            above >= sin_product ? pi_double : 2 * std::asin(std::sqrt(std::max(above, 0.0) / sin_product));
        const double power = 2 * half * sin_theta;
        total += power;
        double* row = &shares[std::size_t(std::lround(theta / row_rad)) * width];
        if (row == &shares.front() || row == &shares[std::size_t(height - 1) * width]) {
            for (int x = 0; x < width; ++x) row[x] += power / width;  // a pole is one point
            continue;
        }
        const double from = (sun_phi - half) / column_rad, to = (sun_phi + half) / column_rad;
        for (int x = int(std::floor(from)); x < to; ++x) {
            const double covered = std::min(to, x + 1.0) - std::max(from, double(x));
            row[((x % width) + width) % width] += std::max(covered, 0.0) * column_rad * sin_theta;
        }
    }
    for (double& share : shares) share /= total;
    return shares;
}

/// Returns the solid angle of a texel in this row when the map is interpolated between its rows and columns.
double texel_solid_angle(int row, int width, int height) {
    const double step = pi_double / (height - 1);
    const bool pole = row == 0 || row == height - 1;
    const double over_theta = pole ? 1 - std::sin(step) / step : 2 * std::sin(row * step) * (1 - std::cos(step)) / step;
    return two_pi / width * over_theta;
}

struct Fault {
    const char* parameter = nullptr;  // null: valid
    const char* message = nullptr;
};
Fault find_fault(const Sunsky& s) {
    auto within = [](double x, double low, double high) { return x >= low && x <= high; };
    constexpr double largest = 1e30;
    if (!within(s.turbidity, 1, 10)) return {"turbidity", "must lie in 1...10"};
    for (int c = 0; c < 3; ++c)
        if (!within(s.albedo[c], 0, 1)) return {"albedo", "must lie in 0...1"};
    if (!within(s.stretch, 1, 2)) return {"stretch", "must lie in 1...2"};
    if (!within(s.sky_scale, 0, largest)) return {"sky_scale", "must be finite and not negative"};
    if (!within(s.sun_scale, 0, largest)) return {"sun_scale", "must be finite and not negative"};
    if (!within(s.sun_radius_scale, 0, pi_double / sun_radius_rad))
        return {"sun_radius_scale", "must lie between 0 and that of a sun that fills the sphere (671)"};
    if (!within(length2(s.sun_direction), 0.999, 1.001)) return {"sun_direction", "must be a direction"};
    if (s.model == SunskyModel::mitsuba06 && !(s.sun_direction.y >= 0))
        return {"sun_direction", "the sun is below the horizon; the sky model has no night"};
    if (s.width < 4 || s.width > max_width || s.height < 2 || s.height > max_width)
        return {"resolution", "must lie in 4...16384"};
    return {};
}

}  // namespace

Vector3<double> sun_direction_at(const SunTime& t) {
    const double hours_ut = t.hour - t.timezone_h + (t.minute + t.second / 60) / 60;
    // Days since noon of 1 January 2000; the divisions drop fractions (Gregorian calendar to Julian day).
    const int shift = (t.month - 14) / 12;
    const int julian_day = 1461 * (t.year + 4800 + shift) / 4 + 367 * (t.month - 2 - 12 * shift) / 12 -
                           3 * ((t.year + 4900 + shift) / 100) / 4 + t.day - 32075;
    const double days = julian_day - 0.5 + hours_ut / 24 - 2451545.0;

    const double node = 2.1429 - 0.0010394594 * days;
    const double anomaly = 6.2400600 + 0.0172019699 * days;
    const double ecliptic_longitude = 4.8950630 + 0.017202791698 * days + 0.03341607 * std::sin(anomaly) +
                                      0.00034894 * std::sin(2 * anomaly) - 0.0001134 - 0.0000203 * std::sin(node);
    const double obliquity = 0.4090928 - 6.2140e-9 * days + 0.0000396 * std::cos(node);

    const double right_ascension =
        std::atan2(std::cos(obliquity) * std::sin(ecliptic_longitude), std::cos(ecliptic_longitude));
    const double declination = std::asin(std::sin(obliquity) * std::sin(ecliptic_longitude));
    const double sidereal_hours = 6.6974243242 + 0.0657098283 * days + hours_ut;
    const double hour_angle = (sidereal_hours * 15 + t.longitude_deg) * rad_per_deg - right_ascension;

    const double latitude = t.latitude_deg * rad_per_deg;
    const double cos_zenith =
        std::cos(latitude) * std::cos(hour_angle) * std::cos(declination) + std::sin(declination) * std::sin(latitude);
    const double from_centre = std::acos(clamp(cos_zenith, -1.0, 1.0));
    constexpr double parallax = 6371.01 / 149597890;  // radius of the Earth over that of its orbit
    const double theta = from_centre + parallax * std::sin(from_centre);
    const double phi = std::atan2(
        -std::sin(hour_angle), std::tan(declination) * std::cos(latitude) - std::sin(latitude) * std::cos(hour_angle));
    return {std::sin(phi) * std::sin(theta), std::cos(theta), -std::cos(phi) * std::sin(theta)};
}

Sunsky read_sunsky(const Object& o) {
    Sunsky s;
    if (!o.legacy) {
        s.model = SunskyModel::mitsuba3;
        s.albedo = Rgb<double>(0.3);
        s.width = 2048;  // three texels across the sun
        const double aperture = o.get_double("sun_aperture", 2 * sun_radius_rad / rad_per_deg);
        if (!(aperture < 180)) o.fail("sun_aperture", "must be less than 180 degrees");
        s.sun_radius_scale = 0.5 * aperture * rad_per_deg / sun_radius_rad;
        s.limb_darkening = o.get_bool("complex_sun", false);
    }
    s.turbidity = o.get_double("turbidity", s.turbidity);
    if (o.has("albedo")) s.albedo = Rgb<double>(o.get_rgb("albedo"));
    if (o.legacy) s.sky_scale = s.sun_scale = o.get_double("scale", 1.0);
    s.sky_scale = o.get_double("sky_scale", s.sky_scale);
    s.sun_scale = o.get_double("sun_scale", s.sun_scale);
    s.sun_radius_scale = o.get_double("sun_radius_scale", s.sun_radius_scale);
    s.stretch = o.get_double("stretch", s.stretch);
    s.extend = o.get_bool("extend", s.extend);
    s.width = o.get_int("resolution", s.width);
    s.height = s.width / 2;
    if (o.has("sun_direction")) {
        for (const char* name :
             {"year", "month", "day", "hour", "minute", "second", "latitude", "longitude", "timezone"})
            if (o.has(name)) o.fail(name, "the position of the sun is given by sun_direction already");
        const Matrix4d world = o.get_transform("to_world");
        const Vector3<double> d = o.get_vector("sun_direction", {});
        // The environment rotates with the directions of the axes of to_world; their lengths have no effect.
        for (int axis = 0; axis < 3; ++axis)
            s.sun_direction[axis] = dot(d, normalize(Vector3<double>(world(0, axis), world(1, axis), world(2, axis))));
        if (!(length2(s.sun_direction) > 0)) o.fail("sun_direction", "the direction has no length");
        s.sun_direction = normalize(s.sun_direction);
        if (s.model == SunskyModel::mitsuba3)
            s.sun_direction = {s.sun_direction.y, s.sun_direction.z, s.sun_direction.x};
    } else {
        SunTime t;
        t.year = o.get_int("year", t.year);
        t.month = o.get_int("month", t.month);
        t.day = o.get_int("day", t.day);
        t.hour = o.get_double("hour", t.hour);
        t.minute = o.get_double("minute", t.minute);
        t.second = o.get_double("second", t.second);
        t.latitude_deg = o.get_double("latitude", t.latitude_deg);
        t.longitude_deg = o.get_double("longitude", t.longitude_deg);
        t.timezone_h = o.get_double("timezone", t.timezone_h);
        if (t.year < 1 || t.year > 9999) o.fail("year", "must lie in 1...9999");
        if (t.month < 1 || t.month > 12) o.fail("month", "must lie in 1...12");
        if (t.day < 1 || t.day > 31) o.fail("day", "must lie in 1...31");
        s.sun_direction = sun_direction_at(t);
        // Mitsuba 3 has x to the south and y to the west.
        if (s.model == SunskyModel::mitsuba3) s.sun_direction.x = -s.sun_direction.x;
    }
    if (const Fault fault = find_fault(s); fault.parameter) o.fail(fault.parameter, fault.message);
    return s;
}

Rgb<double> sky_radiance(const Sunsky& sunsky, const Vector3<double>& d) {
    const Dome dome(sunsky);
    const double theta = polar_angle(d);
    if (theta > dome.horizon() && !sunsky.extend) return {};
    return dome.radiance(theta, azimuth(d));
}

Rgb<double> sun_irradiance(const Sunsky& s) {
    if (s.model == SunskyModel::mitsuba3)
        return solar_irradiance(s.turbidity, half_pi - polar_angle(s.sun_direction)) * s.sun_scale;
    const SampledSpectrum spectrum = sun_radiance(s.turbidity, polar_angle(s.sun_direction));
    const double solid_angle = 2 * two_pi * sqr(std::sin(sun_radius_rad / 2));
    return Rgb<double>(rgb_from_spectrum(spectrum, SpectrumUse::emission)) * (solid_angle * s.sun_scale);
}

namespace {

/// Adds the sky to a map of zeros.
void bake_sky(const Sunsky& s, EnvironmentMap& map) {
    const Dome dome(s);
    const double row_rad = pi_double / (s.height - 1);
    tbb::parallel_for(0, s.height, [&](int y) {
        // A row covers half a row above and below it; the horizon may cut through.
        const double above = s.extend ? 1 : clamp(0.5 * s.stretch * (s.height - 1) - y + 0.5, 0.0, 1.0);
        if (above == 0) return;
        for (int x = 0; x < s.width; ++x)
            map.texels[std::size_t(y) * s.width + x] =
                Spectrum(dome.radiance(y * row_rad, (x + 0.5) * two_pi / s.width) * above);
    });
}

/// Adds the sun to a map.
void bake_sun(const Sunsky& s, EnvironmentMap& map) {
    const double theta = polar_angle(s.sun_direction) * s.stretch, phi = azimuth(s.sun_direction),
                 radius = sun_radius_rad * s.sun_radius_scale;
    const double row_rad = pi_double / (s.height - 1), column_rad = two_pi / s.width;
    const std::vector<double> shares = disk_shares(theta, phi, radius, s.width, s.height);
    const auto profile = [&](std::size_t texel) {
        if (!s.limb_darkening) return Rgb<double>(1);
        const std::size_t row = texel / std::size_t(s.width), column = texel % std::size_t(s.width);
        const double at_theta = double(row) * row_rad, at_phi = (double(column) + 0.5) * column_rad;
        const double cos_gamma =
            std::cos(theta) * std::cos(at_theta) + std::sin(theta) * std::sin(at_theta) * std::cos(at_phi - phi);
        const double from_centre =
            std::min(std::sin(std::acos(clamp(cos_gamma, 0.0, 1.0))) / std::sin(std::min(radius, half_pi)), 1.0);
        return limb_darkening(std::sqrt(1 - sqr(from_centre)));
    };
    Rgb<double> total;
    for (std::size_t i = 0; i < shares.size(); ++i)
        if (shares[i] > 0) total += profile(i) * shares[i];
    const Rgb<double> irradiance = sun_irradiance(s);
    const int last_row = s.model == SunskyModel::mitsuba3 ? (s.height - 1) / 2 : s.height - 1;
    for (std::size_t i = 0; i < std::size_t(last_row + 1) * s.width; ++i) {
        if (shares[i] == 0) continue;
        const Rgb<double> share =
            profile(i) * (shares[i] / texel_solid_angle(int(i / std::size_t(s.width)), s.width, s.height));
        for (int c = 0; c < 3; ++c) map.texels[i][c] += float(irradiance[c] * share[c] / total[c]);
    }
}

}  // namespace

EnvironmentMap bake_sunsky(const Sunsky& s) {
    if (const Fault fault = find_fault(s); fault.parameter)
        throw InputError(std::string("sunsky: ") + fault.parameter + ": " + fault.message);
    EnvironmentMap map;
    map.width = s.width;
    map.height = s.height;
    map.texels.resize(std::size_t(s.width) * s.height);
    if (s.sun_direction.y < 0) return map;  // the model has no night sky
    if (s.sky_scale > 0) bake_sky(s, map);
    if (s.sun_radius_scale > 0 && s.sun_scale > 0) bake_sun(s, map);
    return map;
}

EnvironmentMap bake_sunsky(const Object& emitter, std::vector<std::string>& notes) {
    const Sunsky sunsky = read_sunsky(emitter);
    if (sunsky.sun_radius_scale == 0)
        emitter.fail("sun_radius_scale", "0 (a directional sun) is not supported; a sun of 1 is smaller than a texel");
    if (sunsky.sun_direction.y < 0)
        notes.push_back("sunsky: the sun is below the horizon; it gives no light, nor does the sky");
    return bake_sunsky(sunsky);
}

Framef sunsky_frame(const Object& emitter, const Framef& axes) {
    if (emitter.legacy) return axes;
    return {axes.t, Vector3f(axes.n), Normal3f(axes.s)};
}

}  // namespace loom
