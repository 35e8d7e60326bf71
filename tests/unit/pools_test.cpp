// Pooled tests of transient cubes: that noise passes, and what does not.

#include "stages/compare/pools.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>
#include <vector>

namespace loom::compare {
namespace {

/// A cube whose bins are means of n samples that hit with a small probability, as paths do.
struct NoisyCube {
    std::size_t width = 16, height = 12, n_bins = 40;
    std::vector<float> mean, var_mean;
    double samples;

    NoisyCube(double n, unsigned seed, double bias = 1, int late = 0)
        : mean(3 * width * height * n_bins), var_mean(mean.size()), samples(n) {
        std::mt19937 random(seed);
        std::exponential_distribution<double> value(1);
        for (std::size_t pixel = 0; pixel < width * height; ++pixel) {
            for (std::size_t bin = 0; bin < n_bins; ++bin) {
                const int t = int(bin) - late - int(pixel % width) / 4;
                const double share = t < 2 ? 0 : 0.2 * std::exp(-0.2 * t);
                std::poisson_distribution<int> hits(share * n + 1e-300);
                const int k = share > 0 ? hits(random) : 0;
                double sum[3]{}, squares[3]{};
                for (int hit = 0; hit < k; ++hit) {
                    const double x = bias * value(random);
                    for (int c = 0; c < 3; ++c) sum[c] += x * (c + 1), squares[c] += x * x * (c + 1) * (c + 1);
                }
                for (std::size_t c = 0; c < 3; ++c) {
                    const std::size_t i = (pixel * n_bins + bin) * 3 + c;
                    mean[i] = float(sum[c] / n);
                    var_mean[i] = float(std::max(squares[c] / n - mean[i] * mean[i], 0.0) / (n - 1));
                }
            }
        }
    }
    SampledCube view() const { return {mean, var_mean, samples}; }
};

PoolTests test(const NoisyCube& x, const NoisyCube& r, Pooling pooling, double relative_error = 0.05) {
    return test_pools(x.view(), r.view(), x.width, x.height, x.n_bins, pooling, relative_error);
}

TEST(Pools, NoisePasses) {
    for (const Pooling pooling : {Pooling::pixels, Pooling::image}) {
        for (unsigned seed = 1; seed <= 4; ++seed) {
            const NoisyCube few(200, seed), many(5000, seed + 10), as_few(200, seed + 20);
            for (const NoisyCube* reference : {&many, &as_few}) {
                const PoolTests tests = test(few, *reference, pooling);
                EXPECT_GT(tests.n, 30u);
                // Channels go together: a third of the tests are of their own.
                const double spread = 1 / std::sqrt(double(tests.n) / 3);
                EXPECT_NEAR(tests.mean_z, 0, 4 * spread) << seed;
                EXPECT_NEAR(tests.rms_z, 1, 4 * spread * std::sqrt(0.5) + 0.04) << seed;
                EXPECT_GT(tests.p, 1e-4) << seed;
            }
        }
    }
}

// 3 % too bright, or one bin late.
TEST(Pools, BiasFails) {
    const NoisyCube reference(5000, 1);
    EXPECT_LT(test(NoisyCube(5000, 2, 1.03), reference, Pooling::image).p, 1e-6);
    EXPECT_GT(test(NoisyCube(5000, 2, 1.03), reference, Pooling::pixels).mean_z, 0.4);
    EXPECT_LT(test(NoisyCube(5000, 2, 1, 1), reference, Pooling::pixels).p, 1e-10);
    EXPECT_LT(test(NoisyCube(5000, 2, 1, 1), reference, Pooling::image).p, 1e-10);
}

// A loose bound leaves every pixel alone; a tight one puts all into one pool per channel.
TEST(Pools, BoundSaysHowManyBinsArePooled) {
    const NoisyCube x(2000, 1), r(2000, 2);
    const std::size_t loose = test(x, r, Pooling::pixels, 10).n, middle = test(x, r, Pooling::pixels, 0.05).n;
    EXPECT_GT(loose, 3 * middle);
    EXPECT_GT(loose, 3 * 16 * 12 * 20u);
    EXPECT_EQ(test(x, r, Pooling::pixels, 1e-5).n, 3u);
}

TEST(Pools, SumsOfPixels) {
    const std::size_t n = 3 * 50;
    std::mt19937 random(3);
    std::normal_distribution<float> normal;
    std::vector<std::vector<float>> sums(5, std::vector<float>(n));
    std::vector<float> reference(n), var(n, 1.0f), var_reference(n, 0.01f);
    for (std::size_t i = 0; i < n; ++i) {
        reference[i] = 5 + 0.1f * normal(random);
        for (auto& replicate : sums) replicate[i] = 5 + normal(random);
    }
    EXPECT_GT(test_pixels(sums, {}, 10, reference, var_reference, 1000), 1e-3);
    EXPECT_GT(test_pixels({sums.data(), 1}, var, 10, reference, var_reference, 1000), 1e-3);
    for (auto& replicate : sums) replicate[70] += 6;
    EXPECT_LT(test_pixels({sums.data(), 1}, var, 10, reference, var_reference, 1000), 1e-3);
    for (auto& replicate : sums) replicate[70] += 20;
    EXPECT_LT(test_pixels(sums, {}, 10, reference, var_reference, 1000), 1e-2);
    // A sample without any hit has variance 0; the variance of the reference's samples corrects that.
    std::vector<float> dark(n), sure(n);
    const double p = test_pixels(std::vector<std::vector<float>>{dark}, sure, 1, std::vector<float>(n, 0.5f),
                                 std::vector<float>(n, 0.001f), 1000);
    EXPECT_GT(p, 0.5);
}

}  // namespace
}  // namespace loom::compare
