// Texture look-ups against values of Mitsuba 3.8.0 (scalar_rgb, format "variant") and against the slow,
// obvious definition.

#include "stages/core/assets/texture.h"

#include <OpenImageIO/imageio.h>
#include <fmt/format.h>

#include <cmath>

#include "stages/core/description/spectrum.h"
#include "tests/unit/scene_folder.h"

namespace loom {
namespace {

class TextureFile : public SceneFolder {
  protected:
    /// Writes an 8-bit or float image; returns its path.
    template <class T>
    std::filesystem::path image(const std::string& name, int w, int h, int channels, const std::vector<T>& values,
                                const std::vector<std::string>& names = {}) {
        const std::filesystem::path file = path(name);
        auto out = OIIO::ImageOutput::create(file.string());
        OIIO::ImageSpec spec(w, h, channels, OIIO::BaseTypeFromC<T>::value);
        if (!names.empty()) spec.channelnames = names;
        spec.attribute("oiio:UnassociatedAlpha", 1);
        EXPECT_TRUE(out->open(file.string(), spec));
        EXPECT_TRUE(out->write_image(OIIO::BaseTypeFromC<T>::value, values.data()));
        out->close();
        return file;
    }
    /// The first pixel of an EXR file of one row of two pixels with these channels, or what is wrong with the file.
    template <class T = float>
    std::string colour_of(const std::vector<std::string>& names, const std::vector<T>& values) {
        std::vector<T> row = values;
        row.insert(row.end(), values.begin(), values.end());
        const auto file = image<T>(fmt::format("colour-{}.exr", ++n_files_), 2, 1, int(names.size()), row, names);
        std::string colour;
        const std::string error = error_of([&] {
            const Spectrum c = cache_.image(file, {})->texel(1, 0);
            colour = fmt::format("{:.3g} {:.3g} {:.3g}", c.r, c.g, c.b);
        });
        return colour.empty() ? error : colour;
    }
    std::shared_ptr<const TextureImage> grey_ramp() {
        std::vector<float> v;
        for (int i = 0; i < 5 * 3; ++i) v.push_back(float((i * 7) % 15));
        return cache_.image(image("ramp.exr", 5, 3, 1, v), {});
    }
    TextureCache cache_;
    int n_files_ = 0;
};

int wrap_slowly(int i, int n, WrapMode mode) {
    if (mode == WrapMode::clamp) return i < 0 ? 0 : i >= n ? n - 1 : i;
    const int period = mode == WrapMode::mirror ? 2 * n : n;
    const int r = ((i % period) + period) % period;
    return r < n ? r : 2 * n - 1 - r;
}

float bilinear_slowly(const TextureImage& image, double u, double v, WrapMode mode) {
    const double x = u * image.width - 0.5, y = v * image.height - 0.5;
    const int ix = int(std::floor(x)), iy = int(std::floor(y));
    double sum = 0;
    for (int dy = 0; dy < 2; ++dy)
        for (int dx = 0; dx < 2; ++dx) {
            const double wx = dx ? x - ix : 1 - (x - ix), wy = dy ? y - iy : 1 - (y - iy);
            sum +=
                wx * wy *
                double(
                    image.texel(wrap_slowly(ix + dx, image.width, mode), wrap_slowly(iy + dy, image.height, mode)).r);
        }
    return float(sum);
}

TEST_F(TextureFile, FastLookUpEqualsTheObviousOne) {
    Texture t;
    t.image = grey_ramp();
    for (const WrapMode mode : {WrapMode::repeat, WrapMode::mirror, WrapMode::clamp}) {
        t.wrap = mode;
        for (int i = -80; i <= 80; ++i)
            for (int j = -40; j <= 40; ++j) {
                const float u = float(i) * 0.0371f, v = float(j) * 0.0673f;
                t.nearest = false;
                EXPECT_NEAR(t.eval({u, v}).r, bilinear_slowly(*t.image, u, v, mode), 2e-5) << u << " " << v;
                t.nearest = true;
                const int x = wrap_slowly(int(std::floor(double(u) * 5)), 5, mode),
                          y = wrap_slowly(int(std::floor(double(v) * 3)), 3, mode);
                EXPECT_EQ(t.eval_float({u, v}), t.image->texel(x, y).r) << u << " " << v;
            }
    }
}

TEST_F(TextureFile, NothingOutsideTheImageIsRead) {
    Texture t;
    t.image = grey_ramp();
    for (const WrapMode mode : {WrapMode::repeat, WrapMode::mirror, WrapMode::clamp})
        for (const bool nearest : {false, true})
            for (const float u : {-INFINITY, -1e30f, -1e-9f, 0.0f, 0x1.fffffep-1f, 1.0f, 2.0f, 1e30f, INFINITY, NAN}) {
                t.wrap = mode;
                t.nearest = nearest;
                EXPECT_TRUE(std::isfinite(t.eval({u, 0.5f}).r));
                EXPECT_TRUE(std::isfinite(t.eval({0.5f, u}).r));
            }
}

TEST_F(TextureFile, GradientIsThatOfTheInterpolant) {
    Texture t;
    t.image = grey_ramp();
    // A rotation with a non-square image is where the order of the scalings matters.
    t.to_uv = {0.8f, -0.6f, 0.1f, 0.6f, 0.8f, -0.3f};
    const float h = 1e-3f;
    for (const Point2f uv : {Point2f{0.31f, 0.2f}, Point2f{0.77f, 0.42f}, Point2f{-0.4f, 0.93f}}) {
        const Point2f g = t.eval_gradient(uv);
        EXPECT_NEAR(g.x, (t.eval_float({uv.x + h, uv.y}) - t.eval_float({uv.x - h, uv.y})) / (2 * h), 0.05);
        EXPECT_NEAR(g.y, (t.eval_float({uv.x, uv.y + h}) - t.eval_float({uv.x, uv.y - h})) / (2 * h), 0.05);
    }
    t.nearest = true;
    EXPECT_EQ(t.eval_gradient({0.3f, 0.2f}).x, 0);
}

TEST_F(TextureFile, EightBitDecoding) {
    const std::vector<std::uint8_t> rgba{255, 128, 0, 10, 0, 0, 0, 0, 64, 64, 64, 255, 1, 2, 3, 4};
    const auto file = image("c.png", 2, 2, 4, rgba);
    const auto srgb = cache_.image(file, {});
    EXPECT_FALSE(srgb->grey);
    // Alpha neither multiplies nor shows.
    EXPECT_EQ(srgb->texel(0, 0), Spectrum(1, linear_from_srgb(128.0f / 255.0f), 0));
    EXPECT_EQ(cache_.image(file, {true, 0})->texel(0, 1), Spectrum(64.0f / 255.0f));
    EXPECT_FLOAT_EQ(cache_.image(file, {false, 2.0f})->texel(0, 1).r, sqr(64.0f / 255.0f));
    EXPECT_FLOAT_EQ(srgb->mean.r, (1 + linear_from_srgb(64.0f / 255.0f) + linear_from_srgb(1.0f / 255.0f)) / 4);
    EXPECT_EQ(cache_.image(file, {}), srgb);  // decoded once
    const std::vector<std::uint8_t> grey_alpha{100, 7, 200, 9};
    const auto grey = cache_.image(image("g.png", 2, 1, 2, grey_alpha), {true, 0});
    EXPECT_TRUE(grey->grey);
    EXPECT_EQ(grey->texel(1, 0), Spectrum(200.0f / 255.0f));
}

TEST_F(TextureFile, SixteenBitIsSrgbAndFloatLinear) {
    const auto png = cache_.image(image<std::uint16_t>("c.png", 1, 1, 1, {32768}), {});
    EXPECT_NEAR(png->texel(0, 0).r, linear_from_srgb(32768.0f / 65535.0f), 1e-6);
    const auto exr = cache_.image(image<float>("c.exr", 1, 1, 3, {0.5f, 2.0f, -1.0f}), {});
    EXPECT_EQ(exr->texel(0, 0), Spectrum(0.5f, 2.0f, -1.0f));
    const auto nan = image<float>("n.exr", 1, 1, 1, {NAN});
    EXPECT_NE(error_of([&] { cache_.image(nan, {}); }).find("n.exr: pixel (0, 0) is not finite"), std::string::npos);
    EXPECT_EQ(error_of([&] { cache_.image(path("none.png"), {}); }), "none.png: no such file");
}

// Detected mutations: channels by position (9 0.2 0.5), and R and G alone as grey.
TEST_F(TextureFile, ChannelsOfExrFilesGoByName) {
    EXPECT_EQ(colour_of({"Z", "color.R", "color.G", "color.B"}, {9, 0.2f, 0.5f, 0.8f}), "0.2 0.5 0.8");
    EXPECT_EQ(colour_of({"B", "G", "R", "A", "depth.Z", "N.X"}, {0.8f, 0.5f, 0.2f, 0.1f, 9, 7}), "0.2 0.5 0.8");
    EXPECT_EQ(colour_of({"diffuse.R", "diffuse.G", "diffuse.B", "R", "G", "B"}, {3, 4, 5, 0.2f, 0.5f, 0.8f}),
              "0.2 0.5 0.8");
    EXPECT_EQ(colour_of({"N.X", "N.Y", "N.Z", "main.Combined.B", "main.Combined.G", "main.Combined.R"},
                        {7, 8, 9, 0.8f, 0.5f, 0.2f}),
              "0.2 0.5 0.8");
    EXPECT_EQ(colour_of({"A", "Y"}, {0.1f, 0.4f}), "0.4 0.4 0.4");
    EXPECT_EQ(colour_of({"Y", "Z"}, {0.4f, 9}), "0.4 0.4 0.4");
    EXPECT_EQ(colour_of({"height"}, {0.4f}), "0.4 0.4 0.4");
    // Y = 0.2126 0.2 + 0.7152 0.5 + 0.0722 0.8, RY = R / Y - 1, BY = B / Y - 1.
    EXPECT_EQ(colour_of({"BY", "RY", "Y"}, {0.8f / 0.45788f - 1, 0.2f / 0.45788f - 1, 0.45788f}), "0.2 0.5 0.8");
    // Numbers stay numbers, for any type.
    EXPECT_EQ(colour_of<std::uint32_t>({"R", "G", "B"}, {0, 1, 3}), "0 1 3");
}

TEST_F(TextureFile, ExrFilesWithoutOneColourAreErrorsThatNameTheirChannels) {
    EXPECT_EQ(colour_of({"R", "G"}, {0.2f, 0.5f}),
              "colour-1.exr: no colour among its channels: R, G; a colour has R, G, B or Y");
    EXPECT_EQ(colour_of({"Z"}, {9}), "colour-2.exr: no colour among its channels: Z; a colour has R, G, B or Y");
    EXPECT_EQ(colour_of({"Depth.Z"}, {9}),
              "colour-3.exr: no colour among its channels: Depth.Z; a colour has R, G, B or Y");
    EXPECT_EQ(colour_of({"N.X", "N.Y", "N.Z"}, {7, 8, 9}),
              "colour-4.exr: no colour among its channels: N.X, N.Y, N.Z; a colour has R, G, B or Y");
    const std::string two = colour_of({"diffuse.R", "diffuse.G", "diffuse.B", "gloss.R", "gloss.G", "gloss.B"},
                                      {3, 4, 5, 0.2f, 0.5f, 0.8f});
    EXPECT_EQ(two,
              "colour-5.exr: several layers hold a colour: diffuse, gloss; keep one of them, or name "
              "its channels R, G, B");
}

// A part of a file is chosen as a layer is, and a data window is the texture, with a note.
TEST_F(TextureFile, PartsAndWindowsOfExrFiles) {
    std::vector<OIIO::ImageSpec> parts{{2, 1, 1, OIIO::TypeDesc::FLOAT}, {2, 1, 3, OIIO::TypeDesc::HALF}};
    parts[0].channelnames = {"Z"};
    parts[1].channelnames = {"R", "G", "B"};
    for (OIIO::ImageSpec& part : parts) part.full_width = 8;  // EXR files have one display window
    parts[1].x = 5;
    const std::vector<std::vector<float>> values{{9, 9}, {0.25f, 0.5f, 0.75f, 0.25f, 0.5f, 0.75f}};
    auto out = OIIO::ImageOutput::create(path("parts.exr").string());
    for (int i = 0; i < 2; ++i) {
        parts[std::size_t(i)].attribute("oiio:subimagename", i == 0 ? "depth" : "beauty");
        ASSERT_TRUE(i == 0 ? out->open(path("parts.exr").string(), 2, parts.data())
                           : out->open(path("parts.exr").string(), parts[1], OIIO::ImageOutput::AppendSubimage))
            << out->geterror();
        ASSERT_TRUE(out->write_image(OIIO::TypeDesc::FLOAT, values[std::size_t(i)].data()));
    }
    out->close();
    const auto in = cache_.image(path("parts.exr"), {});
    EXPECT_EQ(in->texel(1, 0), Spectrum(0.25f, 0.5f, 0.75f));
    ASSERT_EQ(cache_.notes().size(), 1u);
    EXPECT_NE(cache_.notes()[0].find("the stored pixels (2 x 1 at (5, 0)), not the display window (8 x 1 at (0, 0))"),
              std::string::npos)
        << cache_.notes()[0];
}

TEST_F(TextureFile, DescriptionsBecomeTextures) {
    image<std::uint8_t>("c.png", 1, 1, 1, {51});
    const auto scene = read(R"(<texture type="checkerboard"><rgb name="color0" value="1, 0, 0"/>
            <transform name="to_uv"><scale x="5" y="2"/><translate x=".1"/></transform></texture>
        <texture type="bitmap" id="b"><string name="filename" value="c.png"/><boolean name="raw" value="true"/>
            <string name="filter_type" value="nearest"/><string name="wrap_mode" value="mirror"/></texture>)");
    const auto objects = scene.root->children(Category::texture);
    const Texture board = make_texture(*objects[0], cache_);
    EXPECT_EQ(board.kind, TextureKind::checkerboard);
    EXPECT_EQ(board.eval({0.0f, 0.1f}), Spectrum(1, 0, 0));  // (0.1, 0.2)
    EXPECT_EQ(board.eval({0.1f, 0.1f}), Spectrum(0.2f));     // (0.6, 0.2): color1 by default
    EXPECT_EQ(board.eval({0.1f, 0.4f}), Spectrum(1, 0, 0));  // (0.6, 0.8)
    EXPECT_FLOAT_EQ(board.mean().r, 0.6f);
    EXPECT_EQ(board.eval_gradient({0.1f, 0.1f}).x, 0);
    const Texture bitmap = make_texture(*objects[1], cache_);
    EXPECT_TRUE(bitmap.nearest);
    EXPECT_EQ(bitmap.wrap, WrapMode::mirror);
    EXPECT_EQ(bitmap.id, "b");
    EXPECT_FLOAT_EQ(bitmap.eval_float({3, 4}), 0.2f);
}

// Values of Mitsuba at (0.31, 0.22) and (0.02, 0.02), (0.52, 0.33).
TEST(SharedTextures, AgreeWithMitsuba) {
    const std::filesystem::path folder =
        std::filesystem::path(LOOM_SOURCE_DIR) / "../shared/oracles/render/common/textures";
    if (!std::filesystem::exists(folder)) GTEST_SKIP() << "no shared scenes beside the repository";
    TextureCache cache;
    Texture museum, carrot, leaf;
    museum.image = cache.image(folder / "museum.exr", {});
    carrot.image = cache.image(folder / "carrot.png", {});
    leaf.image = cache.image(folder / "leaf_mask.png", {});
    const Spectrum m = museum.eval({0.31f, 0.22f});
    EXPECT_NEAR(m.r, 0.214024, 1e-5);
    EXPECT_NEAR(m.g, 0.100419, 1e-5);
    EXPECT_NEAR(m.b, 0.0432397, 1e-5);
    EXPECT_NEAR(museum.eval_float({0.31f, 0.22f}), 0.120453, 1e-5);
    EXPECT_NEAR(museum.eval_gradient({0.31f, 0.22f}).x, -0.282885, 1e-4);
    EXPECT_NEAR(museum.eval_gradient({0.31f, 0.22f}).y, -0.538829, 1e-4);
    EXPECT_NEAR(luminance(museum.mean()), 0.330651, 1e-5);
    EXPECT_NEAR(carrot.eval({0.02f, 0.02f}).r, 0.930111, 1e-5);
    EXPECT_NEAR(carrot.eval({0.52f, 0.33f}).r, 0.512, 1e-5);
    EXPECT_NEAR(carrot.eval({0.52f, 0.33f}).g, 0.163096, 1e-5);
    EXPECT_NEAR(carrot.eval({0.52f, 0.33f}).b, 0, 1e-5);
    EXPECT_TRUE(leaf.image->grey);
    EXPECT_NEAR(leaf.mean().r, 0.443935, 1e-5);
}

}  // namespace
}  // namespace loom
