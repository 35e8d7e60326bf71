// loom-frames of the images of an animation.
#include <gtest/gtest.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>

#include "formats/image.h"
#include "formats/io/error.h"
#include "stages/core/app/report.h"
#include "stages/frames/frames.h"

namespace loom {
namespace {

namespace fs = std::filesystem;

class FramesOfImages : public ::testing::Test {
  protected:
    void SetUp() override { fs::create_directories(folder_); }
    void TearDown() override { fs::remove_all(folder_); }
    std::string at(const std::string& name) const { return (folder_ / name).string(); }
    /// Writes an image of 6 x 4 pixels, `value` everywhere but one black pixel.
    std::string write(const std::string& name, float value, std::uint32_t width = 6) const {
        Image image;
        image.width = width;
        image.height = 4;
        std::vector<float> rgb(3 * image.n_pixels(), value);
        rgb[0] = rgb[1] = rgb[2] = 0;
        image.set_layer("", "RGB", rgb);
        write_image(image, at(name));
        return at(name);
    }
    void run(frames::Options options) {
        options.output = at("strip.png");
        app::Report report;
        report.set_quiet(true);
        frames::run(options, report);
    }
    std::string error_of(const frames::Options& options) {
        try {
            run(options);
        } catch (const InputError& e) {
            return e.what();
        }
        return "";
    }
    /// Width and height of a PNG.
    std::pair<int, int> size_of(const std::string& name) const {
        std::ifstream in(at(name), std::ios::binary);
        std::array<unsigned char, 24> head{};
        in.read(reinterpret_cast<char*>(head.data()), head.size());
        return {head[18] * 256 + head[19], head[22] * 256 + head[23]};
    }
    std::string bytes_of(const std::string& name) const {
        std::ifstream in(at(name), std::ios::binary);
        return {std::istreambuf_iterator<char>(in), {}};
    }

  private:
    fs::path folder_ = fs::temp_directory_path() / ("loom-images-" + std::to_string(getpid()));
};

TEST_F(FramesOfImages, HaveOneExposure) {
    frames::Options options;
    options.cube = write("a.exr", 0.5f);
    options.images = {write("b.exr", 0.5f), write("c.exr", 1), write("d.exr", 0.5f), write("e.exr", 0)};
    options.png = true;
    options.count = 5;
    run(options);
    // Three columns of two rows.
    EXPECT_EQ(size_of("strip.png"), std::pair(18, 8));
    EXPECT_EQ(size_of("frames/frame-0004.png"), std::pair(6, 4));
    EXPECT_FALSE(fs::exists(at("frames/frame-0005.png")));
    // White is that of most: brighter ones are cut off, dark ones stay dark.
    EXPECT_EQ(bytes_of("frames/frame-0000.png"), bytes_of("frames/frame-0002.png"));
    EXPECT_NE(bytes_of("frames/frame-0000.png"), bytes_of("frames/frame-0004.png"));
    // Fewer in the strip; single frames of an earlier run go.
    options.images.resize(2);
    options.count = 2;
    run(options);
    EXPECT_EQ(size_of("strip.png"), std::pair(12, 4));
    EXPECT_FALSE(fs::exists(at("frames/frame-0003.png")));
}

TEST_F(FramesOfImages, MustFitTogether) {
    frames::Options options;
    options.cube = write("a.exr", 1);
    options.images = {write("b.exr", 1, 5)};
    EXPECT_NE(error_of(options).find("b.exr: 5 x 4 pixels, but the first image has 6 x 4"), std::string::npos);
    options.images.clear();
    options.row = 1;
    EXPECT_NE(error_of(options).find("for cubes, not for images"), std::string::npos);
    options.row.reset();
    EXPECT_EQ(error_of(options), "");
    EXPECT_EQ(size_of("strip.png"), std::pair(6, 4));
}

}  // namespace
}  // namespace loom
