// Errors of animations over time.
#include "stages/compare/sequence.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "stages/core/sampling/sampler.h"

namespace loom::compare {
namespace {

constexpr std::size_t n_values = 3 * 4000, n_frames = 16;

/// Nearly normal numbers of mean 0 and variance 1.
float noise(std::uint64_t frame, std::size_t value) {
    float sum = 0;
    for (std::uint32_t k = 0; k < 6; ++k) {
        const Point2f u = Sampler(SamplerKind::independent, 4, value, frame).pair(k);
        sum += u.x + u.y;
    }
    return sum - 6;
}

/// Errors of variance .04, of which a share stays the same in all frames, around a picture of .5; pixels below `moving` move.
SequenceErrors sequence(double frozen, std::size_t moving = 0, float reference_noise = 0) {
    SequenceErrors errors("test", n_frames);
    for (std::uint64_t t = 0; t < n_frames; ++t) {
        std::vector<float> x(n_values), r(n_values), var_r(n_values, reference_noise * reference_noise);
        for (std::size_t i = 0; i < n_values; ++i) {
            const float value = i / 3 < moving ? 0.3f + 0.05f * float(t % 5) : 0.5f;
            r[i] = value + reference_noise * noise(1000 + t, i);
            x[i] = value + 0.2f * float(std::sqrt(frozen)) * noise(100, i) +
                   0.2f * float(std::sqrt(1 - frozen)) * noise(t, i);
        }
        errors.add(10 + t, x, r, reference_noise > 0 ? var_r : std::vector<float>());
    }
    return errors;
}

// Detected mutations: the factor 1/2 of flicker lost; noise of the reference kept.
TEST(SequenceErrors, TellFrozenNoiseFromFlicker) {
    for (const double share : {0.0, 0.5, 1.0})
        for (const float reference_noise : {0.0f, 0.04f}) {
            const SequenceErrors errors = sequence(share, 0, reference_noise);
            const double relative = 0.04 / 0.26;
            EXPECT_NEAR(errors.all().frozen(), share, 0.02) << share;
            EXPECT_NEAR(errors.all().mean_error(), relative, 0.06 * relative) << share;
            EXPECT_NEAR(errors.all().mean_flicker(), (1 - share) * relative, 0.06 * relative) << share;
        }
    const SequenceErrors errors = sequence(0.5);
    ASSERT_EQ(errors.frames().size(), n_frames);
    EXPECT_EQ(errors.frames()[3].number, 13u);
    EXPECT_NEAR(errors.relmse(), 0.04 / 0.26, 0.003);
    EXPECT_EQ(errors.frames().back().all.n, 0);
}

TEST(SequenceErrors, StillPixelsAreThoseWhoseReferenceStays) {
    const SequenceErrors errors = sequence(1, 1000);
    EXPECT_EQ(errors.still().n, 3.0 * 3000 * (n_frames - 1));
    EXPECT_EQ(errors.all().n, 3.0 * 4000 * (n_frames - 1));
}

// New noise is flat at its relMSE; what stays is at frequency 0 and, by the window, beside it.
TEST(SequenceErrors, SpectrumOfKnownNoise) {
    const std::vector<double> fresh = sequence(0).spectrum(), frozen = sequence(1).spectrum();
    ASSERT_EQ(fresh.size(), n_frames / 2 + 1);
    for (const double power : fresh) EXPECT_NEAR(power, 0.04 / 0.26, 0.005);
    EXPECT_GT(frozen[0], 8 * fresh[0]);
    for (std::size_t k = 2; k < frozen.size(); ++k) EXPECT_LT(frozen[k], 1e-6);
    // A wave of two cycles in sixteen frames.
    SequenceErrors wave("wave", n_frames);
    for (std::uint64_t t = 0; t < n_frames; ++t) {
        const std::vector<float> r(n_values, 1),
            x(n_values, 1 + float(std::cos(2 * std::numbers::pi * 2 * double(t) / n_frames)));
        wave.add(t, x, r, {});
    }
    const std::vector<double> power = wave.spectrum();
    EXPECT_EQ(std::max_element(power.begin(), power.end()) - power.begin(), 2);
    EXPECT_LT(power[5], 1e-6);
}

// Of long sequences each step-th pixel.
TEST(SequenceErrors, SpectrumOfAPartOfThePixels) {
    SequenceErrors all("all", n_frames), part("part", n_frames, n_values * n_frames / 5);
    for (std::uint64_t t = 0; t < n_frames; ++t) {
        std::vector<float> r(n_values, 0.5f), x(n_values);
        for (std::size_t i = 0; i < n_values; ++i) x[i] = 0.5f + 0.2f * noise(t, i);
        all.add(t, x, r, {}), part.add(t, x, r, {});
    }
    const std::vector<double> a = all.spectrum(), b = part.spectrum();
    for (std::size_t k = 0; k < a.size(); ++k) EXPECT_NEAR(a[k], b[k], 0.1 * a[k]);
}

}  // namespace
}  // namespace loom::compare
