// The sunsky emitter: coefficients of the sky model, position and power of the sun, and the maps that
// Mitsuba 0.6 made of two published scenes.

#include "stages/core/scene/sunsky.h"

#include <gtest/gtest.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <string>

#include "formats/image.h"
#include "formats/io/error.h"
#include "stages/core/scene/description.h"
#include "stages/core/scene/sky_coefficients.h"

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

// Catches a table in another order (channels, albedos, turbidities or control points swapped): the curve goes
// through its first and last control points.
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
        EXPECT_NEAR(
            value(3.25, 0.4),
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
        expect_rgb(Rgb<double>(map.eval({0.25f, float((50 + offset_deg) / 180)})),
                   sun_irradiance(s) * (1 / cap), 0.01);
    for (double offset_deg : {-radius_deg - 1.5, radius_deg + 1.5})
        EXPECT_TRUE(is_black(map.eval({0.25f, float((50 + offset_deg) / 180)})));
}

// Catches light from below, and half a row lost or won at the horizon, in maps whose middle row lies on it
// too.
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
    EXPECT_NEAR(sky_radiance(s, map_direction(0.3, 0.75)).g / sky_radiance(s, map_direction(0.3, 0.5)).g, 0.5,
                1e-6);
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
    EXPECT_LT(read_parameters("<float name=\"hour\" value=\"17\"/>").sun_direction.y,
              defaults.sun_direction.y);
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
    EXPECT_NE(
        message("<float name=\"hour\" value=\"9\"/><vector name=\"sunDirection\" x=\"0\" y=\"1\" z=\"0\"/>")
            .find("sun_direction already"),
        std::string::npos);
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
            const bool away = dot(d, s.sun_direction) < away_cos,
                       near_horizon = std::abs(v - 0.5) < 1.0 / height;
            Rgb<double> rest;
            for (int c = 0; c < 3; ++c) {
                const double value = expected[(std::size_t(y) * width + x) * 3 + std::size_t(c)];
                rest[c] = value - sky[c];
                if (away && v < 0.5) worst_model = std::max(worst_model, std::abs(sky[c] / value - 1));
                if (away && v < 0.5 && !near_horizon)
                    worst_map = std::max(worst_map, std::abs(baked[c] / value - 1));
                if (away && v > 0.5 && !near_horizon)
                    worst_below = std::max({worst_below, double(baked[c]), value});
            }
            const double solid_angle =
                2 * pi_double * pi_double / (double(width) * height) * std::sin(pi_double * v);
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
                                         Published{
                                             "dining-room", {0.88698, 0.288862, 0.360313}, 30, 3.75345}),
                         [](const auto& info) {
                             std::string name = info.param.scene;
                             std::replace(name.begin(), name.end(), '-', '_');
                             return name;
                         });

}  // namespace
}  // namespace loom
