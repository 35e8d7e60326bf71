// Adaptive pairs of paths: their numbers by pixel, and that their estimates are right although these follow the samples of
// other pixels. On made-up pairs, whose means are known.

#include "stages/residual/effort/extra_pairs.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numeric>

#include "stages/core/stats/moments.h"

namespace loom::residual {
namespace {

Sensor film(std::uint32_t width, std::uint32_t height) {
    Sensor sensor;
    sensor.width = width;
    sensor.height = height;
    return sensor;
}

app::Report& quiet() {
    static app::Report report;
    report.set_quiet(true);
    return report;
}

/// Pairs whose difference is value(id); the old path brings `before`.
template <class Value>
MakeTracer made_up(Value&& value, float before = 0) {
    class Tracer : public PairTracer {
      public:
        Tracer(Value value, float before) : value_(value), before_(before) {}
        void trace(std::span<const PathId> ids, std::span<PairValue> values) override {
            for (std::size_t k = 0; k < ids.size(); ++k)
                values[k] = {Spectrum(before_), Spectrum(before_ + value_(ids[k]))};
        }

      private:
        Value value_;
        float before_;
    };
    return [value, before] { return std::make_unique<Tracer>(value, before); };
}

TEST(PairCounts, AreRoundedWithTheRightMean) {
    const Sensor sensor = film(13, 9);
    std::vector<double> expected(sensor.n_pixels()), sums(sensor.n_pixels());
    for (std::size_t p = 0; p < expected.size(); ++p) expected[p] = p % 7 == 0 ? 0 : 0.03 * double(p);
    const double all = std::accumulate(expected.begin(), expected.end(), 0.0);
    constexpr int n = 4000;
    for (int seed = 0; seed < n; ++seed) {
        const auto pairs = dithered(sensor, expected, std::uint64_t(seed));
        double sum = 0;
        for (std::size_t p = 0; p < expected.size(); ++p) {
            sums[p] += pairs[p];
            sum += pairs[p];
            ASSERT_LE(std::abs(pairs[p] - expected[p]), 1);
        }
        ASSERT_LE(std::abs(sum - all), 1);
    }
    for (std::size_t p = 0; p < expected.size(); ++p) {
        const double f = expected[p] - std::floor(expected[p]);
        ASSERT_NEAR(sums[p] / n, expected[p], 4.5 * std::sqrt(f * (1 - f) / n) + 1e-9) << p;
    }
}

TEST(PairCounts, BelowOneAreSpreadOut) {
    const Sensor sensor = film(32, 32);
    const auto pairs = dithered(sensor, std::vector<double>(sensor.n_pixels(), 0.125), 5);
    for (std::uint32_t y = 0; y < 32; y += 4)
        for (std::uint32_t x = 0; x < 32; x += 4) {
            std::uint32_t sum = 0;
            for (std::uint32_t k = 0; k < 16; ++k) sum += pairs[(y + k / 4) * 32 + x + k % 4];
            EXPECT_EQ(sum, 2u);
        }
    std::vector<std::uint32_t> by_column(32);
    for (std::size_t p = 0; p < pairs.size(); ++p) by_column[p % 32] += pairs[p];
    EXPECT_LT(*std::max_element(by_column.begin(), by_column.end()), 16u);  // 4 in the mean, 32 in a pattern
}

TEST(PairCounts, OfAPixelDoNotFollowItself) {
    const Sensor sensor = film(16, 12);
    std::vector<double> variances(sensor.n_pixels(), 1.0);
    for (std::size_t p = 0; p < variances.size(); ++p) variances[p] = 1 + 0.1 * double(p % 5);
    const std::vector<std::uint32_t> ones(sensor.n_pixels(), 1);
    std::vector<std::uint8_t> takes(sensor.n_pixels(), 1);
    takes[3] = 0;
    const PairCounts before = pairs_by_deviation(sensor, variances, 2, 3),
                     sizes_before = pairs_by_size(sensor, variances, ones, takes, 0.5, 3);
    constexpr std::size_t own = 5 * 16 + 7;
    variances[own] = 1e6;
    const PairCounts after = pairs_by_deviation(sensor, variances, 2, 3),
                     sizes_after = pairs_by_size(sensor, variances, ones, takes, 0.5, 3);
    EXPECT_NEAR(after.expected[own], before.expected[own], 1e-9);
    EXPECT_NEAR(sizes_after.expected[own], sizes_before.expected[own], 1e-6);
    EXPECT_GT(after.expected[own + 1], 2 * before.expected[own + 1]);
    EXPECT_GT(sizes_after.expected[own + 16], 2 * sizes_before.expected[own + 16]);
}

TEST(PairCounts, HaveTheMeanThatIsAskedFor) {
    const Sensor sensor = film(32, 24);
    std::vector<double> variances(sensor.n_pixels());
    for (std::size_t p = 0; p < variances.size(); ++p) variances[p] = p % 32 < 8 ? 1 : 0.0001;
    const PairCounts counts = pairs_by_deviation(sensor, variances, 3, 1);
    EXPECT_NEAR(double(counts.all()) / double(sensor.n_pixels()), 3, 0.15);
    EXPECT_EQ(pairs_by_deviation(sensor, std::vector<double>(sensor.n_pixels()), 3, 1).all(), 0u);
}

TEST(ExtraPairs, PoolLikeOneSetOfPairs) {
    PairMoments a, b, all;
    for (int i = 0; i < 12; ++i) {
        const double before = std::sin(i), after = 2 + std::cos(3 * i);
        (i < 5 ? a : b).add(before, after);
        all.add(before, after);
    }
    const PairMoments both = pooled(a, b);
    EXPECT_EQ(both.n, all.n);
    for (const double alpha : {0.0, 0.7}) {
        EXPECT_NEAR(both.mean(alpha), all.mean(alpha), 1e-14);
        EXPECT_NEAR(both.var_mean(alpha), all.var_mean(alpha), 1e-14);
    }
    EXPECT_EQ(pooled({}, a).mean(1), a.mean(1));
    EXPECT_EQ(pooled(a, {}).var_mean(1), a.var_mean(1));
}

// Rare bright pairs: a pixel that has one looks noisy, and one that has none does not. Detected mutation: a map that has the
// pixel itself in it, by which the mean falls to 0.977.
TEST(ExtraPairs, OnTopOfOthersHaveTheRightMean) {
    const Sensor sensor = film(24, 16);
    constexpr std::uint64_t spp = 4;
    constexpr int n = 400;
    const auto value = [](std::uint64_t seed) {
        return [seed](PathId id) {
            return Sampler(SamplerKind::independent, seed, id.pixel, id.sample).pair(0).x < 0.1f ? 10.0f : 0.0f;
        };
    };
    tracing::Counts counts;
    Moments means, claimed;
    for (std::uint64_t seed = 0; seed < n; ++seed) {
        const PairSums own = trace_pairs(sensor, std::vector<std::uint32_t>(sensor.n_pixels(), spp), 0,
                                         made_up(value(2 * seed), 0.5f), 1, quiet(), counts);
        Image image;
        image.width = sensor.width;
        image.height = sensor.height;
        for (const char* name : {"R", "G", "B", "VarMean.R", "VarMean.G", "VarMean.B"}) image.add(name);
        std::vector<Spectrum> alpha(sensor.n_pixels(), Spectrum(1));
        for (std::size_t p = 0; p < alpha.size(); p += 2) alpha[p] = Spectrum(0.5f);
        ControlSums control(std::move(alpha));
        for (std::size_t c = 0; c < 3; ++c)
            for (std::size_t p = 0; p < sensor.n_pixels(); ++p) {
                image.channels[c].values[p] = float(own[p][c].mean(1));
                image.channels[3 + c].values[p] = float(own[p][c].var_mean(1));
                if (p % 2 == 0) (*control.pairs(p))[c] = own[p][c];
            }
        const PairCounts more = pairs_by_deviation(sensor, variances_of_pairs(image, spp, &control), 4, seed);
        add_pairs(trace_pairs(sensor, more.pairs, 0, made_up(value(2 * seed + 1), 0.5f), 1, quiet(), counts), spp,
                  image, &control);
        double mean = 0, var = 0;
        for (std::size_t p = 0; p < sensor.n_pixels(); ++p) {
            mean += double(image.find("G")[p]) / double(sensor.n_pixels());
            var += double(image.find("VarMean.G")[p]) / sqr(double(sensor.n_pixels()));
            if (p % 2 == 0) {
                ASSERT_NEAR((*control.pairs(p))[1].mean(0.5), double(image.find("G")[p]) + 0.25, 1e-5);
            } else {
                ASSERT_EQ(control.pairs(p), nullptr);
            }
        }
        means.add(mean);
        claimed.add(var);
    }
    const double se = std::sqrt(means.var_mean());
    EXPECT_NEAR(means.mean, 1, 3 * se);
    EXPECT_LT(se, 0.006);
    EXPECT_NEAR(claimed.mean / means.var_sample(), 1, 0.3);
}

// A glint of one pixel that moves by a pixel a frame, a quarter of a pair per pixel: the mean is right from the first frame on
// that it is somewhere else. Detected mutations: a map that has the pixel itself in it; the sum over the pairs divided by
// their number after rounding; without a division.
TEST(SparsePairs, FollowAMovingGlint) {
    const Sensor sensor = film(16, 12);
    constexpr int seeds = 256, frames = 280;
    constexpr float glint = 5;
    const std::vector<Spectrum> alpha(sensor.n_pixels(), Spectrum(1));
    tracing::Counts counts;
    Moments at_glint, first, elsewhere, pairs;
    for (std::uint64_t seed = 0; seed < seeds; ++seed)
        for (std::uint64_t frame = 0; frame < frames; ++frame) {
            const std::size_t place = (7 * seed + frame) % sensor.n_pixels();
            const std::uint64_t of_frame = streams::frame(seed, frame);
            const SparsePairs sparse = trace_sparse_pairs(
                sensor, alpha, {0.25, false, of_frame, 1}, made_up([place, of_frame](PathId id) {
                    const float u = Sampler(SamplerKind::independent, of_frame, id.pixel, id.sample).pair(0).x;
                    return id.pixel == place ? glint : 0.2f * (u - 0.5f);
                }),
                quiet(), counts);
            const double value = sparse.of(place, 1, 1).mean;
            at_glint.add(value);
            if (frame < 3) first.add(value);
            elsewhere.add(sparse.of((place + 90) % sensor.n_pixels(), 1, 1).mean);
            pairs.add(sparse.mean);
        }
    const double se = std::sqrt(at_glint.var_mean());
    EXPECT_LT(se, 0.0101 * glint);
    EXPECT_NEAR(at_glint.mean, glint, 3 * se);
    EXPECT_NEAR(first.mean, glint, 3 * std::sqrt(first.var_mean()));
    EXPECT_NEAR(elsewhere.mean, 0, 3 * std::sqrt(elsewhere.var_mean()));
    EXPECT_NEAR(pairs.mean, 0.25, 0.02);
    RecordProperty("se", std::to_string(se / glint));
}

// What is claimed of the variance is not less than it is, nor much more where pixels have pairs for certain.
TEST(SparsePairs, SayTheirVariance) {
    const Sensor sensor = film(16, 12);
    const std::vector<Spectrum> alpha(sensor.n_pixels(), Spectrum(0.5f));
    tracing::Counts counts;
    for (const double mean : {0.5, 4.0})
        for (const bool even : {false, true}) {
            std::vector<Moments> value(sensor.n_pixels());
            double claimed = 0, spread = 0;
            constexpr int n = 1000;
            for (std::uint64_t seed = 0; seed < n; ++seed) {
                const SparsePairs sparse = trace_sparse_pairs(
                    sensor, alpha, {mean, even, seed, 1}, made_up([seed](PathId id) {
                        return Sampler(SamplerKind::independent, seed + 1, id.pixel, id.sample).pair(0).x - 0.5f;
                    }),
                    quiet(), counts);
                for (std::size_t p = 0; p < value.size(); ++p) {
                    const Estimated e = sparse.of(p, 1, 1);
                    value[p].add(e.mean);
                    claimed += e.var_mean / n;
                }
            }
            for (const Moments& m : value) spread += m.var_sample();
            EXPECT_NEAR(claimed / spread, 1, 0.1) << mean << (even ? " evenly" : "");
        }
}

}  // namespace
}  // namespace loom::residual
