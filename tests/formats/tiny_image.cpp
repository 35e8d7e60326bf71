#include "tests/formats/tiny_image.h"

#include <gtest/gtest.h>

#include <algorithm>

namespace loom::testing {

Image tiny_image() {
    Image image;
    image.width = 4;
    image.height = 3;
    image.samples = 16;
    image.provenance.stage = "loom-test";
    image.provenance.release = "0.0.0";
    image.provenance.commit = "none";
    image.provenance.command = "loom-test --seed 7";
    image.provenance.seed = 7;
    image.provenance.inputs = {{"tiny scene.xml", "0123456789abcdef"}, {"sky.exr", "fedcba9876543210"}};
    image.provenance.plan = "method pt; layers albedo, normal, depth, variance";
    float value = 0.0f;
    for (const char* name : {"R", "G", "B", "VarMean.R", "VarMean.G", "VarMean.B", "Albedo.R", "Albedo.G", "Albedo.B",
                             "N.X", "N.Y", "N.Z", "Depth.Z"}) {
        for (float& x : image.add(name)) x = value += 0.01f;
    }
    return image;
}

Image tiny_sum() {
    Image image = tiny_image();
    image.scene = {"after \"all\".xml", "00112233445566ff"};
    image.ledger = {{{"before.xml", "0011223344556677"}, "loom-trace", "", 64, 7, 0.25, 16},
                    {{"", ""}, "moved: \"box\"\nremoved: ball", "dynamic", 8, ~std::uint64_t{0}, 1.0 / 3, 0},
                    {image.scene, "light changed", differences_method, 4, 9, 1e-300, 2}};
    return image;
}

Image tiny_residual() {
    Image image = tiny_image();
    image.ledger = {{{"after.xml", "00112233445566ff"}, "moved: box", "correlated", 16, 7, 0.5, 3}};
    float value = -0.3f;
    for (const char* name : {"Plus.R", "Plus.G", "Plus.B", "Minus.R", "Minus.G", "Minus.B", "Coverage.A"})
        for (float& x : image.add(name)) x = value += 0.01f;
    return image;
}

void expect_equal(const Image& a, const Image& b) {
    EXPECT_EQ(a.width, b.width);
    EXPECT_EQ(a.height, b.height);
    EXPECT_EQ(a.samples, b.samples);
    EXPECT_EQ(a.provenance, b.provenance);
    EXPECT_EQ(a.scene, b.scene);
    EXPECT_EQ(a.ledger, b.ledger);
    ASSERT_EQ(a.channels.size(), b.channels.size());
    for (const auto& channel : a.channels) {
        const auto other = b.find(channel.name);
        EXPECT_TRUE(std::equal(channel.values.begin(), channel.values.end(), other.begin(), other.end()))
            << channel.name;
    }
}

}  // namespace loom::testing
