// Detected mutations: eta in place of 1/eta from inside; R_p without R_s for conductors.

#include "stages/core/scattering/fresnel.h"

#include <gtest/gtest.h>

namespace loom {
namespace {

TEST(Fresnel, DielectricAtKnownAngles) {
    // Normal incidence: ((η - 1) / (η + 1))².
    EXPECT_NEAR(fresnel_dielectric(1.0, 1.5).reflectance, 0.04, 1e-12);
    EXPECT_NEAR(fresnel_dielectric(-1.0, 1.5).reflectance, 0.04, 1e-12);
    // Brewster's angle, tan θ = η: R_p = 0 and R_s = cos²(2θ).
    const double theta = std::atan(1.5);
    EXPECT_NEAR(fresnel_dielectric(std::cos(theta), 1.5).reflectance, 0.5 * sqr(std::cos(2 * theta)), 1e-12);
    EXPECT_EQ(fresnel_dielectric(0.0f, 1.5f).reflectance, 1);
    EXPECT_EQ(fresnel_dielectric(0.0f, 1.0f).reflectance, 0);
    EXPECT_EQ(fresnel_dielectric(0.3f, 1.0f).reflectance, 0);
}

TEST(Fresnel, IsTheSameFromBothEndsOfARefractedRay) {
    for (const double cos : {0.95, 0.5, 0.2}) {
        const auto in = fresnel_dielectric(cos, 1.5);
        EXPECT_LT(in.cos_t, 0);
        EXPECT_NEAR(std::sqrt(1 - sqr(in.cos_t)) * 1.5, std::sqrt(1 - cos * cos), 1e-12);  // Snell
        EXPECT_NEAR(fresnel_dielectric(in.cos_t, 1.5).reflectance, in.reflectance, 1e-12);
        EXPECT_NEAR(fresnel_dielectric(in.cos_t, 1.5).cos_t, cos, 1e-12);
    }
}

TEST(Fresnel, TotalInternalReflection) {
    const auto f = fresnel_dielectric(-0.5f, 1.5f);  // sin = 0.866 > 1 / 1.5
    EXPECT_FLOAT_EQ(f.reflectance, 1);
    EXPECT_EQ(f.cos_t, 0);
    EXPECT_FLOAT_EQ(f.eta_it, 1 / 1.5f);
    EXPECT_FLOAT_EQ(f.eta_ti, 1.5f);
}

TEST(Fresnel, ConductorWithoutAbsorptionIsADielectric) {
    for (const double cos : {1.0, 0.7, 0.3, 0.05})
        EXPECT_NEAR(fresnel_conductor(cos, 1.5, 0.0), fresnel_dielectric(cos, 1.5).reflectance, 1e-12);
}

TEST(Fresnel, ConductorAtNormalIncidenceAndItsSigns) {
    // ((η - 1)² + k²) / ((η + 1)² + k²)
    EXPECT_NEAR(fresnel_conductor(1.0, 0.2, 3.9), (0.64 + 15.21) / (1.44 + 15.21), 1e-12);
    EXPECT_EQ(fresnel_conductor(0.4, -0.2, -3.9), fresnel_conductor(0.4, 0.2, 3.9));
    for (const float cos : {1.0f, 0.5f, 0.01f}) EXPECT_EQ(fresnel_conductor(cos, 0.0f, 1.0f), 1);
}

TEST(Fresnel, DiffuseReflectanceIsTheCosineMean) {
    for (const double eta : {1.3, 1.5, 2.0, 1 / 1.3, 1 / 1.5}) {
        double mean = 0;
        constexpr int n = 200000;
        for (int i = 0; i < n; ++i) {
            const double mu = (i + 0.5) / n;
            mean += 2 * mu * fresnel_dielectric(mu, eta).reflectance / n;
        }
        EXPECT_NEAR(fresnel_diffuse_reflectance(eta), mean, 0.006 * mean) << eta;
    }
}

TEST(Fresnel, RefractedDirectionObeysSnell) {
    const Vector3<double> m = normalize(Vector3<double>{0.1, -0.2, 1});
    for (const Vector3<double>& w :
         {normalize(Vector3<double>{0.5, 0.3, 0.7}), normalize(Vector3<double>{-0.1, 0.2, -0.9})}) {
        const auto f = fresnel_dielectric(dot(w, m), 1.5);
        const Vector3<double> t = refract(w, m, f);
        EXPECT_NEAR(length(t), 1, 1e-12);
        EXPECT_NEAR(length(cross(t, m)) * f.eta_it, length(cross(w, m)), 1e-12);
        EXPECT_LT(dot(t, m) * dot(w, m), 0);
    }
}

}  // namespace
}  // namespace loom
