// The old image as control variate: moments of pairs, and weights from the surrounding pixels.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "stages/core/sampling/sampler.h"
#include "stages/residual/control/controlled.h"

namespace loom::residual {
namespace {

constexpr std::uint32_t width = 24, height = 16;
constexpr std::uint64_t n = 8;

Sensor sensor() {
    Sensor s;
    s.width = width, s.height = height;
    return s;
}
double uniform(std::size_t pixel, std::uint64_t sample, std::uint32_t pair) {
    return double(Sampler(SamplerKind::independent, 5, pixel, sample).pair(pair).x);
}
/// Pairs whose values before are uniform in [0, 1), and after(value before, another uniform number).
template <class After>
ControlSums sums_of(After&& after) {
    ControlSums sums(std::vector<Spectrum>(width * height, Spectrum(1)), true);
    for (std::size_t p = 0; p < width * height; ++p)
        for (std::uint64_t i = 0; i < n; ++i)
            for (std::size_t c = 0; c < 3; ++c) {
                const double before = uniform(p, i, std::uint32_t(2 * c));
                (*sums.pairs(p))[c].add(before, after(before, uniform(p, i, std::uint32_t(2 * c + 1))));
            }
    return sums;
}
double mean_weight(const ControlSums& sums) {
    double sum = 0;
    for (const Spectrum& a : sums.alpha) sum += double(a.r + a.g + a.b) / 3;
    return sum / double(sums.alpha.size());
}

TEST(PairMoments, AreThoseOfTwoPasses) {
    PairMoments pairs;
    double before[n], after[n], mean_before = 0, mean_after = 0;
    for (std::uint64_t i = 0; i < n; ++i) {
        before[i] = uniform(1, i, 0), after[i] = 3 * before[i] + uniform(1, i, 1);
        mean_before += before[i] / n, mean_after += after[i] / n;
        pairs.add(before[i], after[i]);
    }
    for (const double alpha : {0.0, 1.0, 2.5}) {
        double sum = 0;
        for (std::uint64_t i = 0; i < n; ++i)
            sum += std::pow(after[i] - alpha * before[i] - (mean_after - alpha * mean_before), 2);
        EXPECT_NEAR(pairs.mean(alpha), mean_after - alpha * mean_before, 1e-12);
        EXPECT_NEAR(pairs.var_mean(alpha), sum / (n * (n - 1)), 1e-12);
    }
    PairMoments equal;
    for (std::uint64_t i = 0; i < n; ++i) equal.add(before[i], before[i]);
    EXPECT_EQ(equal.mean(1), 0);
    EXPECT_EQ(equal.var_mean(1), 0);
}

// A factor is found exactly, but for the image's own variance; where nothing is in common the image has no weight; and what
// 50 pixels cannot tell from 1 stays near 1.
TEST(ControlSums, WeightsAreThoseOfLeastVariance) {
    for (const double factor : {0.1, 1.0, 3.0}) {
        ControlSums dimmed = sums_of([&](double before, double) { return factor * before; });
        dimmed.fit(sensor(), 8 * n);
        for (const Spectrum& a : dimmed.alpha)
            for (int c = 0; c < 3; ++c) EXPECT_NEAR(a[c], factor / (1 + 1.0 / 8), 1e-6);
    }
    ControlSums other = sums_of([](double, double u) { return u; });
    other.fit(sensor(), 1'000'000);
    EXPECT_NEAR(mean_weight(other), 0, 0.06);
    ControlSums equal = sums_of([](double before, double) { return before; });
    equal.fit(sensor(), 1'000'000'000);
    EXPECT_NEAR(mean_weight(equal), 1, 1e-6);
    // Slope 1 and much noise, whose slope in 50 pixels varies by .2.
    ControlSums noisy = sums_of([](double before, double u) { return before + 4 * u; });
    noisy.fit(sensor(), 1'000'000);
    double off = 0;
    for (const Spectrum& a : noisy.alpha) off += std::abs(double(a.r) - 1) / double(noisy.alpha.size());
    EXPECT_LT(off, 0.1);
}

TEST(ControlSums, WeightsByCoverageStayFactors) {
    ControlSums sums = sums_of([](double before, double) { return 0.5 * before; });
    sums.alpha[width + 3] = Spectrum(0), sums.alpha[width + 9] = Spectrum(0.25f);
    sums.fit(sensor(), 1'000'000'000);
    EXPECT_EQ(sums.alpha[width + 3], Spectrum(0));
    EXPECT_NEAR(sums.alpha[width + 9].r, 0.125, 0.01);
}

// Detected mutation: the pixel itself is a part of its surroundings.
TEST(ControlSums, NoPixelDeterminesItsOwnWeight) {
    const auto half = [](double before, double u) { return 0.5 * before + u; };
    ControlSums one = sums_of(half), other = sums_of(half);
    const std::size_t pixel = 7 * width + 11;
    for (std::size_t c = 0; c < 3; ++c)
        for (int i = 0; i < 8; ++i) (*other.pairs(pixel))[c].add(100 * i, 70 * (i % 3));
    one.fit(sensor(), 64), other.fit(sensor(), 64);
    for (int c = 0; c < 3; ++c) EXPECT_NEAR(one.alpha[pixel][c], other.alpha[pixel][c], 1e-4);
    EXPECT_GT(std::abs(one.alpha[pixel + 1].r - other.alpha[pixel + 1].r), 0.05f);
}

// One sample has no variance, and NaN says nothing.
TEST(ControlSums, WithoutMomentsWeightsStay) {
    ControlSums sums(std::vector<Spectrum>(width * height, Spectrum(0.75f)), true);
    for (std::size_t p = 0; p < width * height; ++p)
        for (PairMoments& pair : *sums.pairs(p)) pair.add(1, 2);
    sums.fit(sensor(), 64);
    for (const Spectrum& a : sums.alpha) EXPECT_EQ(a, Spectrum(0.75f));
    ControlSums broken = sums_of([](double before, double) { return 0.5 * before; });
    (*broken.pairs(40))[1].add(NAN, 1);
    broken.fit(sensor(), 1'000'000'000);
    for (const Spectrum& a : broken.alpha) EXPECT_NEAR(a.g, 0.5, 1e-6);
}

}  // namespace
}  // namespace loom::residual
