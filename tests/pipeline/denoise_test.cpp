// loom-denoise on an image of loom-trace, as a user runs it.

#include <cmath>

#include "formats/image.h"
#include "formats/io/cost.h"
#include "tests/pipeline/process.h"

namespace loom::pipeline {
namespace {

class Denoise : public PipelineTest {
  protected:
    std::string in(const std::string& name) const { return (folder / name).string(); }
    void trace(const std::string& name, int spp) const {
        const Outcome traced = sh(stage("trace") + " scenes/cornell-box.xml -D resx=48 -D resy=40 --spp " +
                                  std::to_string(spp) + " -o " + in(name));
        ASSERT_EQ(traced.code, 0) << traced.err;
    }
};

TEST_F(Denoise, leaves_picture_layers_preview_and_cost) {
    trace("noisy.exr", 8);
    const Outcome outcome = sh(stage("denoise") + " " + in("noisy.exr") + " --method filter -o " + in("clean.exr") +
                               " --png " + in("clean.png") + " --exposure 1");
    EXPECT_EQ(outcome.code, 0) << outcome.err;
    EXPECT_NE(outcome.err.find("by the built-in filter"), std::string::npos) << outcome.err;
    EXPECT_TRUE(fs::exists(folder / "clean.png"));
    EXPECT_EQ(read_cost(folder / "clean.exr").parents, std::vector<std::string>{"noisy.exr"});

    const Image noisy = read_image(folder / "noisy.exr"), clean = read_image(folder / "clean.exr");
    EXPECT_EQ(clean.samples, 8u);
    EXPECT_EQ(clean.provenance.stage, "loom-denoise");
    EXPECT_EQ(clean.provenance.inputs.at(0).name, "noisy.exr");
    EXPECT_EQ(clean.provenance.plan,
              "on: built-in filter, VarMean, albedo, normal, depth; off: Open Image Denoise (not requested)");
    EXPECT_EQ(count_nonfinite(clean), 0u);
    double difference = 0;
    for (const auto& channel : noisy.channels) {
        const auto values = clean.find(channel.name);
        // The variance of the noisy means is no longer true.
        EXPECT_EQ(values.empty(), channel.name.starts_with("VarMean.")) << channel.name;
        if (values.empty()) continue;
        const bool same = std::equal(values.begin(), values.end(), channel.values.begin());
        EXPECT_EQ(same, channel.name.size() > 1) << channel.name;
        for (std::size_t i = 0; channel.name.size() == 1 && i < values.size(); ++i)
            difference += std::abs(double(values[i]) - double(channel.values[i]));
    }
    EXPECT_GT(difference, 0);
}

TEST_F(Denoise, outputs_do_not_depend_on_threads) {
    trace("noisy.exr", 4);
    std::vector<std::string> methods = {"filter"};
    if (sh(stage("denoise") + " " + in("noisy.exr") + " --method oidn --plan").code == 0) methods.push_back("oidn");
    for (const std::string& method : methods) {
        for (const char* threads : {"1", "2"}) {
            const Outcome outcome = sh(stage("denoise") + " " + in("noisy.exr") + " --method " + method +
                                       " --threads " + threads + " -o " + in(method + threads + ".exr"));
            EXPECT_EQ(outcome.code, 0) << outcome.err;
        }
        EXPECT_TRUE(bytes_of(folder / (method + "1.exr")) == bytes_of(folder / (method + "2.exr"))) << method;
    }
    if (methods.size() == 1) GTEST_SKIP() << "no Open Image Denoise (`make oidn` fetches it)";
}

TEST_F(Denoise, plan_says_what_is_missing_and_writes_nothing) {
    trace("one.exr", 1);
    Image bare = read_image(folder / "one.exr");
    std::erase_if(bare.channels, [](const auto& channel) { return channel.name.size() > 1; });
    bare.samples = 16;
    bare.channels[0].values[5] = NAN;
    EXPECT_THROW(write_image(bare, folder / "bare.exr"), NonfiniteError);
    fs::rename(not_finite_name(folder / "bare.exr"), folder / "bare.exr");
    const std::vector<std::string> before = files();
    const Outcome one = sh(stage("denoise") + " " + in("one.exr") + " --method filter --plan");
    EXPECT_EQ(one.out,
              "on: built-in filter, variance from neighbours, albedo, normal, depth; "
              "off: Open Image Denoise (not requested), VarMean (one sample has none)\n");
    const Outcome nothing = sh(stage("denoise") + " " + in("bare.exr") + " --method filter --plan");
    EXPECT_EQ(nothing.out,
              "on: built-in filter, variance from neighbours; off: Open Image Denoise (not requested), VarMean "
              "(not in the image), albedo (not in the image), normal (not in the image), depth (not in the "
              "image)\n");
    EXPECT_EQ(files(), before);
    const Outcome mended = sh(stage("denoise") + " " + in("bare.exr") + " --method filter -o " + in("clean.exr"));
    EXPECT_EQ(mended.code, 0);
    EXPECT_NE(mended.err.find("1 pixels were not finite"), std::string::npos) << mended.err;
    EXPECT_EQ(count_nonfinite(read_image(folder / "clean.exr")), 0u);
}

}  // namespace
}  // namespace loom::pipeline
