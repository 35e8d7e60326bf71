// Detected mutations: cos² in place of cos⁴ in Beckmann's D; the alpha of the other axis in GGX's; the stretched view
// direction added with the wrong sign.

#include "stages/core/scattering/microfacet.h"

#include <gtest/gtest.h>

#include "tests/unit/bsdf_cases.h"

namespace loom::test {
namespace {

/// ∫ g over the upper hemisphere by the midpoint rule, in slopes' polar coordinates stretched to roughness.
template <class G>
double hemisphere_integral(double alpha, G&& g) {
    constexpr int n_r = 4000, n_phi = 256;
    double sum = 0;
    for (int i = 0; i < n_r; ++i) {
        // tan θ = alpha t / (1 - t), so that lobe and tail are both resolved.
        const double t = (i + 0.5) / n_r, tan = alpha * t / (1 - t);
        const double cos = 1 / std::sqrt(1 + tan * tan), sin = tan * cos;
        const double d_theta = alpha / sqr(1 - t) * cos * cos / n_r;
        for (int j = 0; j < n_phi; ++j) {
            const double phi = 2 * pi_double * (j + 0.5) / n_phi;
            sum += g(Vector3<double>{sin * std::cos(phi), sin * std::sin(phi), cos}) * sin * d_theta * 2 * pi_double /
                   n_phi;
        }
    }
    return sum;
}

TEST(Microfacet, ProjectedFacetsCoverTheSurfaceAndTheVisibleOnesTheView) {
    for (const Microfacet type : {Microfacet::ggx, Microfacet::beckmann})
        for (const auto& [u, v] : {std::pair{0.05, 0.05}, {0.3, 0.3}, {0.2, 0.5}}) {
            const MicrofacetDistribution<double> facets(type, u, v);
            EXPECT_NEAR(hemisphere_integral(u, [&](const auto& m) { return facets.D(m) * m.z; }), 1, 2e-4);
            // Smith: ∫ G1 D max(w·m, 0) = w.z.                                    [Heitz2018] Eq. (4)
            for (const double cos : {0.9, 0.3, 0.1}) {
                const Vector3<double> w{std::sqrt(1 - cos * cos), 0, cos};
                const double seen = hemisphere_integral(u, [&](const auto& m) {
                    return std::max(0.0, dot(w, m)) * facets.D(m) * facets.G1_exact(w) / w.z;
                });
                EXPECT_NEAR(seen, 1, 1e-3) << u << " " << v << " " << cos;
                // The fit that Mitsuba evaluates stays within 0.35 %.
                EXPECT_NEAR(facets.G1(w, Vector3<double>{0, 0, 1}), facets.G1_exact(w), 0.0036);
            }
        }
}

TEST(Microfacet, SampledNormalsHaveTheirMean) {
    for (const Microfacet type : {Microfacet::ggx, Microfacet::beckmann}) {
        const MicrofacetDistribution<float> facets(type, 0.3f, 0.15f);
        const MicrofacetDistribution<double> exact(type, 0.3f, 0.15f);
        for (const bool visible : {true, false}) {
            const Vector3f w = direction(0.4f);
            const Vector3<double> wd(w);
            constexpr int n = 1 << 16;
            Vector3<double> mean;
            for (int i = 0; i < n; ++i)
                mean = mean + Vector3<double>(facets.sample(w, Draw(SamplerKind::sobol, 4, i).u, visible)) / double(n);
            for (int c = 0; c < 3; ++c) {
                const double expected = hemisphere_integral(0.3, [&](const Vector3<double>& m) {
                    const double density =
                        visible ? exact.D(m) * exact.G1_exact(wd) * std::max(0.0, dot(wd, m)) / wd.z : exact.D(m) * m.z;
                    return m[c] * density;
                });
                EXPECT_NEAR(mean[c], expected, 5e-4) << int(type) << visible << c;
            }
        }
    }
}

TEST(Microfacet, ErfInvInverts) {
    for (double x = -0.9999; x < 1; x += 0.0101) EXPECT_NEAR(std::erf(erf_inv(x)), x, 1e-6 * std::abs(x) + 1e-9);
}

// Would catch a lost term of the polynomial, or a power of two rounded the wrong way.
TEST(Microfacet, ExponentialOfAFloatIsThatOfTheLibrary) {
    for (double x = -86.9; x < 87.9; x += 1.37e-4) {
        const float f = float(x);
        ASSERT_NEAR(double(exponential(f)) / std::exp(double(f)), 1, 2.5e-7) << x;
    }
    EXPECT_EQ(exponential(0.0f), 1);
    EXPECT_LT(exponential(-1e30f), 2e-38f);
    EXPECT_TRUE(std::isfinite(exponential(1e30f)));
}

}  // namespace
}  // namespace loom::test
