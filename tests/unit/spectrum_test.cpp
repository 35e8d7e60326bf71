// Spectra, named materials: what a colour in a scene file means in linear RGB.

#include "stages/core/description/spectrum.h"

#include <gtest/gtest.h>

#include <algorithm>

#include "stages/core/description/ior.h"

namespace loom {
namespace {

void expect_rgb(const Spectrum& got, double r, double g, double b, double relative = 1e-5) {
    EXPECT_NEAR(got.r, r, relative * std::abs(r) + 1e-7);
    EXPECT_NEAR(got.g, g, relative * std::abs(g) + 1e-7);
    EXPECT_NEAR(got.b, b, relative * std::abs(b) + 1e-7);
}

// Check values computed by Mitsuba 3.8 (scalar_rgb). Caught: the wrong illuminant for either use, the
// integral over 1000 intervals instead of 1000 points, a value held beyond the last sample.
TEST(Spectrum, SampledReflectanceAndEmission) {
    const SampledSpectrum blue{{400, 0.78}, {500, 0.5}, {600, 0.3}, {700, 0.1}};
    expect_rgb(rgb_from_spectrum(blue, SpectrumUse::reflectance), 0.216525, 0.410873, 0.656037);
    const SampledSpectrum warm{{400, 0}, {500, 8}, {600, 15.6}, {700, 18.4}};
    expect_rgb(rgb_from_spectrum(warm, SpectrumUse::emission), 20.7108, 10.8546, 2.77115);
    expect_rgb(rgb_from_spectrum(warm, SpectrumUse::reflectance), 1, 1, 1);
    const SampledSpectrum index{{400, 1.3}, {500, 1.5}, {600, 1.3}, {700, 0.1}};
    expect_rgb(rgb_from_spectrum(index, SpectrumUse::index), 0.988504, 1.44495, 1.40586);
}

TEST(Spectrum, ConstantIsGreyOnlyForReflectance) {
    expect_rgb(rgb_from_constant_spectrum(0.2f, SpectrumUse::reflectance), 0.2, 0.2, 0.2);
    expect_rgb(rgb_from_constant_spectrum(1, SpectrumUse::emission), 1.20480, 0.948292, 0.908916);
}

TEST(Spectrum, SrgbDecoding) {
    EXPECT_FLOAT_EQ(linear_from_srgb(0), 0);
    EXPECT_FLOAT_EQ(linear_from_srgb(1), 1);
    EXPECT_NEAR(linear_from_srgb(0.5f), 0.21404114f, 1e-7);
    EXPECT_NEAR(linear_from_srgb(0.04f), 0.04f / 12.92f, 1e-9);
}

TEST(Ior, NamedMaterials) {
    EXPECT_FLOAT_EQ(*dielectric_ior("bk7"), 1.5046f);
    EXPECT_FLOAT_EQ(*dielectric_ior("air"), 1.000277f);
    EXPECT_FLOAT_EQ(*dielectric_ior("acrylic glass"), 1.49f);
    EXPECT_FALSE(dielectric_ior("glass"));
    expect_rgb(conductor_ior("Au")->eta, 0.143036, 0.375307, 1.44205);
    expect_rgb(conductor_ior("Au")->k, 3.983, 2.38556, 1.60336);
    expect_rgb(conductor_ior("none")->k, 1, 1, 1);
    expect_rgb(conductor_ior("none")->eta, 0, 0, 0);
    EXPECT_EQ(conductor_ior("Be_palik")->eta, conductor_ior("Be")->eta);
    EXPECT_NE(conductor_ior("Cu_palik")->eta, conductor_ior("Cu")->eta);
    EXPECT_FALSE(conductor_ior("Ag_palik"));
    EXPECT_FALSE(conductor_ior("au"));
    for (const std::string& name : conductor_names()) EXPECT_TRUE(conductor_ior(name)) << name;
    for (const std::string& name : dielectric_names()) EXPECT_TRUE(dielectric_ior(name)) << name;
}

}  // namespace
}  // namespace loom
