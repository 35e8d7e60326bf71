// Errors that can be worked out by hand; each catches another norm, floor, number of channels or direction.

#include "stages/compare/metrics.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>
#include <vector>

#include "formats/io/field_checker.h"
#include "stages/compare/compare.h"
#include "stages/compare/difference.h"
#include "stages/compare/significance.h"
#include "stages/core/plot/false_colours.h"

namespace loom::compare {
namespace {

using Values = std::vector<float>;

TEST(Metrics, PointwiseByHand) {
    const Values x{1, 2, 0, 3}, r{0, 2, 1, 1};
    EXPECT_DOUBLE_EQ(mean_squared(x, r), (1 + 0 + 1 + 4) / 4.0);
    EXPECT_DOUBLE_EQ(mean_squared_relative(x, r), (1 / 0.01 + 0 + 1 / 1.01 + 4 / 1.01) / 4);
    EXPECT_DOUBLE_EQ(mean_absolute_relative(x, r), (1 / 0.01 + 0 + 1 / 1.01 + 2 / 1.01) / 4);
    // A negative reference (a difference, a derivative) is as good as a positive one.
    EXPECT_DOUBLE_EQ(mean_absolute_relative(Values{-2}, Values{-1}), 1 / 1.01);
    EXPECT_EQ(count_nonfinite(Values{1, NAN, INFINITY, -INFINITY}), 3u);
    EXPECT_TRUE(std::isnan(mean_squared_relative(Values{NAN, 1}, Values{1, 1})));
}

// Of 2000 pixels the two with the largest sums over channels are removed; of 999 none.
TEST(Metrics, TrimmingDropsWholePixels) {
    Values x(6000), r(6000);
    for (std::size_t i = 0; i < x.size(); ++i) x[i] = 0.1f;
    x[0] = x[1] = x[2] = 5;  // (5, 5, 5): largest sum
    x[30] = 7;               // (7, 0.1, 0.1): next
    x[60] = 3, x[61] = 3;    // stays
    const double base = double(0.1f) * double(0.1f) / 0.01;
    EXPECT_NEAR(trimmed_mean_squared_relative(x, r, 3), (1997 * 3 * base + base + 2 * 900) / (1998 * 3), 1e-9);
    EXPECT_NEAR(trimmed_mean_squared_relative(std::span(x).first(999 * 3), std::span(r).first(999 * 3), 3),
                mean_squared_relative(std::span(x).first(999 * 3), std::span(r).first(999 * 3)), 1e-9);
    x[0] = NAN;
    EXPECT_TRUE(std::isnan(trimmed_mean_squared_relative(x, r, 3)));
}

TEST(Metrics, DisplayAndPsnr) {
    const Values shown = displayed(Values{-1, 0, 0.5f, 1, 9}, 1);
    EXPECT_EQ(shown, (Values{0, 0, 1, 1, 1}));
    EXPECT_NEAR(displayed(Values{0.18f}, 0)[0], 0.46136, 1e-5);  // middle grey of sRGB
    EXPECT_NEAR(psnr_db(Values{0.1f, 0.2f}, Values{0.2f, 0.2f}), -10 * std::log10(0.005), 1e-5);
    EXPECT_EQ(psnr_db(Values{1}, Values{1}), INFINITY);
}

TEST(Metrics, SsimOfConstantsIsTheLuminanceTerm) {
    const Values a(20 * 15, 0.2f), b(20 * 15, 0.6f);
    EXPECT_NEAR(ssim(a, b, 20, 15), (2 * 0.12 + 1e-4) / (0.04 + 0.36 + 1e-4), 1e-6);
    EXPECT_NEAR(ssim(a, a, 20, 15), 1, 1e-12);
}

// The two blurs of lines against the sum over the window, pixel by pixel.
TEST(Metrics, SsimEqualsItsPlainForm) {
    constexpr int w = 17, h = 9;
    std::mt19937 random(3);
    std::uniform_real_distribution<float> uniform;
    Values x(w * h), r(w * h);
    for (int i = 0; i < w * h; ++i) r[i] = uniform(random), x[i] = 0.7f * r[i] + 0.3f * uniform(random);
    double sum = 0;
    for (int y0 = 0; y0 < h; ++y0) {
        for (int x0 = 0; x0 < w; ++x0) {
            double n = 0, a = 0, b = 0, aa = 0, bb = 0, ab = 0;
            for (int y1 = std::max(0, y0 - 5); y1 <= std::min(h - 1, y0 + 5); ++y1) {
                for (int x1 = std::max(0, x0 - 5); x1 <= std::min(w - 1, x0 + 5); ++x1) {
                    const double g = std::exp(-((x1 - x0) * (x1 - x0) + (y1 - y0) * (y1 - y0)) / 4.5);
                    const double u = x[y1 * w + x1], v = r[y1 * w + x1];
                    n += g, a += g * u, b += g * v, aa += g * u * u, bb += g * v * v, ab += g * u * v;
                }
            }
            a /= n, b /= n, aa = aa / n - a * a, bb = bb / n - b * b, ab = ab / n - a * b;
            sum += (2 * a * b + 1e-4) * (2 * ab + 9e-4) / ((a * a + b * b + 1e-4) * (aa + bb + 9e-4));
        }
    }
    EXPECT_NEAR(ssim(x, r, w, h), sum / (w * h), 1e-9);
}

// Stripes of period 2 along x: neighbours to the right are opposite, those below equal; over 2 … 8 pixels
// the right ones alternate (four times +1, three times -1) and the lower ones are all 1.
TEST(Metrics, CorrelationOfStripes) {
    constexpr std::size_t w = 32, h = 16;
    Values x(w * h), r(w * h, 2);
    for (std::size_t i = 0; i < x.size(); ++i) x[i] = 2 + (i % 2 ? 0.5f : -0.5f);
    const Correlation c = error_correlation(x, r, w, h, 1);
    EXPECT_NEAR(c.right, -1, 1e-6);
    EXPECT_NEAR(c.down, 1, 1e-6);
    EXPECT_NEAR(c.near, (1.0 + 7.0) / 14, 1e-6);
    EXPECT_TRUE(std::isnan(error_correlation(r, r, w, h, 1).right));
    EXPECT_TRUE(std::isnan(error_correlation(Values{1, 2}, Values{0, 0}, 1, 2, 1).right));
}

// Noise blurred by (1, 2, 1)/4 along x has correlation 2/3 at one pixel, 1/6 at two, 0 beyond.
TEST(Metrics, CorrelationOfBlurredNoise) {
    constexpr std::size_t w = 512, h = 512;
    std::mt19937 random(5);
    std::normal_distribution<float> normal;
    Values noise(w * h * 3 + 6), x(w * h * 3), r(w * h * 3, 1);
    for (float& v : noise) v = normal(random);
    for (std::size_t i = 0; i < x.size(); ++i) x[i] = 1 + 0.25f * (noise[i] + 2 * noise[i + 3] + noise[i + 6]);
    const Correlation c = error_correlation(x, r, w, h, 3);
    const double tolerance = 4 / std::sqrt(3.0 * w * h);
    EXPECT_NEAR(c.right, 2.0 / 3, tolerance);
    EXPECT_NEAR(c.down, 0, 2 * tolerance);
    EXPECT_NEAR(c.near, 1.0 / 6 / 14, tolerance);
}

// Mean relMSE = bias2 + variance + reference, exactly, for one image and for replicates.
TEST(Metrics, DecompositionAddsUp) {
    const std::vector<Values> x{{1, 2}, {3, 2}, {2, 5}};
    const Values r{1, 2}, var_r{0.1f, 0.2f}, var_x{0.5f, 0.25f};
    const Decomposition all = decompose(x, {}, r, var_r);
    EXPECT_NEAR(all.variance, (1 / 1.01 + 3 / 4.01) / 2, 1e-12);
    EXPECT_NEAR(all.bias2, ((1 - 1 / 3.0 - double(0.1f)) / 1.01 + (1 - 1 - double(0.2f)) / 4.01) / 2, 1e-12);
    double relmse = 0;
    for (const Values& one : x) relmse += mean_squared_relative(one, r) / 3;
    EXPECT_NEAR(all.bias2 + all.variance + all.reference, relmse, 1e-12);

    const Decomposition one = decompose(std::span(x).last(1), var_x, r, var_r);
    EXPECT_NEAR(one.variance, (0.5 / 1.01 + 0.25 / 4.01) / 2, 1e-12);
    EXPECT_NEAR(one.bias2 + one.variance + one.reference, mean_squared_relative(x[2], r), 1e-12);
    EXPECT_TRUE(std::isnan(decompose(std::span(x).first(1), {}, r, {}).bias2));
}

// An image of 8 x 8 pixels has one tile per pixel. Green is 0.5 too bright; every pixel's mean has variance 4, the
// image's 4/64, so z = 0.5 / 0.25 = 2. Each tile: z = 0.25. Corrected for three channels, and for 192 tiles.
TEST(Metrics, ZTestByHand) {
    constexpr std::size_t n = 64;
    Values r(3 * n, 1), x = r;
    for (std::size_t i = 0; i < n; ++i) x[3 * i + 1] = 1.5f;
    const std::vector<Values> one{x};
    const Values variance(3 * n, 4);
    const Significance z = test_means({one, variance}, r, {}, 8, 8);
    EXPECT_STREQ(z.kind, "Z");
    EXPECT_NEAR(z.tests[1][0].difference, 0.5, 1e-12);
    EXPECT_NEAR(z.tests[1][0].se, 0.25, 1e-12);
    const double p = std::erfc(2 / std::sqrt(2.0)), p_tile = std::erfc(0.25 / std::sqrt(2.0));
    EXPECT_NEAR(z.p_image, 1 - std::pow(1 - p, 3), 1e-9);
    EXPECT_NEAR(z.p_tiles, 1 - std::pow(1 - p_tile, 192), 1e-9);
    EXPECT_EQ(z.tests[0][0].p_value, 1);
    // A reference that varies as much: se^2 doubles.
    EXPECT_NEAR(test_means({one, variance}, r, variance, 8, 8).tests[1][0].se, std::sqrt(2.0) / 4, 1e-12);
    EXPECT_STREQ(test_means({one, {}}, r, {}, 8, 8).kind, "none");
}

// Two replicates, 1 and 2 above a reference that is exact: mean 1.5, se 0.5, t = 3 with one degree of freedom, whose
// p-value is 1 - 2/pi atan(3). All channels and tiles alike; the first of equal ones is the worst.
TEST(Metrics, WelchTestByHand) {
    const Values r(3 * 64, 1);
    const std::vector<Values> two{Values(3 * 64, 2), Values(3 * 64, 3)};
    const Significance welch = test_means({two, {}}, r, {}, 8, 8);
    EXPECT_STREQ(welch.kind, "Welch");
    EXPECT_NEAR(welch.tests[2][17].difference, 1.5, 1e-12);
    EXPECT_NEAR(welch.tests[2][17].se, 0.5, 1e-12);
    const double p = 1 - 2 / M_PI * std::atan(3.0);
    EXPECT_NEAR(welch.tests[2][17].p_value, p, 1e-9);
    EXPECT_NEAR(welch.p_image, 1 - std::pow(1 - p, 3), 1e-9);
    EXPECT_NEAR(welch.p_tiles, 1 - std::pow(1 - p, 192), 1e-9);
}

// A quarter of the error at twice the time: four times better, twice at equal time.
TEST(Metrics, GainByHand) {
    const auto group = [](double relmse, double cpu_s) {
        Group g;
        for (double factor : {0.9, 1.1}) {
            Measured m{};
            m.relmse = factor * relmse;
            m.cpu_s = cpu_s;
            g.replicates.push_back(m);
        }
        return g;
    };
    const Gain gain = gain_of(group(0.4, 3), group(0.1, 6));
    EXPECT_NEAR(gain.error.value, 4, 1e-12);
    EXPECT_NEAR(gain.equal_cpu, 2, 1e-12);
}

TEST(Metrics, TilesCoverThePicture) {
    constexpr std::size_t w = 20, h = 11;
    Values rgb(3 * w * h);
    for (std::size_t i = 0; i < rgb.size(); ++i) rgb[i] = float(i % 3);
    const Regions regions = regions_of(rgb, w, h);
    double n = 0;
    for (std::size_t t = 1; t < regions.n.size(); ++t) {
        n += regions.n[t];
        EXPECT_GT(regions.n[t], 0);
        for (std::size_t c = 0; c < 3; ++c) EXPECT_EQ(regions.mean(c, t), double(c));
    }
    EXPECT_EQ(n, regions.n[0]);
    EXPECT_EQ(tile_of(0, 0, w, h), 0u);
    EXPECT_EQ(tile_of(w - 1, 0, w, h), 7u);
    EXPECT_EQ(tile_of(0, h - 1, w, h), 56u);
}

TEST(Metrics, RatiosAndTheirIntervals) {
    const std::vector<double> a{2.0, 2.2, 1.8}, b{1.0, 1.0, 1.0};
    const Ratio ratio = ratio_of(a, b);
    // b is exact: log(2) +- t(2 dof) 0.2 / sqrt(3) / 2.
    const double reach = 4.302653 * 0.2 / std::sqrt(3.0) / 2;
    EXPECT_NEAR(ratio.value, 2, 1e-12);
    EXPECT_NEAR(ratio.low, 2 * std::exp(-reach), 1e-6);
    EXPECT_NEAR(ratio.high, 2 * std::exp(reach), 1e-6);
    EXPECT_TRUE(std::isnan(ratio_of(a, std::vector{1.0}).low));
    // Tiles of the same ratio leave no doubt, however unlike they are.
    const Ratio tiles = ratio_of_tiles(std::vector{2.0, 20.0, 0.2}, std::vector{1.0, 10.0, 0.1});
    EXPECT_NEAR(tiles.low, 2, 1e-9);
    EXPECT_NEAR(tiles.high, 2, 1e-9);
}

TEST(Metrics, FalseColoursAreSignedAndHaveALegend) {
    const Values x{2, 2, 2, 0, 0, 0, 1, 1, 1, NAN, NAN, NAN}, r{1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1, 1};
    const Image difference = difference_image(x, r, 4, 1, {});
    EXPECT_EQ(difference.find("R")[0], 1);
    EXPECT_EQ(difference.find("R")[1], -1);
    EXPECT_NEAR(difference.find("Relative.G")[0], 1 / std::sqrt(1.01), 1e-6);
    EXPECT_TRUE(difference.find("TileZ.R").empty());
    const Image colours = false_colours(difference, "", 1);
    EXPECT_EQ(colours.width, 240u);
    EXPECT_GT(colours.height, 60u + 20u);
    const auto red = colours.find("R"), blue = colours.find("B");
    EXPECT_GT(red[0], blue[0]);
    EXPECT_LT(red[60], blue[60]);
    EXPECT_EQ(red[120], 1);
    EXPECT_EQ(blue[120], 1);
    EXPECT_EQ(red[180], 0);
    EXPECT_EQ(signed_colour(0), (std::array<float, 3>{1, 1, 1}));
    EXPECT_EQ(signed_colour(2), signed_colour(1));
    for (const double t : {0.05, 0.5, 1.0}) {
        EXPECT_GT(signed_colour(t)[0], signed_colour(t)[2]) << t;
        EXPECT_LT(signed_colour(-t)[0], signed_colour(-t)[2]) << t;
    }
}

}  // namespace
}  // namespace loom::compare
