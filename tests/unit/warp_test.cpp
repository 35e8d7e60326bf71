// Each warp against its density, by the moments of its samples and by its range. Detected mutations: the disk's radius
// squared; sin_cos_turn off by a quarter.

#include "stages/core/sampling/warp.h"

#include <gtest/gtest.h>

#include "tests/unit/bsdf_cases.h"

namespace loom::test {
namespace {

constexpr int n = 1 << 16;

/// Mean of g over the warped sobol points, whose error is far below 1e-3.
template <class G>
double mean_of(G&& g) {
    double sum = 0;
    for (int i = 0; i < n; ++i) sum += g(Draw(SamplerKind::sobol, 3, i).u);
    return sum / n;
}

TEST(Warp, SinCosAreThoseOfTheLibrary) {
    for (int i = 0; i <= 4096; ++i) {
        const float u = float(i) / 4096;
        const SinCos s = sin_cos_turn(u);
        EXPECT_NEAR(s.sin, std::sin(2 * pi_double * u), 2e-7);
        EXPECT_NEAR(s.cos, std::cos(2 * pi_double * u), 2e-7);
    }
}

TEST(Warp, ConcentricDiskIsUniform) {
    EXPECT_NEAR(mean_of([](Point2f u) {
                    const Point2f p = sample_concentric_disk(u);
                    return p.x * p.x + p.y * p.y;
                }),
                0.5, 1e-4);
    EXPECT_NEAR(mean_of([](Point2f u) {
                    const Point2f p = sample_concentric_disk(u);
                    return p.x * p.y;
                }),
                0, 1e-4);
    EXPECT_NEAR(mean_of([](Point2f u) { return sqr(sample_concentric_disk(u).x); }), 0.25, 1e-4);
    EXPECT_NEAR(mean_of([](Point2f u) {
                    const Point2f p = sample_concentric_disk(u);
                    return p.x * p.x + p.y * p.y < 0.25f;
                }),
                0.25, 1e-3);
    EXPECT_NEAR(pdf_concentric_disk() * pi_double, 1, 1e-6);
    const Point2f centre = sample_concentric_disk({0.5f, 0.5f});
    EXPECT_EQ(centre.x, 0);
    EXPECT_EQ(centre.y, 0);
}

TEST(Warp, CosineHemisphere) {
    EXPECT_NEAR(mean_of([](Point2f u) { return sample_cosine_hemisphere(u).z; }), 2.0 / 3, 1e-4);
    EXPECT_NEAR(mean_of([](Point2f u) { return sqr(sample_cosine_hemisphere(u).z); }), 0.5, 1e-4);
    // ∫ 1 dω = E[1 / pdf] = 2π, but with a heavy tail: weigh by the cosine, ∫ cos dω = π.
    EXPECT_NEAR(mean_of([](Point2f u) {
                    const Vector3f w = sample_cosine_hemisphere(u);
                    return w.z / pdf_cosine_hemisphere(w);
                }),
                pi_double, 1e-4);
    EXPECT_EQ(pdf_cosine_hemisphere(Vector3f{0, 0, -1}), 0);
    // The rim of the disk keeps a density: no sample may have none.
    EXPECT_GT(pdf_cosine_hemisphere(sample_cosine_hemisphere({0, 0.5f})), 0);
}

TEST(Warp, UniformSphereAndHemisphere) {
    EXPECT_NEAR(mean_of([](Point2f u) { return sqr(sample_uniform_sphere(u).z); }), 1.0 / 3, 1e-4);
    EXPECT_NEAR(mean_of([](Point2f u) { return sqr(sample_uniform_sphere(u).x); }), 1.0 / 3, 1e-4);
    EXPECT_NEAR(mean_of([](Point2f u) { return sample_uniform_sphere(u).y; }), 0, 1e-4);
    EXPECT_NEAR(mean_of([](Point2f u) { return sample_uniform_hemisphere(u).z; }), 0.5, 1e-4);
    EXPECT_NEAR(mean_of([](Point2f u) { return length(sample_uniform_sphere(u)); }), 1, 1e-6);
    EXPECT_NEAR(pdf_uniform_sphere() * 4 * pi_double, 1, 1e-6);
    EXPECT_NEAR(pdf_uniform_hemisphere({0, 0, 1}) * 2 * pi_double, 1, 1e-6);
    EXPECT_EQ(pdf_uniform_hemisphere({0, 0, -1}), 0);
}

TEST(Warp, UniformConeStaysPreciseWhenNarrow) {
    for (const float h : {1.0f, 0.1f, 1e-8f}) {
        EXPECT_NEAR(mean_of([&](Point2f u) {
                        const Vector3f w = sample_uniform_cone(u, h);
                        return (w.x * w.x + w.y * w.y) / h;
                    }),
                    1 - h / 3, 1e-4);
        EXPECT_NEAR(pdf_uniform_cone({0, 0, 1}, h) * 2 * pi_double * h, 1, 1e-6);
    }
    EXPECT_EQ(pdf_uniform_cone({1, 0, 0}, 0.1f), 0);
}

TEST(Warp, TriangleIsUniform) {
    for (const auto corner : {0, 1, 2}) {
        const auto b = [&](Point2f u) {
            const Point2f p = sample_triangle(u);
            return corner == 0 ? 1 - p.x - p.y : corner == 1 ? p.x : p.y;
        };
        EXPECT_NEAR(mean_of(b), 1.0 / 3, 1e-4);
        EXPECT_NEAR(mean_of([&](Point2f u) { return b(u) * b(u); }), 1.0 / 6, 1e-4);
        EXPECT_EQ(mean_of([&](Point2f u) { return b(u) < -1e-6f; }), 0);
    }
    EXPECT_EQ(pdf_triangle(), 2);
}

TEST(Warp, TentHasItsVarianceAndDensity) {
    EXPECT_NEAR(mean_of([](Point2f u) { return sqr(sample_tent(u.x, 2)); }), 4.0 / 6, 1e-4);
    EXPECT_NEAR(mean_of([](Point2f u) { return sample_tent(u.x, 2); }), 0, 1e-4);
    // ∫ (1 - |x|) dx = 1 by importance sampling: exact for every sample when the density is the tent's own.
    EXPECT_NEAR(mean_of([](Point2f u) {
                    const float x = sample_tent(0.999f * u.x + 0.0005f, 1);
                    return (1 - std::fabs(x)) / pdf_tent(x, 1);
                }),
                1, 1e-5);
    EXPECT_EQ(pdf_tent(2, 1), 0);
    EXPECT_EQ(pdf_tent(0, 2), 0.5f);
}

}  // namespace
}  // namespace loom::test
