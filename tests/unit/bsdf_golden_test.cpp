// Values of each kind, so that its conventions hold without another renderer at hand. Those of the kinds that Mitsuba 3
// has were taken from its release 3.8.0 (scalar_rgb, bsdf.eval(), and weight times pdf of bsdf.sample() for delta
// lobes; its wi is our wo). Detected mutations: η² left out of the refraction, (1 - F) of wi left out of the plastic,
// alpha_u and alpha_v swapped, G1 of one side only.

#include <gtest/gtest.h>

#include "tests/unit/bsdf_cases.h"

namespace loom::test {
namespace {

struct Golden {
    BsdfKind kind;
    Microfacet distribution;
    float alpha_u, alpha_v, int_ior, ext_ior;
    bool two_sided, nonlinear;
    Vector3f wo, wi;
    Spectrum f_cos;
};

BsdfModel golden_model(BsdfKind kind) {
    BsdfModel m;
    m.kind = kind;
    m.diffuse = {0.5f, 0.4f, 0.3f};
    m.specular = {0.9f, 0.8f, 0.7f};
    m.transmittance = {0.6f, 0.8f, 1.0f};
    m.eta_c = {0.2f, 0.9f, 1.4f};
    m.k_c = {3.9f, 2.4f, 1.9f};
    m.int_ior = 1.5f;
    m.ext_ior = 1.0f;
    return m;
}

// clang-format off
const Golden golden[] = {
    {BsdfKind::diffuse, Microfacet::ggx, 0.1f, 0.1f, 1.49f, 1.0f, false, false, {0.341882f, 0.227921f, 0.911685f}, {-0.635001f, 0.127f, 0.762001f}, {0.1212762f, 0.09702098f, 0.07276573f}},
    {BsdfKind::diffuse, Microfacet::ggx, 0.1f, 0.1f, 1.49f, 1.0f, true, false, {0.341882f, 0.227921f, -0.911685f}, {-0.635001f, 0.127f, -0.762001f}, {0.1212762f, 0.09702098f, 0.07276573f}},
    {BsdfKind::rough_conductor, Microfacet::ggx, 0.1f, 0.1f, 1.49f, 1.0f, false, false, {0.341882f, 0.227921f, 0.911685f}, {-0.635001f, 0.127f, 0.762001f}, {0.1176549f, 0.06766256f, 0.03880595f}},
    {BsdfKind::rough_conductor, Microfacet::ggx, 0.1f, 0.1f, 1.49f, 1.0f, false, false, {0.980522f, -0.108947f, 0.16342f}, {-0.847998f, 0.317999f, 0.423999f}, {0.1484547f, 0.09222523f, 0.06086235f}},
    {BsdfKind::rough_conductor, Microfacet::ggx, 0.1f, 0.1f, 1.49f, 1.0f, false, false, {0.341882f, 0.227921f, 0.911685f}, {-0.363542f, -0.204493f, 0.908856f}, {7.035108f, 4.045385f, 2.316047f}},
    {BsdfKind::rough_dielectric, Microfacet::ggx, 0.1f, 0.1f, 1.5f, 1.0f, false, false, {0.341882f, 0.227921f, 0.911685f}, {-0.635001f, 0.127f, 0.762001f}, {0.00512784f, 0.00455808f, 0.00398832f}},
    {BsdfKind::rough_dielectric, Microfacet::ggx, 0.1f, 0.1f, 1.5f, 1.0f, false, false, {0.341882f, 0.227921f, 0.911685f}, {-0.107833f, -0.215666f, -0.970495f}, {0.2433661f, 0.3244881f, 0.4056101f}},
    {BsdfKind::rough_dielectric, Microfacet::ggx, 0.1f, 0.1f, 1.5f, 1.0f, false, false, {-0.492366f, 0.123091f, -0.86164f}, {0.215666f, 0.107833f, -0.970495f}, {0.01593647f, 0.01416575f, 0.01239503f}},
    {BsdfKind::rough_dielectric, Microfacet::ggx, 0.1f, 0.1f, 1.5f, 1.0f, false, false, {0.20739f, 0.518476f, -0.829561f}, {-0.358569f, -0.717137f, 0.597614f}, {10.93517f, 14.58023f, 18.22528f}},
    {BsdfKind::rough_conductor, Microfacet::ggx, 0.4f, 0.2f, 1.49f, 1.0f, false, false, {0.341882f, 0.227921f, 0.911685f}, {-0.635001f, 0.127f, 0.762001f}, {0.1950047f, 0.112146f, 0.06431817f}},
    {BsdfKind::rough_conductor, Microfacet::ggx, 0.4f, 0.2f, 1.49f, 1.0f, false, false, {0.980522f, -0.108947f, 0.16342f}, {-0.847998f, 0.317999f, 0.423999f}, {0.1725322f, 0.107183f, 0.07073348f}},
    {BsdfKind::rough_conductor, Microfacet::ggx, 0.4f, 0.2f, 1.49f, 1.0f, false, false, {0.341882f, 0.227921f, 0.911685f}, {-0.363542f, -0.204493f, 0.908856f}, {0.9138939f, 0.5255148f, 0.3008655f}},
    {BsdfKind::rough_dielectric, Microfacet::ggx, 0.4f, 0.2f, 1.5f, 1.0f, false, false, {0.341882f, 0.227921f, 0.911685f}, {-0.635001f, 0.127f, 0.762001f}, {0.008499039f, 0.007554702f, 0.006610364f}},
    {BsdfKind::rough_dielectric, Microfacet::ggx, 0.4f, 0.2f, 1.5f, 1.0f, false, false, {0.341882f, 0.227921f, 0.911685f}, {-0.107833f, -0.215666f, -0.970495f}, {1.134011f, 1.512015f, 1.890018f}},
    {BsdfKind::rough_dielectric, Microfacet::ggx, 0.4f, 0.2f, 1.5f, 1.0f, false, false, {-0.492366f, 0.123091f, -0.86164f}, {0.215666f, 0.107833f, -0.970495f}, {0.01964621f, 0.0174633f, 0.01528039f}},
    {BsdfKind::rough_dielectric, Microfacet::ggx, 0.4f, 0.2f, 1.5f, 1.0f, false, false, {0.20739f, 0.518476f, -0.829561f}, {-0.358569f, -0.717137f, 0.597614f}, {4.941262f, 6.588349f, 8.235436f}},
    {BsdfKind::rough_plastic, Microfacet::ggx, 0.1f, 0.1f, 1.49f, 1.0f, false, false, {0.341882f, 0.227921f, 0.911685f}, {-0.635001f, 0.127f, 0.762001f}, {0.1148803f, 0.0923458f, 0.06981131f}},
    {BsdfKind::rough_plastic, Microfacet::ggx, 0.1f, 0.1f, 1.49f, 1.0f, false, false, {0.980522f, -0.108947f, 0.16342f}, {-0.847998f, 0.317999f, 0.423999f}, {0.06961741f, 0.05833364f, 0.04704986f}},
    {BsdfKind::rough_plastic, Microfacet::ggx, 0.5f, 0.5f, 1.49f, 1.0f, false, true, {0.341882f, 0.227921f, 0.911685f}, {-0.635001f, 0.127f, 0.762001f}, {0.06210821f, 0.0490229f, 0.03669653f}},
    {BsdfKind::rough_plastic, Microfacet::ggx, 0.5f, 0.5f, 1.49f, 1.0f, false, true, {0.980522f, -0.108947f, 0.16342f}, {-0.847998f, 0.317999f, 0.423999f}, {0.08020127f, 0.06907192f, 0.05821476f}},
    {BsdfKind::rough_conductor, Microfacet::beckmann, 0.1f, 0.1f, 1.49f, 1.0f, false, false, {0.341882f, 0.227921f, 0.911685f}, {-0.635001f, 0.127f, 0.762001f}, {0.004486694f, 0.002580269f, 0.001479841f}},
    {BsdfKind::rough_conductor, Microfacet::beckmann, 0.1f, 0.1f, 1.49f, 1.0f, false, false, {0.980522f, -0.108947f, 0.16342f}, {-0.847998f, 0.317999f, 0.423999f}, {1.113982e-06f, 6.920442e-07f, 4.567019e-07f}},
    {BsdfKind::rough_conductor, Microfacet::beckmann, 0.1f, 0.1f, 1.49f, 1.0f, false, false, {0.341882f, 0.227921f, 0.911685f}, {-0.363542f, -0.204493f, 0.908856f}, {7.255339f, 4.172024f, 2.38855f}},
    {BsdfKind::rough_dielectric, Microfacet::beckmann, 0.1f, 0.1f, 1.5f, 1.0f, false, false, {0.341882f, 0.227921f, 0.911685f}, {-0.635001f, 0.127f, 0.762001f}, {0.000195547f, 0.0001738195f, 0.0001520921f}},
    {BsdfKind::rough_dielectric, Microfacet::beckmann, 0.1f, 0.1f, 1.5f, 1.0f, false, false, {0.341882f, 0.227921f, 0.911685f}, {-0.107833f, -0.215666f, -0.970495f}, {4.369274e-05f, 5.825698e-05f, 7.282123e-05f}},
    {BsdfKind::rough_dielectric, Microfacet::beckmann, 0.1f, 0.1f, 1.5f, 1.0f, false, false, {-0.492366f, 0.123091f, -0.86164f}, {0.215666f, 0.107833f, -0.970495f}, {0.007894007f, 0.007016896f, 0.006139784f}},
    {BsdfKind::rough_dielectric, Microfacet::beckmann, 0.1f, 0.1f, 1.5f, 1.0f, false, false, {0.20739f, 0.518476f, -0.829561f}, {-0.358569f, -0.717137f, 0.597614f}, {15.5761f, 20.76813f, 25.96017f}},
    {BsdfKind::rough_conductor, Microfacet::beckmann, 0.4f, 0.2f, 1.49f, 1.0f, false, false, {0.341882f, 0.227921f, 0.911685f}, {-0.635001f, 0.127f, 0.762001f}, {0.2899917f, 0.1667724f, 0.0956476f}},
    {BsdfKind::rough_conductor, Microfacet::beckmann, 0.4f, 0.2f, 1.49f, 1.0f, false, false, {0.980522f, -0.108947f, 0.16342f}, {-0.847998f, 0.317999f, 0.423999f}, {0.1683892f, 0.1046093f, 0.06903496f}},
    {BsdfKind::rough_conductor, Microfacet::beckmann, 0.4f, 0.2f, 1.49f, 1.0f, false, false, {0.341882f, 0.227921f, 0.911685f}, {-0.363542f, -0.204493f, 0.908856f}, {0.9305185f, 0.5350744f, 0.3063385f}},
    {BsdfKind::rough_dielectric, Microfacet::beckmann, 0.4f, 0.2f, 1.5f, 1.0f, false, false, {0.341882f, 0.227921f, 0.911685f}, {-0.635001f, 0.127f, 0.762001f}, {0.01263893f, 0.0112346f, 0.009830277f}},
    {BsdfKind::rough_dielectric, Microfacet::beckmann, 0.4f, 0.2f, 1.5f, 1.0f, false, false, {0.341882f, 0.227921f, 0.911685f}, {-0.107833f, -0.215666f, -0.970495f}, {1.606214f, 2.141619f, 2.677024f}},
    {BsdfKind::rough_dielectric, Microfacet::beckmann, 0.4f, 0.2f, 1.5f, 1.0f, false, false, {-0.492366f, 0.123091f, -0.86164f}, {0.215666f, 0.107833f, -0.970495f}, {0.02756274f, 0.02450022f, 0.02143769f}},
    {BsdfKind::rough_dielectric, Microfacet::beckmann, 0.4f, 0.2f, 1.5f, 1.0f, false, false, {0.20739f, 0.518476f, -0.829561f}, {-0.358569f, -0.717137f, 0.597614f}, {6.231988f, 8.309318f, 10.38665f}},
    {BsdfKind::rough_plastic, Microfacet::beckmann, 0.1f, 0.1f, 1.49f, 1.0f, false, false, {0.341882f, 0.227921f, 0.911685f}, {-0.635001f, 0.127f, 0.762001f}, {0.1180458f, 0.09445347f, 0.07086115f}},
    {BsdfKind::rough_plastic, Microfacet::beckmann, 0.1f, 0.1f, 1.49f, 1.0f, false, false, {0.980522f, -0.108947f, 0.16342f}, {-0.847998f, 0.317999f, 0.423999f}, {0.03949129f, 0.03159305f, 0.02369481f}},
    {BsdfKind::rough_plastic, Microfacet::beckmann, 0.5f, 0.5f, 1.49f, 1.0f, false, true, {0.341882f, 0.227921f, 0.911685f}, {-0.635001f, 0.127f, 0.762001f}, {0.07364754f, 0.05722733f, 0.04233121f}},
    {BsdfKind::rough_plastic, Microfacet::beckmann, 0.5f, 0.5f, 1.49f, 1.0f, false, true, {0.980522f, -0.108947f, 0.16342f}, {-0.847998f, 0.317999f, 0.423999f}, {0.1797956f, 0.1560509f, 0.1330033f}},
    {BsdfKind::plastic, Microfacet::ggx, 0.1f, 0.1f, 1.49f, 1.0f, false, false, {0.341882f, 0.227921f, 0.911685f}, {-0.635001f, 0.127f, 0.762001f}, {0.1225022f, 0.09800176f, 0.07350133f}},
    {BsdfKind::plastic, Microfacet::ggx, 0.1f, 0.1f, 1.49f, 1.0f, false, false, {0.980522f, -0.108947f, 0.16342f}, {-0.847998f, 0.317999f, 0.423999f}, {0.03883812f, 0.0310705f, 0.02330288f}},
    {BsdfKind::plastic, Microfacet::ggx, 0.1f, 0.1f, 1.49f, 1.0f, false, true, {0.341882f, 0.227921f, 0.911685f}, {-0.635001f, 0.127f, 0.762001f}, {0.07115209f, 0.05251874f, 0.03656103f}},
    {BsdfKind::plastic, Microfacet::ggx, 0.1f, 0.1f, 1.49f, 1.0f, false, true, {0.980522f, -0.108947f, 0.16342f}, {-0.847998f, 0.317999f, 0.423999f}, {0.02255807f, 0.01665055f, 0.01159132f}},
};
// clang-format on

TEST(BsdfGolden, ValuesOfMitsuba3) {
    for (const Golden& g : golden) {
        BsdfModel model = golden_model(g.kind);
        model.distribution = g.distribution;
        model.alpha_u = g.alpha_u;
        model.alpha_v = g.alpha_v;
        model.int_ior = g.int_ior;
        model.ext_ior = g.ext_ior;
        model.two_sided = g.two_sided;
        model.nonlinear = g.nonlinear;
        prepare(model);
        const BsdfValue<float> v = f_cos_pdf(Bsdf<float>(model), g.wo, g.wi);
        for (int c = 0; c < 3; ++c)
            EXPECT_NEAR(v.f_cos[c], g.f_cos[c], 1e-4f * g.f_cos[c]) << "row " << &g - golden << " channel " << c;
    }
}

struct GoldenDelta {
    BsdfKind kind;
    Lobe lobe;
    float int_ior;
    Spectrum eta_c, k_c;
    Vector3f wo, wi;
    Spectrum value;
    float eta;
};

TEST(BsdfGolden, DeltaLobesOfMitsuba3) {
    const Spectrum eta_c{0.2f, 0.9f, 1.4f}, k_c{3.9f, 2.4f, 1.9f};
    const Vector3f above{0.341882f, 0.227921f, 0.911685f}, below{0.341882f, 0.227921f, -0.911685f};
    const GoldenDelta rows[] = {
        {BsdfKind::conductor,
         Lobe::delta_reflection,
         1.5f,
         eta_c,
         k_c,
         above,
         {-0.341882f, -0.227921f, 0.911685f},
         {0.856618f, 0.4925787f, 0.2819974f},
         1},
        // Published scenes carry negative indices.
        {BsdfKind::conductor,
         Lobe::delta_reflection,
         1.5f,
         {-0.2f, 0.9f, 1.4f},
         {-3.9f, 2.4f, 1.9f},
         {0.970495f, 0.107833f, 0.215666f},
         {-0.970495f, -0.107833f, 0.215666f},
         {0.8499787f, 0.567876f, 0.4012923f},
         1},
        // Material `none`: a perfect mirror, times the specular reflectance.
        {BsdfKind::conductor,
         Lobe::delta_reflection,
         1.5f,
         Spectrum(0.0f),
         Spectrum(1.0f),
         above,
         {-0.341882f, -0.227921f, 0.911685f},
         {0.9f, 0.8f, 0.7f},
         1},
        {BsdfKind::dielectric,
         Lobe::delta_reflection,
         1.5f,
         eta_c,
         k_c,
         above,
         {-0.341882f, -0.227921f, 0.911685f},
         {0.03654305f, 0.03248271f, 0.02842237f},
         1},
        {BsdfKind::dielectric,
         Lobe::delta_transmission,
         1.5f,
         eta_c,
         k_c,
         above,
         {-0.227921f, -0.151947f, -0.961751f},
         {0.2558391f, 0.3411188f, 0.4263985f},
         1.5f},
        {BsdfKind::dielectric,
         Lobe::delta_reflection,
         1.5f,
         eta_c,
         k_c,
         below,
         {-0.341882f, -0.227921f, -0.911685f},
         {0.04006505f, 0.03561338f, 0.03116171f},
         1},
        {BsdfKind::dielectric,
         Lobe::delta_transmission,
         1.5f,
         eta_c,
         k_c,
         below,
         {-0.512823f, -0.341881f, 0.787484f},
         {1.289902f, 1.71987f, 2.149837f},
         1 / 1.5f},
        {BsdfKind::thin_dielectric,
         Lobe::delta_reflection,
         1.5f,
         eta_c,
         k_c,
         below,
         {-0.341882f, -0.227921f, -0.911685f},
         {0.07023435f, 0.06243054f, 0.05462672f},
         1},
        {BsdfKind::thin_dielectric,
         Lobe::delta_transmission,
         1.5f,
         eta_c,
         k_c,
         below,
         {-0.341882f, -0.227921f, 0.911685f},
         {0.5531771f, 0.7375695f, 0.9219618f},
         1},
        {BsdfKind::plastic,
         Lobe::delta_reflection,
         1.49f,
         eta_c,
         k_c,
         above,
         {-0.341882f, -0.227921f, 0.911685f},
         {0.03538768f, 0.03145572f, 0.02752375f},
         1},
    };
    for (const GoldenDelta& g : rows) {
        BsdfModel model = golden_model(g.kind);
        model.int_ior = g.int_ior;
        model.eta_c = g.eta_c;
        model.k_c = g.k_c;
        prepare(model);
        const DeltaLobe<float> d = delta_lobe(Bsdf<float>(model), g.wo, g.lobe);
        for (int c = 0; c < 3; ++c) {
            EXPECT_NEAR(d.value[c], g.value[c], 1e-5f * g.value[c]) << "row " << &g - rows;
            EXPECT_NEAR(d.wi[c], g.wi[c], 2e-6f) << "row " << &g - rows;
        }
        EXPECT_FLOAT_EQ(d.eta, g.eta);
        EXPECT_GT(d.pmf, 0);
    }
}

/// Worked out by hand from the published formula: at the mirror direction cos a = 1.
TEST(BsdfGolden, PhongAtTheMirrorDirectionAndBehindTheLobe) {
    BsdfModel model = golden_model(BsdfKind::phong);
    model.specular = Spectrum(0.2f);
    model.exponent = 30;
    prepare(model);
    const Bsdf<float> bsdf(model);
    const Vector3f wo = direction(0.6f), mirror = reflect(wo);
    EXPECT_NEAR(f_cos_pdf(bsdf, wo, mirror).f_cos.r, (0.5 + 0.2 * 32 / 2) / pi_double * 0.6, 1e-5);
    EXPECT_NEAR(f_cos_pdf(bsdf, direction(0.1f), direction(0.1f)).f_cos.r, 0.5 / pi_double * 0.1, 1e-7);
}

/// wo = wi = z: H = 2z, so the lobe is |H|² / (π α_u α_v H_z⁴) = 1 / (4 π α_u α_v).
TEST(BsdfGolden, WardAtNormalIncidence) {
    BsdfModel model = golden_model(BsdfKind::ward);
    model.specular = Spectrum(0.2f);
    model.alpha_u = 0.1f;
    model.alpha_v = 0.2f;
    prepare(model);
    const Vector3f z{0, 0, 1};
    EXPECT_NEAR(f_cos_pdf(Bsdf<float>(model), z, z).f_cos.r, (0.5 + 0.2 / (4 * 0.1 * 0.2)) / pi_double, 1e-6);
    // Half vector at slope (0.1, 0): one alpha_u away, e^-1; at slope (0, 0.1): half an alpha_v, e^-1/4.
    const Vector3f hu = normalize(Vector3f{0.1f, 0, 1}), hv = normalize(Vector3f{0, 0.1f, 1});
    const auto lobe = [&](const Vector3f& h) {
        const Vector3f wi = reflect(z, h);
        return f_cos_pdf(Bsdf<float>(model), z, wi).f_cos.r / wi.z - 0.5 / pi_double;
    };
    EXPECT_NEAR(lobe(hu) / lobe(hv), std::exp(-0.75), 1e-5);
}

TEST(BsdfGolden, PhongAndWardAreDarkenedWhenTheyWouldReflectTooMuch) {
    for (const BsdfKind kind : {BsdfKind::phong, BsdfKind::ward}) {
        BsdfModel model = golden_model(kind);
        prepare(model);
        EXPECT_NEAR(max_channel(model.diffuse + model.specular), 0.99, 1e-6);
    }
}

/// At normal incidence only C1 and C4 are left; with alpha = 0 the surface is Lambert's.
TEST(BsdfGolden, RoughDiffuseAtNormalIncidence) {
    BsdfModel model = golden_model(BsdfKind::rough_diffuse);
    const Vector3f z{0, 0, 1}, wi = direction(0.7f);
    model.alpha_u = 0;
    EXPECT_NEAR(f_cos_pdf(Bsdf<float>(model), direction(0.3f, 2.0f), wi).f_cos.r, 0.5 / pi_double * 0.7, 1e-6);
    model.alpha_u = 0.4f;
    const double s2 = 0.5 * 0.4 * 0.4;
    const double c1 = 1 - 0.5 * s2 / (s2 + 0.33), c4 = 0.17 * s2 / (s2 + 0.13);
    EXPECT_NEAR(f_cos_pdf(Bsdf<float>(model), z, wi).f_cos.r, (0.5 * c1 + 0.25 * c4) / pi_double * 0.7, 1e-6);
    // Against the light at a grazing angle it is brighter than Lambert's, with the light it is darker.
    const double back = f_cos_pdf(Bsdf<float>(model), direction(0.3f), direction(0.3f)).f_cos.r;
    const double forward = f_cos_pdf(Bsdf<float>(model), direction(0.3f), direction(0.3f, 0.7f + 3.14159f)).f_cos.r;
    EXPECT_GT(back, 0.5 / pi_double * 0.3);
    EXPECT_LT(forward, back);
}

}  // namespace
}  // namespace loom::test
