// Images of a transient cube, from handmade cubes.

#include "stages/frames/frames.h"

#include <gtest/gtest.h>

#include <cmath>

#include "formats/io/error.h"
#include "stages/frames/pictures.h"

namespace loom::frames {
namespace {

/// Grey light in single bins.
struct HandMade {
    TransientCube cube;
    std::vector<float> radiance;
    HandMade(std::uint32_t width, std::uint32_t height, std::uint32_t bins)
        : radiance(std::size_t(width) * height * bins * 3) {
        cube.film = {width, height, 10};
        cube.time = {bins, 2, 0.5, 0.5, "opl", 1, 1};
    }
    HandMade& set(std::size_t pixel, std::size_t bin, float value) {
        for (std::size_t c = 0; c < 3; ++c) radiance[3 * (pixel * cube.time.n_bins + bin) + c] = value;
        return *this;
    }
    const TransientCube& get() {
        cube.radiance = radiance;
        cube.var_mean = std::vector<float>(radiance.size(), 0.0004f);
        return cube;
    }
};

TEST(Frames, TimesAreMiddlesOfBinsInTheUnitOfTheCube) {
    HandMade made(1, 1, 4);
    EXPECT_DOUBLE_EQ(time_of(made.get(), 0), 2.25);
    EXPECT_DOUBLE_EQ(time_of(made.get(), 3), 3.75);
    EXPECT_EQ(time_words(made.cube), "optical path length (m)");
    made.cube.time.metres_per_unit = 0.01;
    EXPECT_EQ(time_words(made.cube), "optical path length (units of the scene)");
    made.cube.time.unit = "ns";
    EXPECT_EQ(time_words(made.cube), "time of flight (ns)");
    EXPECT_DOUBLE_EQ(time_of(made.cube, 0), 2.25 * 0.01 / 0.299792458);
    made.cube.time.gate_opl = 1.5;  // open for longer than from bin to bin
    EXPECT_DOUBLE_EQ(time_of(made.cube, 0), 2.75 * 0.01 / 0.299792458);
}

TEST(Frames, ExposureIsAQuantileOfWhatIsLit) {
    HandMade made(10, 1, 10);
    for (int i = 0; i < 100; ++i) made.set(i / 10, i % 10, i < 50 ? 0 : float(i - 49));
    EXPECT_NEAR(luminance_quantile(made.get(), 1), 50, 1e-4);
    EXPECT_NEAR(luminance_quantile(made.get(), 0.5), 25, 1e-4);
    EXPECT_EQ(luminance_quantile(HandMade(2, 2, 3).get(), 0.99), 0);
}

// A single bright bin is no peak beside steady light; a dark pixel has none.
TEST(Frames, PeakIsWhereLightIsNotWhereAPathIs) {
    HandMade made(3, 1, 20);
    for (std::size_t bin = 10; bin < 15; ++bin) made.set(0, bin, 1), made.set(1, bin, 1);
    made.set(1, 3, 2).set(2, 5, 0.01f);
    const std::vector<float> times = peak_times(made.get());
    EXPECT_FLOAT_EQ(times[0], float(time_of(made.cube, 12)));
    EXPECT_FLOAT_EQ(times[1], float(time_of(made.cube, 12)));
    EXPECT_TRUE(std::isnan(times[2]));
}

TEST(Frames, StripSpansTheLight) {
    HandMade made(4, 4, 100);
    for (std::size_t pixel = 0; pixel < 16; ++pixel)
        for (std::size_t bin = 40; bin < 60; ++bin) made.set(pixel, bin, pixel == 3 ? 1000.0f : 1.0f);
    const std::vector<std::size_t> bins = strip_bins(made.get(), 6);
    ASSERT_EQ(bins.size(), 6u);
    EXPECT_EQ(bins.front(), 40u);
    EXPECT_NEAR(double(bins.back()), 57, 1);
    EXPECT_TRUE(std::is_sorted(bins.begin(), bins.end()));
    EXPECT_EQ(strip_bins(made.get(), 1).size(), 1u);
    EXPECT_LE(strip_bins(made.get(), 1000).size(), 100u);
    EXPECT_FALSE(strip_bins(HandMade(2, 2, 3).get(), 5).empty());
}

// Four standard errors apart, of the mean of nine pixels: sd 0.02 each.
TEST(Frames, BandsAreThoseOfTheMeanOfPixels) {
    HandMade made(3, 3, 2);
    for (std::size_t pixel = 0; pixel < 9; ++pixel) made.set(pixel, 1, float(pixel));
    const Plot plot = curves(made.get(), {4}, 1);
    double t, mean, low, high;
    int bin;
    const std::string data = plot.data.at("curves.tsv");
    ASSERT_EQ(std::sscanf(data.c_str() + data.rfind("\n1\t"), "%d %lf %lf %lf %lf", &bin, &t, &mean, &low, &high), 5)
        << data;
    EXPECT_DOUBLE_EQ(t, 2.75);
    EXPECT_NEAR(mean, 4, 1e-5);
    EXPECT_NEAR(high - low, 4 * 0.02 / 3, 1e-5);
    // At a corner fewer pixels are there.
    EXPECT_NE(curves(made.get(), {0}, 1).data.at("curves.tsv").find("\t2\t"), std::string::npos);
}

// Detected mutation: "a_b" of "a/b" taken twice.
TEST(Frames, FoldersOfDerivativesAreDistinctPlainNames) {
    const std::vector<std::string> names{
        "theta",    "shape:ball/pose",    "../x", "a/b", "a_b", "a_b-2", "a b", "'; touch PWNED\n", "",
        "\xc3\xa4", std::string(300, 'x')};
    const std::vector<std::string> folders = derivative_folders(names);
    ASSERT_EQ(folders.size(), names.size());
    EXPECT_EQ(folders[0], "derivative-theta");
    EXPECT_EQ(folders[1], "derivative-shape_ball_pose");
    EXPECT_EQ(folders[2], "derivative-.._x");
    for (std::size_t i = 0; i < folders.size(); ++i) {
        EXPECT_LT(folders[i].size(), 100u);
        EXPECT_EQ(folders[i].find_first_not_of("abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789-_."),
                  std::string::npos)
            << folders[i];
        for (std::size_t j = 0; j < i; ++j) EXPECT_NE(folders[i], folders[j]);
    }
}

TEST(Frames, LabelsAreOneLineOfValidText) {
    EXPECT_EQ(label_of("shape:ball/pose"), "shape:ball/pose");
    EXPECT_EQ(label_of("a\nb\tc\x7fx"), "a?b?c?x");
    EXPECT_EQ(label_of("ä€𝄞"), "ä€𝄞");
    EXPECT_EQ(label_of("\xff\xc3[\xed\xa0\x80\xc0\x80\xf5"), "??[??????");  // alone, cut short, surrogate, overlong
    EXPECT_EQ(label_of("\xc2\x85"), "?");                                   // a control character of two bytes
    EXPECT_EQ(label_of("abcdef", 3), "abc…");
    EXPECT_EQ(label_of("äöü", 3), "äöü");
    EXPECT_EQ(label_of("\xe2\x82"), "??");  // ends within a character
}

/// A cube with the derivatives by two parameters: `by`, and ten times that.
struct WithDerivatives : HandMade {
    std::vector<float> by;
    WithDerivatives(std::uint32_t width, std::uint32_t height, std::uint32_t bins)
        : HandMade(width, height, bins), by(radiance.size()) {}
    const TransientCube& get() {
        HandMade::get();
        cube.parameters.name = {"x", "y\nsystem 'touch PWNED'"};
        cube.parameters.unit = {"m", "1"};
        cube.parameters.temporal = {"none", "none"};
        cube.parameters.value = std::vector<double>{0, 0};
        std::vector<float> both = by;
        for (const float d : by) both.push_back(10 * d);
        cube.derivative.bins = both;
        cube.derivative.var_mean = std::vector<float>(both.size(), 0.0009f);
        cube.derivative.steady = std::vector<float>(2 * 3 * cube.n_pixels(), -1.0f);
        return cube;
    }
};

// Detected mutation: the variances of the value in place of those of the derivative.
TEST(Frames, DerivativesHaveSignedBandsBelowTheValue) {
    WithDerivatives made(3, 3, 2);
    for (std::size_t i = 3; i < made.by.size(); i += 6)  // bin 1
        for (std::size_t c = 0; c < 3; ++c) made.by[i + c] = -2;
    const DerivativeView derivative = derivative_view(made.get(), 1);
    const Plot plot = curves(made.cube, {4}, 1, &derivative);
    const std::string data = plot.data.at("curves.tsv");
    double t, value, value_low, value_high, mean, low, high;
    int bin;
    ASSERT_EQ(std::sscanf(data.c_str() + data.rfind("\n1\t"), "%d %lf %lf %lf %lf %lf %lf %lf", &bin, &t, &value,
                          &value_low, &value_high, &mean, &low, &high),
              8)
        << data;
    EXPECT_EQ(value, 0);
    EXPECT_NEAR(mean, -20, 1e-4);
    EXPECT_NEAR(low, -20 - 2 * 0.03 / 3, 1e-4);
    EXPECT_NEAR(high, -20 + 2 * 0.03 / 3, 1e-4);
    EXPECT_EQ(derivative.steady.size(), 27u);
}

TEST(Frames, ScaleOfADerivativeIsAQuantileOfItsSizes) {
    WithDerivatives made(10, 1, 10);
    for (std::size_t i = 0; i < 100; ++i)
        for (std::size_t c = 0; c < 3; ++c)
            made.by[3 * i + c] = i < 50 ? 0 : float(i - 49) * (i % 2 == 0 ? -1.0f : 1.0f);
    const TransientCube& cube = made.get();
    EXPECT_NEAR(derivative_quantile(cube, derivative_view(cube, 0), 1), 50, 1e-4);
    EXPECT_NEAR(derivative_quantile(cube, derivative_view(cube, 1), 0.5), 250, 1e-3);
    made.by.assign(made.by.size(), 0);
    const TransientCube& zero = made.get();
    EXPECT_EQ(derivative_quantile(zero, derivative_view(zero, 0), 0.99), 0);
}

// A name from a file is text in the commands of gnuplot. Caught: a newline that ends the text.
TEST(Frames, NamesOfParametersAreNoCommands) {
    WithDerivatives made(4, 4, 8);
    const DerivativeView derivative = derivative_view(made.get(), 1);
    for (const Plot& plot : {curves(made.cube, {4}, 1, &derivative), derivative_streaks(made.cube, derivative, 1, 2),
                             derivative_strip(made.cube, derivative, "strip.png", {1, 2}, 1)}) {
        EXPECT_NE(plot.commands.find("y?system ''touch PWNED''"), std::string::npos) << plot.commands;
        EXPECT_EQ(plot.commands.find("\nsystem"), std::string::npos);
    }
    EXPECT_EQ(parameter_of(made.cube, "x", "c.h5"), 0u);
    EXPECT_THROW(parameter_of(made.cube, "z", "c.h5"), InputError);
    HandMade without(1, 1, 1);
    EXPECT_THROW(require_derivatives(without.get(), "c.h5"), InputError);
}

}  // namespace
}  // namespace loom::frames
