// The sunsky emitter: coefficients of the sky model, position and power of the sun, and the maps that
// Mitsuba 0.6 made of two published scenes.

#include "stages/core/sky/sunsky.h"

#include <gtest/gtest.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <string>

#include "formats/image.h"
#include "formats/io/error.h"
#include "stages/core/description/description.h"
#include "stages/core/scene/build.h"
#include "stages/core/sky/sky_coefficients.h"
#include "stages/core/sky/solar_irradiance.h"
#include "tests/unit/scene_folder.h"

namespace loom {
namespace {

constexpr double rad_per_deg = pi_double / 180;

void expect_rgb(const Rgb<double>& got, const Rgb<double>& expected, double relative) {
    for (int c = 0; c < 3; ++c) EXPECT_NEAR(got[c], expected[c], relative * expected[c]) << "channel " << c;
}

Vector3<double> at_elevation(double elevation_deg) {
    return {std::cos(elevation_deg * rad_per_deg), std::sin(elevation_deg * rad_per_deg), 0};
}

Vector3<double> map_direction(double u, double v) {
    const double phi = 2 * pi_double * u, theta = pi_double * v;
    return {std::sin(phi) * std::sin(theta), std::cos(theta), -std::cos(phi) * std::sin(theta)};
}

/// Integral of the interpolated map over the sphere, by midpoints of n x n cells per texel.
Rgb<double> sphere_integral(const EnvironmentMap& map, int n) {
    const int width = map.width * n, height = map.height * n;
    Rgb<double> sum;
    for (int y = 0; y < height; ++y) {
        const double weight = std::sin((y + 0.5) / height * pi_double);
        for (int x = 0; x < width; ++x)
            sum += Rgb<double>(map.eval({float((x + 0.5) / width), float((y + 0.5) / height)})) * weight;
    }
    return sum * (2 * pi_double * pi_double / (double(width) * height));
}

// Detects a table in another order (channels, albedos, turbidities or control points swapped): the curve passes through
// its first and last control points.
TEST(SkyCoefficients, ends_of_the_curve_are_control_points) {
    const SkyCoefficients first = sky_coefficients(1, 0, 0, 0);
    EXPECT_DOUBLE_EQ(first.shape[0], -1.099459);
    EXPECT_DOUBLE_EQ(first.shape[8], 0.5127716);
    EXPECT_DOUBLE_EQ(first.radiance, 1.962684);
    const SkyCoefficients green = sky_coefficients(1, 1, 0, 1);
    EXPECT_DOUBLE_EQ(green.shape[0], -1.129907);
    const SkyCoefficients zenith = sky_coefficients(1, 0, pi_double / 2, 2);
    EXPECT_DOUBLE_EQ(zenith.shape[0], -1.087457);
    EXPECT_DOUBLE_EQ(zenith.shape[8], 0.499943);
    EXPECT_DOUBLE_EQ(zenith.radiance, 13.90238);
}

// Catches a wrong neighbour in turbidity, 10 among them, which has none above it.
TEST(SkyCoefficients, are_linear_in_turbidity_and_albedo) {
    for (int channel = 0; channel < 3; ++channel) {
        auto value = [&](double turbidity, double albedo) {
            return sky_coefficients(turbidity, albedo, 0.7, channel).radiance;
        };
        EXPECT_NEAR(value(3.25, 0.4),
                    0.75 * (0.6 * value(3, 0) + 0.4 * value(3, 1)) + 0.25 * (0.6 * value(4, 0) + 0.4 * value(4, 1)),
                    1e-12);
        EXPECT_NEAR(value(10, 0.3), 2 * value(9.5, 0.3) - value(9, 0.3), 1e-12);
    }
}

// Zenith radiances from a separate program; Mitsuba 3.8 has the same times 1.0010 (its observer's integral is
// 106.75 where that of 0.6 is 106.857). Catches a swap of the coefficients H and I, a wrong power, a wrong
// unit.
TEST(Sunsky, radiance_of_the_zenith) {
    const struct {
        double turbidity, albedo, elevation_deg;
        Rgb<double> radiance;
    } cases[] = {{3, 0.2, 45, {0.02259364, 0.03916389, 0.07938071}},
                 {1, 0.0, 10, {0.00689275, 0.01491243, 0.0270973}},
                 {10, 1.0, 90, {1.0194859, 0.95082861, 1.00323392}}};
    for (const auto& c : cases) {
        Sunsky s;
        s.turbidity = c.turbidity;
        s.albedo = Rgb<double>(c.albedo);
        s.sun_direction = at_elevation(c.elevation_deg);
        expect_rgb(sky_radiance(s, {0, 1, 0}), c.radiance, 1e-6);
    }
}

// Against the formulas of the Astronomical Almanac (0.01 degrees), worked out apart. Catches east for west,
// degrees for radians, a day lost in the calendar, the sign of the time zone.
TEST(Sunsky, position_of_the_sun) {
    const struct {
        SunTime time;
        Vector3<double> direction;
    } cases[] = {
        {{}, {-0.6917345, 0.7203223, 0.0513723}},
        {{2010, 3, 20, 17, 31, 59.88, 0, -81.15, 0}, {0.0001778, 1.0, 0.0000161}},  // equinox at the equator
        {{2004, 12, 21, 10, 15, 0, 52.52, 13.405, 1}, {0.4222341, 0.1799979, 0.8884363}},
    };
    for (const auto& c : cases) {
        const Vector3<double> d = sun_direction_at(c.time);
        EXPECT_NEAR(length(d), 1, 1e-12);
        EXPECT_LT(length(d - c.direction), 0.03 * rad_per_deg);
    }
}

// From a separate program with the gases' band kept. Catches a missing extinction, cm for m, nm for um.
TEST(Sunsky, irradiance_of_the_sun) {
    const struct {
        double elevation_deg;
        Rgb<double> irradiance;
    } cases[] = {{90, {1.46073349, 1.2410332, 1.07528069}},
                 {45, {1.31355735, 1.08008924, 0.87259924}},
                 {10, {0.44815529, 0.261561, 0.10341335}}};
    for (const auto& c : cases) {
        Sunsky s;
        s.sun_direction = at_elevation(c.elevation_deg);
        expect_rgb(sun_irradiance(s), c.irradiance, 1e-5);
    }
}

// Catches a sun that falls between texels, a pole without weight, a column lost where the map closes, power
// that grows with the radius. Azimuths near 0 cross the seam.
TEST(Sunsky, baked_disk_keeps_its_power_at_any_size_and_place) {
    for (double scale : {1e-15, 1.0, 18.8131, 100.0, 600.0})
        for (double elevation_deg : {0.0, 3.0, 41.0, 89.5, 90.0}) {
            Sunsky s;
            s.width = 64;
            s.height = 32;
            s.sky_scale = 0;
            s.sun_radius_scale = scale;
            const Vector3<double> d = at_elevation(elevation_deg);
            s.sun_direction = {0.02 * d.x, d.y, -std::sqrt(1 - 0.0004) * d.x};
            SCOPED_TRACE(testing::Message() << "scale " << scale << ", elevation " << elevation_deg);
            expect_rgb(sphere_integral(bake_sunsky(s), 16), sun_irradiance(s), 2e-3);
        }
}

// Catches a radius taken for a diameter: inside the disk the radiance is that of the power spread over its
// cap.
TEST(Sunsky, baked_disk_is_even_and_ends_at_its_radius) {
    Sunsky s;
    s.sky_scale = 0;
    s.sun_radius_scale = 40;
    s.sun_direction = at_elevation(40);
    const EnvironmentMap map = bake_sunsky(s);
    const double radius_deg = 40 * 0.5358 / 2;
    const double cap = 2 * pi_double * (1 - std::cos(radius_deg * rad_per_deg));
    for (double offset_deg : {-0.9 * radius_deg, 0.0, 0.5 * radius_deg, 0.9 * radius_deg})
        expect_rgb(Rgb<double>(map.eval({0.25f, float((50 + offset_deg) / 180)})), sun_irradiance(s) * (1 / cap), 0.01);
    for (double offset_deg : {-radius_deg - 1.5, radius_deg + 1.5})
        EXPECT_TRUE(is_black(map.eval({0.25f, float((50 + offset_deg) / 180)})));
}

// Detects light from below, and half a row lost or added at the horizon, also in maps whose middle row is on it.
TEST(Sunsky, horizon) {
    for (int height : {512, 513}) {
        Sunsky s;
        s.width = 64;
        s.height = height;
        s.sun_scale = 0;
        const EnvironmentMap map = bake_sunsky(s);
        const float below = 0.5f + 1.01f / float(height - 1);
        EXPECT_TRUE(is_black(map.eval({0.3f, below})));
        EXPECT_FALSE(is_black(map.eval({0.3f, 0.49f})));
        const double sky = sky_radiance(s, map_direction(0.3, 0.4999999)).g;
        EXPECT_NEAR(map.eval({0.3f, 0.5f}).g, 0.5 * sky, 0.05 * sky);
    }
    Sunsky s;
    s.extend = true;
    EXPECT_NEAR(sky_radiance(s, map_direction(0.3, 0.75)).g / sky_radiance(s, map_direction(0.3, 0.5)).g, 0.5, 1e-6);
    EXPECT_DOUBLE_EQ(sky_radiance(s, {0, -1, 0}).g, 0);
    s.extend = false;
    s.stretch = 1.5;
    EXPECT_GT(sky_radiance(s, map_direction(0.3, 0.74)).g, 0);
    EXPECT_DOUBLE_EQ(sky_radiance(s, map_direction(0.3, 0.76)).g, 0);
}

TEST(Sunsky, refuses_what_the_model_does_not_know) {
    auto refused = [](auto change) {
        Sunsky s;
        change(s);
        EXPECT_THROW(bake_sunsky(s), InputError);
    };
    refused([](Sunsky& s) { s.turbidity = 0.9; });
    refused([](Sunsky& s) { s.turbidity = 10.1; });
    refused([](Sunsky& s) { s.albedo.g = 1.5; });
    refused([](Sunsky& s) { s.stretch = 3; });
    refused([](Sunsky& s) { s.sun_direction = at_elevation(-1); });
    refused([](Sunsky& s) { s.sun_direction = {0, 0, 0}; });
    refused([](Sunsky& s) { s.sun_radius_scale = -1; });
    refused([](Sunsky& s) { s.sky_scale = std::nan(""); });
    refused([](Sunsky& s) { s.width = 1 << 20; });
}

/// The sunsky of a scene file of the 0.6 dialect with these parameters.
Sunsky read_parameters(const std::string& parameters) {
    const std::filesystem::path file =
        std::filesystem::path(testing::TempDir()) / ("sunsky_" + std::to_string(getpid()) + ".xml");
    std::ofstream(file) << "<scene version=\"0.6.0\"><sensor type=\"perspective\"/><emitter type=\"sunsky\">"
                        << parameters << "</emitter></scene>";
    struct Remove {
        std::filesystem::path path;
        ~Remove() { std::filesystem::remove(path); }
    } remove{file};
    return read_sunsky(*read_scene(file).root->child(Category::emitter));
}

// Catches a world direction used as a local one, and parameters that never arrive.
TEST(Sunsky, reads_the_emitter) {
    const Sunsky defaults = read_parameters("");
    EXPECT_DOUBLE_EQ(defaults.albedo.r, 0.2);
    EXPECT_NEAR(defaults.sun_direction.y, 0.7203, 1e-3);
    const Sunsky s = read_parameters(
        "<float name=\"turbidity\" value=\"5\"/><float name=\"skyScale\" value=\"6\"/>"
        "<float name=\"sunScale\" value=\"10\"/><float name=\"sunRadiusScale\" value=\"4\"/>"
        "<integer name=\"resolution\" value=\"128\"/>"
        "<vector name=\"sunDirection\" x=\"0\" y=\"0\" z=\"2\"/>"
        "<transform name=\"toWorld\"><rotate x=\"1\" angle=\"90\"/></transform>");
    EXPECT_EQ(s.turbidity, 5);
    EXPECT_EQ(s.sky_scale, 6);
    EXPECT_EQ(s.sun_scale, 10);
    EXPECT_EQ(s.sun_radius_scale, 4);
    EXPECT_EQ(s.width, 128);
    EXPECT_EQ(s.height, 64);
    EXPECT_LT(length(s.sun_direction - Vector3<double>(0, 1, 0)), 1e-6);
    EXPECT_LT(read_parameters("<float name=\"hour\" value=\"17\"/>").sun_direction.y, defaults.sun_direction.y);
}

TEST(Sunsky, refuses_parameters_with_their_place) {
    auto message = [](const std::string& parameters) {
        try {
            read_parameters(parameters);
        } catch (const InputError& e) {
            return std::string(e.what());
        }
        return std::string("accepted");
    };
    EXPECT_NE(message("<float name=\"turbidity\" value=\"11\"/>").find(":1:"), std::string::npos);
    EXPECT_NE(message("<float name=\"hour\" value=\"2\"/>").find("below the horizon"), std::string::npos);
    EXPECT_NE(message("<float name=\"hour\" value=\"9\"/><vector name=\"sunDirection\" x=\"0\" y=\"1\" z=\"0\"/>")
                  .find("sun_direction already"),
              std::string::npos);
}

/// A direction in the axes of Mitsuba 3, z up, in our local frame.
Vector3<double> from_mitsuba3(double x, double y, double z) {
    return normalize(Vector3<double>{y, z, x});
}

Sunsky mitsuba3(double turbidity, const Rgb<double>& albedo, const Vector3<double>& sun_direction) {
    Sunsky s;
    s.model = SunskyModel::mitsuba3;
    s.turbidity = turbidity;
    s.albedo = albedo;
    s.sun_direction = sun_direction;
    return s;
}

// Values of Mitsuba 3.8 (scalar_rgb). Detected mutations: the unit of 0.6, the red of the albedo for all channels.
TEST(SunskyOfMitsuba3, radiance_of_the_sky) {
    expect_rgb(
        sky_radiance(mitsuba3(2.5, {0.1, 0.4, 0.8}, from_mitsuba3(-0.5, 0.1, 0.6)), from_mitsuba3(0.2, 0.7, 0.3)),
        {0.04014985, 0.09411535, 0.2139836}, 2e-4);
    expect_rgb(
        sky_radiance(mitsuba3(7.75, Rgb<double>(0.3), from_mitsuba3(0.2, -0.9, 0.15)), from_mitsuba3(-0.2, -0.4, 0.9)),
        {0.02307143, 0.02938412, 0.03777083}, 2e-4);
    expect_rgb(sky_radiance(mitsuba3(1, Rgb<double>(0), from_mitsuba3(1, 0, 0.02)), from_mitsuba3(-1, 0.2, 0.05)),
               {0.07191439, 0.04228583, 0.01152206}, 2e-4);
    expect_rgb(sky_radiance(mitsuba3(10, Rgb<double>(1), from_mitsuba3(0, 0.3, 0.9)), from_mitsuba3(0, 0.35, 0.9)),
               {1.379344, 1.388928, 1.131967}, 2e-4);
}

// Values of Mitsuba 3.8: radiance of a uniform disk times its solid angle, between nodes of the table and at its ends.
// Detected mutations: turbidity or elevation rounded down, elevations off by a node, the irradiance of 0.6.
TEST(SunskyOfMitsuba3, irradiance_of_the_sun) {
    const struct {
        double turbidity, elevation_deg;
        Rgb<double> irradiance;
    } cases[] = {{3.25, 31.7, {1.388346, 1.09873, 0.7444983}},
                 {1, 0.5, {0.4847667, 0.1381548, -0.007581025}},
                 {9.5, 8, {0.100806, 0.04634067, 0.01440934}},
                 {10, 90, {1.028523, 0.835419, 0.6759872}},
                 {5, 45, {1.362077, 1.109993, 0.8208589}}};
    for (const auto& c : cases) {
        const Rgb<double> got = sun_irradiance(mitsuba3(c.turbidity, Rgb<double>(0.3), at_elevation(c.elevation_deg)));
        for (int k = 0; k < 3; ++k)
            EXPECT_NEAR(got[k], c.irradiance[k], 2e-4 * std::abs(c.irradiance[k])) << c.turbidity << ", channel " << k;
    }
}

class SunskyScene : public SceneFolder {
  protected:
    std::unique_ptr<Scene> scene_of(const std::string& parameters, const char* version = "3.0.0") const {
        return load_scene(write("scene.xml", text("<emitter type='sunsky'>" + parameters + "</emitter>", version)));
    }
    static Rgb<double> towards(const Scene& scene, double x, double y, double z) {
        return Rgb<double>(environment(scene, Vector3f(normalize(Vector3<double>{x, y, z}))));
    }
};

// Values of Mitsuba 3.8. Detected mutations: sun_direction or the frame with y up, the azimuth by time mirrored, the
// albedo of 0.6.
TEST_F(SunskyScene, axes_of_mitsuba3) {
    const auto turned = scene_of(
        "<float name='turbidity' value='2.5'/><float name='sun_scale' value='0'/><float name='sky_scale' value='2'/>"
        "<vector name='sun_direction' x='-0.5' y='0.1' z='0.6'/><transform name='to_world'><rotate x='1' "
        "angle='30'/></transform>");
    expect_rgb(towards(*turned, 0.2, 0.7, 0.6), {0.1791244, 0.2829599, 0.4135344}, 0.01);
    EXPECT_EQ(towards(*turned, 0.2, 0.8, -0.7), Rgb<double>());
    const auto morning = scene_of("<float name='hour' value='9'/><float name='sun_scale' value='0'/>");
    expect_rgb(towards(*morning, 0.2, 0.7, 0.6), {0.02843528, 0.05568999, 0.1134275}, 0.01);
    expect_rgb(towards(*morning, 0.2, -0.7, 0.6), {0.138165, 0.1730851, 0.227314}, 0.01);
    EXPECT_EQ(towards(*morning, 0.2, -0.7, -0.6), Rgb<double>());
    // A 0.x file has y up and the albedo of 0.6.
    EXPECT_GT(towards(*scene_of("", "0.6.0"), 0.5, 0.5, -0.7).r, 0);
    EXPECT_EQ(towards(*scene_of("", "0.6.0"), 0.5, -0.5, 0.7), Rgb<double>());
}

// Detected mutations: an aperture used as a radius, the irradiance of 0.6, no limb darkening, limb darkening that
// changes the power of a sun of three texels, a disk that extends below the horizon.
TEST_F(SunskyScene, sun_of_mitsuba3) {
    const std::string place =
        "<float name='sky_scale' value='0'/><vector name='sun_direction' x='0' y='0.8' z='0.6'/><float "
        "name='sun_aperture' value='20'/>";
    const auto even = scene_of(place), dark = scene_of(place + "<boolean name='complex_sun' value='true'/>");
    const Rgb<double> irradiance = solar_irradiance(3, std::asin(0.6));
    const double cap = 2 * pi_double * (1 - std::cos(10 * rad_per_deg)), tilt = std::atan2(0.6, 0.8);
    const auto at = [&](const Scene& scene, double off_deg) {
        return towards(scene, 0, std::cos(tilt + off_deg * rad_per_deg), std::sin(tilt + off_deg * rad_per_deg));
    };
    for (double off : {0.0, 5.0, -9.0}) expect_rgb(at(*even, off), irradiance * (1 / cap), 0.01);
    EXPECT_EQ(at(*even, 11), Rgb<double>());
    EXPECT_NEAR(at(*dark, 0).b / at(*even, 0).b, 1.32, 0.01);       // Mitsuba 3.8: 1.320
    EXPECT_NEAR(at(*dark, 9.5).b / at(*even, 9.5).b, 0.635, 0.01);  // 0.635
    const std::string small = "<float name='sky_scale' value='0'/><vector name='sun_direction' x='0' y='0.8' z='0.6'/>";
    expect_rgb(sphere_integral(*scene_of(small + "<boolean name='complex_sun' value='true'/>")->emitters[0].map, 1),
               sphere_integral(*scene_of(small)->emitters[0].map, 1), 0.002);
    const auto low = scene_of(
        "<float name='sky_scale' value='0'/><vector name='sun_direction' x='0' y='1' z='0.05'/><float "
        "name='sun_aperture' value='20'/>");
    EXPECT_GT(towards(*low, 0, 1, 0.02).r, 0);
    EXPECT_EQ(towards(*low, 0, 1, -0.02), Rgb<double>());
}

// Detected mutations: Mitsuba 3's defaults in 0.x files, apertures of any size, a sky at night.
TEST_F(SunskyScene, parameters_are_those_of_the_dialect) {
    EXPECT_NE(error_of([&] { scene_of("<float name='stretch' value='1.5'/>"); }).find("has no parameter 'stretch'"),
              std::string::npos);
    EXPECT_NE(
        error_of([&] { scene_of("<float name='sun_aperture' value='180'/>"); }).find("must be less than 180 degrees"),
        std::string::npos);
    const auto old = scene_of("<float name='sunAperture' value='20'/>", "0.6.0");
    EXPECT_NE(old->notes.back().find("has no parameter 'sunAperture'"), std::string::npos);
    const auto night = scene_of("<float name='hour' value='1'/>");
    EXPECT_EQ(towards(*night, 0, 0, 1), Rgb<double>());
    EXPECT_NE(night->notes[night->notes.size() - 2].find("the sun is below the horizon"), std::string::npos);
}

struct Published {
    const char* scene;
    Vector3<double> sun_direction;
    double sky_scale, sun_radius_scale;
};
class PublishedSunsky : public testing::TestWithParam<Published> {};

// The answer of Mitsuba 0.6 itself; its map has values at the centres of its rows. Catches a ground that is
// not 0.2, a mirrored or turned map, a sky or sun in other units.
TEST_P(PublishedSunsky, agrees_with_the_map_of_mitsuba_06) {
    const Published& p = GetParam();
    const std::filesystem::path file =
        std::filesystem::path(LOOM_SOURCE_DIR) / "../shared/scenes" / p.scene / "textures/sunsky.exr";
    if (!std::filesystem::exists(file)) GTEST_SKIP() << "no " << file << " to compare with";
    const Image image = read_image(file);
    const std::vector<float> expected = image.interleaved("");

    Sunsky s;
    s.sun_direction = normalize(p.sun_direction);
    s.sky_scale = p.sky_scale;
    s.sun_scale = 10;
    s.sun_radius_scale = p.sun_radius_scale;
    const EnvironmentMap map = bake_sunsky(s);
    const int width = int(image.width), height = int(image.height);
    const double away_cos = std::cos((0.5358 / 2 * p.sun_radius_scale + 2) * rad_per_deg);
    double worst_model = 0, worst_map = 0, worst_below = 0;
    Rgb<double> sun;
    Vector3<double> sun_moment;
    for (int y = 0; y < height; ++y)
        for (int x = 0; x < width; ++x) {
            const double u = (x + 0.5) / width, v = (y + 0.5) / height;
            const Vector3<double> d = map_direction(u, v);
            const Rgb<double> sky = sky_radiance(s, d);
            const Spectrum baked = map.eval({float(u), float(v)});
            const bool away = dot(d, s.sun_direction) < away_cos, near_horizon = std::abs(v - 0.5) < 1.0 / height;
            Rgb<double> rest;
            for (int c = 0; c < 3; ++c) {
                const double value = expected[(std::size_t(y) * width + x) * 3 + std::size_t(c)];
                rest[c] = value - sky[c];
                if (away && v < 0.5) worst_model = std::max(worst_model, std::abs(sky[c] / value - 1));
                if (away && v < 0.5 && !near_horizon) worst_map = std::max(worst_map, std::abs(baked[c] / value - 1));
                if (away && v > 0.5 && !near_horizon) worst_below = std::max({worst_below, double(baked[c]), value});
            }
            const double solid_angle = 2 * pi_double * pi_double / (double(width) * height) * std::sin(pi_double * v);
            sun += rest * solid_angle;
            sun_moment = sun_moment + d * (rest.g * solid_angle);
        }
    RecordProperty("worst_model", std::to_string(worst_model));
    RecordProperty("worst_map", std::to_string(worst_map));
    EXPECT_LT(worst_model, 1e-5);
    EXPECT_LT(worst_map, 0.01);
    EXPECT_EQ(worst_below, 0);
    EXPECT_LT(length(normalize(sun_moment) - s.sun_direction), 0.02 * rad_per_deg);
    expect_rgb(sun_irradiance(s), sun, 0.001);
    s.sky_scale = 0;
    expect_rgb(sphere_integral(bake_sunsky(s), 4), sun, 0.005);
}

INSTANTIATE_TEST_SUITE_P(Sunsky, PublishedSunsky,
                         testing::Values(Published{"classroom", {-0.865804, 0.416766, -0.276929}, 6, 18.8131},
                                         Published{"dining-room", {0.88698, 0.288862, 0.360313}, 30, 3.75345}),
                         [](const auto& info) {
                             std::string name = info.param.scene;
                             std::replace(name.begin(), name.end(), '-', '_');
                             return name;
                         });

}  // namespace
}  // namespace loom
