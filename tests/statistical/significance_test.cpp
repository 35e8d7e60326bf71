// The tests of loom-compare: as many false alarms as they promise, and the power stated here.
//
// Caught: a standard error of the pixels where that of the mean belongs, variances of the reference left out,
// Welch's own degrees of freedom (two replicates: false alarms in 14 % of the images, 74 % of the tile maps).

#include "stages/compare/significance.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>
#include <vector>

namespace loom::compare {
namespace {

constexpr std::size_t width = 32, height = 24;
constexpr int n_trials = 2000;

struct Alarms {
    double image = 0, tiles = 0;  // share of the trials with p < 0.05
};

/// Images of mean 1 + bias and standard deviation 0.5 against a noisy reference with deviation 0.25. tile_bias: added
/// in one of the 64 tiles only.
Alarms alarms(std::size_t replicates, bool with_variance, double bias, double tile_bias, unsigned seed) {
    std::mt19937 random(seed);
    std::normal_distribution<float> normal;
    const std::size_t n = 3 * width * height;
    const std::vector<float> var_x(n, 0.25f), var_r(n, 0.0625f);
    std::vector<std::vector<float>> x(replicates, std::vector<float>(n));
    std::vector<float> r(n);
    Alarms alarms;
    for (int trial = 0; trial < n_trials; ++trial) {
        for (float& v : r) v = 1 + 0.25f * normal(random);
        for (auto& picture : x) {
            for (std::size_t i = 0; i < n; ++i) {
                const bool in_tile = tile_of(i / 3 % width, i / 3 / width, width, height) == 27;
                picture[i] = 1 + float(bias + (in_tile ? tile_bias : 0)) + 0.5f * normal(random);
            }
        }
        const std::span<const float> known = with_variance ? std::span<const float>(var_x) : std::span<const float>{};
        const Significance s = test_means({x, known}, r, var_r, width, height);
        alarms.image += s.p_image < 0.05;
        alarms.tiles += s.p_tiles < 0.05;
    }
    alarms.image /= n_trials;
    alarms.tiles /= n_trials;
    return alarms;
}

// 5 % of 2000, give or take four standard errors (0.5 % each).
constexpr double nominal = 0.05, tolerance = 0.02;

TEST(Significance, ZKeepsItsLevel) {
    const Alarms a = alarms(1, true, 0, 0, 1);
    EXPECT_NEAR(a.image, nominal, tolerance);
    EXPECT_NEAR(a.tiles, nominal, tolerance);
}

// Few degrees of freedom are on the safe side: where the reference is noisy too, there are fewer alarms.
TEST(Significance, WelchNeverExceedsItsLevel) {
    for (std::size_t replicates : {2u, 3u, 8u}) {
        const Alarms a = alarms(replicates, false, 0, 0, 2 + unsigned(replicates));
        EXPECT_LT(a.image, nominal + tolerance) << replicates;
        EXPECT_LT(a.tiles, nominal + tolerance) << replicates;
    }
    EXPECT_GT(alarms(8, false, 0, 0, 20).image, 0.01);
}

// The mean of the image has a standard error of 0.020 for Z, 0.011 for eight replicates with the reference's own 0.009:
// a bias of 0.08 is 4.0 and 7.2 of them.
TEST(Significance, SeesABiasOfTheImage) {
    EXPECT_GT(alarms(1, true, 0.08, 0, 3).image, 0.95);
    EXPECT_GT(alarms(8, false, 0.08, 0, 4).image, 0.99);
}

// A tile of 12 pixels: its mean has 0.161 for Z; a bias of 0.8 in one of 64 tiles is 5.0 of them per channel.
TEST(Significance, SeesABiasedTile) {
    EXPECT_GT(alarms(1, true, 0, 0.8, 5).tiles, 0.95);
    // In the mean of the image one tile of 64 is not significant.
    EXPECT_LT(alarms(1, true, 0, 0.8, 5).image, 0.3);
}

}  // namespace
}  // namespace loom::compare
