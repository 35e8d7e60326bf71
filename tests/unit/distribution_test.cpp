// Sampling by inversion against the probabilities it claims and against a search without the guide table. Detected
// mutations: no step back from a guide that is one cell too high, `<` for `<=` (cells of no weight are chosen at their
// border), rows and columns swapped.

#include "stages/core/sampling/distribution.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <stdexcept>
#include <vector>

#include "stages/core/sampling/sampler.h"
#include "stages/core/stats/chi_square.h"
#include "tests/unit/bsdf_cases.h"

namespace loom::test {
namespace {

constexpr float almost_one = 0x1.fffffep-1f;

/// Weights over five decades, a third of them zero, the first and the last among these.
std::vector<double> uneven_weights(std::size_t n, std::uint64_t seed) {
    std::vector<double> weights(n);
    for (std::size_t i = 1; i + 1 < n; ++i) {
        const Point2f u = Sampler(SamplerKind::independent, seed, i, 0).pair(0);
        weights[i] = u.x < 1.0f / 3 ? 0 : std::pow(10.0, 5 * u.y);
    }
    if (n > 2) weights[n / 2] = 1;
    return weights;
}

/// The cell of u, by a walk along the cumulative sums.
std::size_t slow_cell(const std::vector<double>& weights, float u) {
    double sum = 0, running = 0;
    for (const double w : weights) sum += w;
    std::size_t cell = 0;
    for (std::size_t i = 0; i < weights.size(); ++i) {
        if (float(running / sum) <= u && weights[i] > 0) cell = i;
        running += weights[i];
    }
    return cell;
}

TEST(Distribution1, SamplesFollowThePmf) {
    for (const std::size_t n : {2u, 17u, 1000u}) {
        std::vector<double> weights = uneven_weights(n, 5);
        if (n == 2) weights = {1, 3};
        const Distribution1 distribution(weights);
        constexpr int samples = 1 << 19;
        std::vector<double> expected(n), observed(n), inside(20), inside_expected(20, samples / 20.0);
        double sum = 0;
        for (const double w : weights) sum += w;
        EXPECT_DOUBLE_EQ(distribution.sum(), sum);
        for (std::size_t i = 0; i < n; ++i) {
            EXPECT_NEAR(distribution.pmf(i), weights[i] / sum, 1e-7);
            expected[i] = samples * weights[i] / sum;
        }
        for (int i = 0; i < samples; ++i) {
            float u = Sampler(SamplerKind::independent, 6, i, 0).pair(0).x;
            ++observed[distribution.sample(u)];
            ASSERT_TRUE(u >= 0 && u < 1) << u;
            ++inside[int(u * 20)];
        }
        const ChiSquareResult cells = chi_square_test(observed, expected);
        EXPECT_GE(cells.p_value, sidak_alpha(n_comparisons)) << n;
        EXPECT_EQ(cells.stray, 0) << n;
        EXPECT_GE(chi_square_test(inside, inside_expected).p_value, sidak_alpha(n_comparisons)) << n;
    }
}

TEST(Distribution1, GuideTableAgreesWithAWalk) {
    for (const std::size_t n : {1u, 2u, 3u, 64u, 777u}) {
        std::vector<double> weights = uneven_weights(n, 7);
        if (n <= 2) weights.assign(n, 1);
        const Distribution1 distribution(weights);
        std::vector<float> us{0, almost_one};
        double sum = 0, running = 0;
        for (const double w : weights) sum += w;
        for (std::size_t i = 0; i < n; ++i) {
            // At, just below and just above the borders of the cells and of the guide's steps.
            for (const float border : {float(running / sum), float(i) / float(n)})
                us.insert(us.end(), {border, std::nextafter(border, 0.0f), std::nextafter(border, 1.0f)});
            running += weights[i];
        }
        for (int i = 0; i < 2000; ++i) us.push_back(Sampler(SamplerKind::independent, 8, i, 0).pair(0).x);
        for (const float u : us) {
            if (u >= 1) continue;
            float rest = u;
            const std::size_t cell = distribution.sample(rest);
            EXPECT_EQ(cell, slow_cell(weights, u)) << n << " cells, u " << u;
            EXPECT_GT(weights[cell], 0);
            EXPECT_TRUE(rest >= 0 && rest < 1);
        }
    }
}

TEST(Distribution1, IsMonotone) {
    const Distribution1 distribution(uneven_weights(100, 9));
    double last = -1;
    for (int i = 0; i < 1 << 16; ++i) {
        float u = float(i) * 0x1p-16f;
        const std::size_t cell = distribution.sample(u);
        EXPECT_GE(double(cell) + u, last);
        last = double(cell) + u;
    }
}

TEST(Distribution2, SamplesFollowTheDensity) {
    constexpr std::size_t width = 24, height = 10;
    std::vector<double> weights = uneven_weights(width * height, 10);
    for (std::size_t x = 0; x < width; ++x) weights[3 * width + x] = 0;  // a row of no weight
    double sum = 0, filled = 0;
    for (const double w : weights) {
        sum += w;
        filled += w > 0;
    }
    const Distribution2 distribution(weights, width, height);
    constexpr int samples = 1 << 19;
    std::vector<double> expected, observed(weights.size());
    for (const double w : weights) expected.push_back(samples * w / sum);
    double area = 0;
    int across = 0;
    for (int i = 0; i < samples; ++i) {
        float pdf = 0;
        const Point2f p = distribution.sample(Sampler(SamplerKind::sobol, 11, 0, i).pair(0), pdf);
        ASSERT_TRUE(p.x >= 0 && p.x <= 1 && p.y >= 0 && p.y <= 1);
        area += 1 / double(pdf);
        // Next to the border of two cells a point may be rounded into the other one.
        if (distribution.pdf(p) != pdf) {
            ++across;
            continue;
        }
        const std::size_t x = std::min(std::size_t(p.x * width), width - 1),
                          y = std::min(std::size_t(p.y * height), height - 1);
        // The cumulative sums are floats, off by 1e-7 of the whole, which is 240 cells.
        EXPECT_NEAR(pdf, weights[y * width + x] / sum * width * height, 3e-5 + 1e-4 * pdf);
        ++observed[y * width + x];
    }
    EXPECT_LT(across, 10);
    const ChiSquareResult cells = chi_square_test(observed, expected);
    EXPECT_GE(cells.p_value, sidak_alpha(n_comparisons));
    EXPECT_EQ(cells.stray, 0);
    // E[1 / pdf] is the area of the cells that have weight.
    EXPECT_NEAR(area / samples, filled / (width * height), 0.01);
    EXPECT_DOUBLE_EQ(distribution.sum(), sum);
}

TEST(Distribution1, RefusesWeightsThatCannotBeNormalised) {
    const double inf = std::numeric_limits<double>::infinity();
    for (const std::vector<double>& weights : {std::vector<double>{0, 0}, {1, -1, 3}, {1, inf}, {1, std::nan("")}})
        EXPECT_THROW((void)Distribution1(weights), std::logic_error);
    EXPECT_THROW(Distribution2(std::vector<double>(6), 3, 2), std::logic_error);
}

}  // namespace
}  // namespace loom::test
