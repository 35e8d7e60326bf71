// Random streams: uniform, stratified as specified, and independent of each other. Detected mutations: no index shuffle
// (pairs correlate), pascal() without its first step (the net), the seed left out of the key (seeds correlate), two
// dimensions with one key.

#include "stages/core/sampling/sampler.h"

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <functional>
#include <set>
#include <vector>

#include "stages/core/sampling/sampler_levels.h"
#include "stages/core/sampling/streams.h"
#include "stages/core/stats/chi_square.h"
#include "tests/unit/bsdf_cases.h"

namespace loom::test {
namespace {

constexpr std::array kinds{SamplerKind::sobol, SamplerKind::independent};

/// p-value of the hypothesis that points over the unit square are uniform; cells x cells cells.
double uniform_p_value(int n, int cells, const std::function<Point2f(int)>& point) {
    std::vector<double> observed(cells * cells), expected(cells * cells, double(n) / (cells * cells));
    for (int i = 0; i < n; ++i) {
        const Point2f u = point(i);
        EXPECT_TRUE(u.x >= 0 && u.x < 1 && u.y >= 0 && u.y < 1);
        ++observed[int(u.y * float(cells)) * cells + int(u.x * float(cells))];
    }
    return chi_square_test(observed, expected).p_value;
}

TEST(Sampler, PairsAreUniformOverThePixels) {
    for (const SamplerKind kind : kinds)
        for (const std::uint32_t dimension : {0u, 1u, 6u, 40u})
            for (const std::uint64_t sample : {0ull, 5ull}) {
                const auto point = [&](int i) { return Sampler(kind, 1, i, sample).pair(dimension); };
                EXPECT_GE(uniform_p_value(1 << 18, 32, point), sidak_alpha(n_comparisons))
                    << "kind " << int(kind) << " dimension " << dimension << " sample " << sample;
            }
}

TEST(Sampler, PairsAreUniformOverTheSamplesOfAPixel) {
    for (const SamplerKind kind : kinds) {
        const auto point = [&](int i) { return Sampler(kind, 1, 77, i).pair(3); };
        EXPECT_GE(uniform_p_value(1 << 18, 32, point), sidak_alpha(n_comparisons));
    }
}

/// Whether 2^k points have one in each elementary interval of every shape 2^-a x 2^-(k - a).
bool is_net(const std::vector<Point2f>& points, int k) {
    for (int a = 0; a <= k; ++a) {
        std::set<std::pair<int, int>> taken;
        for (const Point2f& p : points) taken.emplace(int(std::ldexp(p.x, a)), int(std::ldexp(p.y, k - a)));
        if (taken.size() != points.size()) return false;
    }
    return true;
}

// Every aligned run of 2^k samples is a net, so that a pass that adds samples keeps what the first had.
TEST(Sampler, SobolPairsAreNetsInBaseTwo) {
    for (int k = 0; k <= 10; ++k)
        for (const std::uint64_t start : {0ull, 1ull, 5ull})
            for (const std::uint32_t dimension : {0u, 1u, 2u, 9u}) {
                std::vector<Point2f> points;
                for (std::uint64_t i = 0; i < (1ull << k); ++i)
                    points.push_back(Sampler(SamplerKind::sobol, 4, 123, (start << k) + i).pair(dimension));
                EXPECT_TRUE(is_net(points, k))
                    << "2^" << k << " samples from " << (start << k) << ", dimension " << dimension;
            }
}

TEST(Sampler, IndependentPairsAreNoNet) {
    std::vector<Point2f> points;
    for (std::uint64_t i = 0; i < 256; ++i) points.push_back(Sampler(SamplerKind::independent, 4, 123, i).pair(0));
    EXPECT_FALSE(is_net(points, 8));
}

/// One coordinate here against one there, over 64 samples of many pixels: uniform on the square when independent.
double joint_p_value(SamplerKind kind, const std::function<Point2f(const Sampler&, const Sampler&)>& joint,
                     std::uint64_t seed_step, std::uint64_t pixel_step, std::uint64_t sample_step) {
    constexpr int samples = 64;
    return uniform_p_value(1 << 17, 16, [&](int i) {
        const std::uint64_t seed = 3, pixel = i / samples, sample = i % samples;
        return joint(Sampler(kind, seed, pixel, sample),
                     Sampler(kind, seed + seed_step, pixel + pixel_step, sample + sample_step));
    });
}

TEST(Sampler, DimensionsPixelsAndSeedsAreIndependent) {
    const double alpha = sidak_alpha(n_comparisons);
    const auto x_x = [](const Sampler& a, const Sampler& b) { return Point2f{a.pair(2).x, b.pair(2).x}; };
    const auto y_x = [](const Sampler& a, const Sampler& b) { return Point2f{a.pair(2).y, b.pair(2).x}; };
    for (const SamplerKind kind : kinds) {
        for (const std::uint32_t other : {0u, 1u, 3u, 4u, 6u, 66u})
            EXPECT_GE(joint_p_value(
                          kind,
                          [=](const Sampler& a, const Sampler&) {
                              return Point2f{a.pair(2).x, a.pair(other).x};
                          },
                          0, 0, 0),
                      alpha)
                << "dimensions 2 and " << other;
        for (const std::uint64_t step : {1ull, 2ull, 256ull, 1280ull}) {
            EXPECT_GE(joint_p_value(kind, x_x, 0, step, 0), alpha) << "pixels " << step << " apart";
            EXPECT_GE(joint_p_value(kind, y_x, 0, step, 0), alpha) << "pixels " << step << " apart";
            EXPECT_GE(joint_p_value(kind, x_x, step, 0, 0), alpha) << "seeds " << step << " apart";
        }
        // A sobol sequence of 2^32 points is over: what follows has a scramble of its own.
        EXPECT_GE(joint_p_value(kind, x_x, 0, 0, 1ull << 32), alpha);
    }
    EXPECT_GE(joint_p_value(SamplerKind::independent, x_x, 0, 0, 1), alpha) << "samples in a row";
    // Samples in a row of a net avoid one another: the same test must see that.
    EXPECT_LT(joint_p_value(SamplerKind::sobol, x_x, 0, 0, 1), alpha);
}

TEST(Sampler, APairDoesNotDependOnWhatWasAskedBefore) {
    for (const SamplerKind kind : kinds) {
        const Sampler asked(kind, 9, 1000, 17), fresh(kind, 9, 1000, 17);
        std::vector<Point2f> down;
        for (int d = 40; d >= 0; --d) down.push_back(asked.pair(d));
        for (int d = 0; d <= 40; d += 3) {
            const Point2f u = fresh.pair(d);
            EXPECT_EQ(u.x, down[40 - d].x);
            EXPECT_EQ(u.y, down[40 - d].y);
        }
    }
}

TEST(Sampler, ColumnsHoldThePairsOnEveryLevel) {
    constexpr std::size_t n = 77;  // no multiple of any vector's width
    for (const SamplerKind kind : kinds) {
        std::vector<std::uint32_t> key_lo, key_hi, index;
        for (std::size_t i = 0; i < n; ++i) {
            const Sampler s(kind, 5, 3 * i, i % 11);
            key_lo.push_back(s.key_lo()), key_hi.push_back(s.key_hi()), index.push_back(s.index());
        }
        const auto expect_pairs = [&](auto columns, const char* level) {
            std::vector<float> x(n), y(n);
            columns(kind, key_lo.data(), key_hi.data(), index.data(), 6, n, x.data(), y.data());
            for (std::size_t i = 0; i < n; ++i) {
                const Point2f u = Sampler(kind, 5, 3 * i, i % 11).pair(6);
                EXPECT_EQ(x[i], u.x) << level << " " << i;
                EXPECT_EQ(y[i], u.y) << level << " " << i;
            }
        };
        expect_pairs(sampler_pairs, "chosen");
        expect_pairs(v2::sampler_pairs, "v2");
        if (__builtin_cpu_supports("x86-64-v3")) expect_pairs(v3::sampler_pairs, "v3");
        if (__builtin_cpu_supports("x86-64-v4")) expect_pairs(v4::sampler_pairs, "v4");
    }
}

// Seeds that run side by side in one residual, for small seeds as users choose them. Detected mutation: pass() without its + 1.
TEST(Streams, SeedsOfOneResidualDiffer) {
    for (const std::uint64_t seed : {0ull, 1ull, 2ull, 1000ull}) {
        std::set<std::uint64_t> seeds{seed};
        std::size_t n = 1;
        const auto add = [&](std::uint64_t other) { seeds.insert(other), ++n; };
        for (std::uint64_t k = 2; k < 20; ++k) add(streams::edit(seed, k));
        const std::uint64_t residual = streams::residual(seed);
        add(residual);
        add(streams::independent_of(residual));
        for (std::uint64_t first_sample = 0; first_sample < 200; ++first_sample) {
            const std::uint64_t pass = streams::pass(residual, first_sample);
            add(pass);
            add(streams::pilot(pass));
            for (std::uint64_t family = 0; family < 20; ++family) add(streams::family(pass, family));
        }
        EXPECT_EQ(seeds.size(), n) << "seed " << seed;
    }
}

}  // namespace
}  // namespace loom::test
