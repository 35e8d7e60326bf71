#include "formats/image.h"

#include <OpenEXR/ImfChannelList.h>
#include <OpenEXR/ImfFrameBuffer.h>
#include <OpenEXR/ImfHeader.h>
#include <OpenEXR/ImfOutputFile.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <cmath>
#include <limits>

#include "stages/merge/merge.h"
#include "tests/formats/tiny_graph.h"
#include "tests/formats/tiny_image.h"

namespace loom {
namespace {

using testing::expect_equal;
using testing::file_bytes;
using testing::input_error_of;
using testing::ScratchFolder;
using testing::tiny_image;
using testing::tiny_residual;
using testing::tiny_sum;
using testing::write_bytes;
using testing::write_nonfinite;

TEST(Image, ReadsBackBitForBit) {
    const ScratchFolder folder;
    for (const Compression compression : {Compression::none, Compression::zip}) {
        write_image(tiny_image(), folder / "x.exr", compression);
        expect_equal(tiny_image(), read_image(folder / "x.exr"));
    }
    EXPECT_EQ(folder.n_partial(), 0);
}

TEST(Image, EqualImagesGiveEqualBytes) {
    const ScratchFolder folder;
    write_image(tiny_image(), folder / "a.exr");
    write_png(tiny_image(), folder / "a.png");
    ::sleep(1);  // a clock in the file would show
    write_image(tiny_image(), folder / "b.exr");
    write_png(tiny_image(), folder / "b.png");
    EXPECT_EQ(file_bytes(folder / "a.exr"), file_bytes(folder / "b.exr"));
    EXPECT_EQ(file_bytes(folder / "a.png"), file_bytes(folder / "b.png"));
}

TEST(Image, FixtureOfVersion_1_0_Reads) {
    expect_equal(tiny_image(), read_image("tests/fixtures/image_1.0.exr"));
}

TEST(Image, SceneAndLedgerReadBackAlsoFromVersion_1_1) {
    const ScratchFolder folder;
    write_image(tiny_sum(), folder / "x.exr");
    expect_equal(tiny_sum(), read_image(folder / "x.exr"));
    expect_equal(tiny_sum(), read_image("tests/fixtures/image_1.1.exr"));
}

TEST(Image, PartsOfAResidualReadBackAlsoFromVersion_1_2) {
    const ScratchFolder folder;
    write_image(tiny_residual(), folder / "x.exr");
    expect_equal(tiny_residual(), read_image(folder / "x.exr"));
    expect_equal(tiny_residual(), read_image("tests/fixtures/image_1.2.exr"));
}

TEST(Image, DamagedLedgersSayWhatIsWrong) {
    const std::string text = ledger_text(tiny_sum().ledger);
    const auto message = [&](const std::string& from, const std::string& to) {
        std::string damaged = text;
        const auto at = damaged.find(from);
        if (at == std::string::npos) return "no such text: " + from;
        damaged.replace(at, from.size(), to);
        return input_error_of([&] { ledger_from_text(damaged, "x.exr"); });
    };
    EXPECT_TRUE(message("[", "{").starts_with("x.exr: ledger:")) << message("[", "{");
    EXPECT_EQ(message("\"var_sample\"", "\"var_simple\""),
              "x.exr: ledger: \"var_sample\" is missing or of another type");
    EXPECT_EQ(message("\"samples\": 64", "\"samples\": \"64\""),
              "x.exr: ledger: \"samples\" is missing or of another type");
    EXPECT_EQ(message("\"samples\": 64", "\"samples\": -64"),
              "x.exr: ledger: \"samples\" is -64, which is no such number");
    EXPECT_EQ(message("\"seed\": 7", "\"seed\": 18446744073709551616"),
              "x.exr: ledger: \"seed\" is 1.8446744073709552e+19, which is no such number");
    EXPECT_EQ(input_error_of([] { ledger_from_text("7", "x.exr"); }), "x.exr: ledger: is not a list");
    // A member of a later minor version is left alone.
    EXPECT_EQ(message("\"what\":", "\"why\": 3, \"what\":"), "nothing was thrown");
}

TEST(Image, LedgersAddUp) {
    const Ledger ledger = tiny_sum().ledger;
    EXPECT_DOUBLE_EQ(accumulated_var_mean(ledger, 2), 0.25 + 1.0 / 3);
    EXPECT_DOUBLE_EQ(worth_samples(ledger, 1), 64);
    EXPECT_DOUBLE_EQ(worth_samples(ledger, 2), 16 / (0.25 + 1.0 / 3));  // the second does not store its scene's
    EXPECT_DOUBLE_EQ(worth_samples(ledger, 3), 2 / (0.25 + 1.0 / 3));
    EXPECT_EQ(worth_samples({ledger[2]}, 1), 0);  // a residual alone
    LedgerLink a = ledger[0], b = ledger[1];
    b.seed = a.seed;
    EXPECT_FALSE(share_numbers(a, b));  // random streams of loom-trace and of loom-residual
    b.method = differences_method;
    EXPECT_TRUE(share_numbers(a, b));
    a.method = "correlated";
    b.method = "dynamic";
    EXPECT_TRUE(share_numbers(a, b));
    b.seed = 8;
    EXPECT_FALSE(share_numbers(a, b));
}

TEST(Image, MeanVarianceLeavesOutWhatIsNotFinite) {
    Image image;
    image.width = 2;
    image.height = 1;
    EXPECT_EQ(mean_var_mean(image), 0);
    for (const char* c : {"VarMean.R", "VarMean.G", "VarMean.B"}) image.add(c)[0] = 3;
    image.add("VarMean.G")[1] = std::numeric_limits<float>::quiet_NaN();
    image.add("VarMean.B")[1] = 0.5f;
    EXPECT_DOUBLE_EQ(mean_var_mean(image), 9.5 / 6);
}

TEST(Image, ForeignHalvesAndDataWindowsRead) {
    const ScratchFolder folder;
    Imf::Header header(Imath::Box2i({0, 0}, {9, 9}), Imath::Box2i({-2, 3}, {0, 4}));
    std::vector<half> values{half(0.0f), half(1.0f), half(2.0f), half(3.0f), half(4.0f), half(5.0f)};
    Imf::FrameBuffer frame;
    for (const char* name : {"R", "G", "B"}) {
        header.channels().insert(name, Imf::Channel(Imf::HALF));
        frame.insert(name, Imf::Slice::Make(Imf::HALF, values.data(), header.dataWindow(), 2, 6));
    }
    {
        Imf::OutputFile file((folder / "h.exr").c_str(), header);
        file.setFrameBuffer(frame);
        file.writePixels(2);
    }
    const Image image = read_image(folder / "h.exr");
    EXPECT_EQ(image.width, 3u);
    EXPECT_EQ(image.height, 2u);
    EXPECT_EQ(image.samples, 0u);
    for (std::size_t i = 0; i < 6; ++i) EXPECT_EQ(image.find("G")[i], static_cast<float>(i));
}

TEST(Image, BadFilesSayWhatIsWrong) {
    const ScratchFolder folder;
    const auto file = folder / "x.exr";
    const auto message = [&] { return input_error_of([&] { read_image(file); }); };
    EXPECT_EQ(message(), file.native() + ": no such file");
    write_bytes(file, "no picture");
    EXPECT_TRUE(message().starts_with(file.native() + ": is not a whole EXR file")) << message();
    {
        Imf::Header header(2, 1);
        header.channels().insert("Y", Imf::Channel(Imf::FLOAT));
        std::array<float, 2> values{};
        Imf::FrameBuffer frame;
        frame.insert("Y", Imf::Slice(Imf::FLOAT, reinterpret_cast<char*>(values.data()), 4, 8));
        Imf::OutputFile out(file.c_str(), header);
        out.setFrameBuffer(frame);
        out.writePixels(1);
    }
    EXPECT_EQ(message(), file.native() + ": there is no channel R (it has Y)");
    EXPECT_EQ(read_any_exr(file).find("Y").size(), 2u);
    std::filesystem::remove(file);
    std::filesystem::create_directory(file);
    EXPECT_EQ(message(), file.native() + ": is a directory, not a file");
}

TEST(Image, TruncatedAnywhere) {
    const ScratchFolder folder;
    for (const Compression compression : {Compression::none, Compression::zip}) {
        write_image(tiny_image(), folder / "x.exr", compression);
        const std::string whole = file_bytes(folder / "x.exr");
        for (std::size_t n = 0; n < whole.size(); n += 7) {
            write_bytes(folder / "x.exr", std::string_view(whole).substr(0, n));
            EXPECT_NE(input_error_of([&] { read_image(folder / "x.exr"); }), "nothing was thrown") << n;
        }
    }
}

TEST(Image, NanAndInfinityAreCounted) {
    const ScratchFolder folder;
    Image image = tiny_image();
    image.add("R")[0] = std::numeric_limits<float>::quiet_NaN();
    image.add("G")[0] = std::numeric_limits<float>::infinity();
    image.add("B")[3] = -std::numeric_limits<float>::infinity();
    EXPECT_EQ(count_nonfinite(image), 3u);
    EXPECT_EQ(write_png(image, folder / "x.png"), 2u);
    write_nonfinite(folder / "x.exr", [&] { write_image(image, folder / "x.exr"); });
    EXPECT_EQ(count_nonfinite(read_image(folder / "x.exr")), 3u);
}

// All samples at once against the same samples in three unequal parts; would catch n in place of n - 1
// anywhere, and a spread between parts that is left out.
TEST(Merge, MomentsAreThoseOfAllSamples) {
    const std::vector<double> samples{0.5, 3.0, -1.0, 7.0, 0.25, 2.0, 11.0, 0.0, 4.5};
    const auto image_of = [&](std::size_t begin, std::size_t end) {
        Image image;
        image.width = image.height = 1;
        image.samples = end - begin;
        double mean = 0, squares = 0;
        const auto n = static_cast<double>(end - begin);
        for (std::size_t i = begin; i < end; ++i) mean += samples[i] / n;
        for (std::size_t i = begin; i < end; ++i) squares += (samples[i] - mean) * (samples[i] - mean);
        for (const char* name : {"R", "G", "B"}) {
            image.add(name)[0] = static_cast<float>(mean);
            image.add(std::string("VarMean.") + name)[0] = n > 1 ? static_cast<float>(squares / (n - 1) / n) : 0.0f;
        }
        image.add("Depth.Z")[0] = static_cast<float>(mean);
        return image;
    };
    const std::array<Image, 3> parts{image_of(0, 1), image_of(1, 5), image_of(5, 9)};
    const std::array<std::string, 3> names{"a", "b", "c"};
    const Image whole = image_of(0, samples.size()), merged = merge::merge_images(parts, names);
    EXPECT_EQ(merged.samples, 9u);
    for (const auto& channel : whole.channels) {
        EXPECT_NEAR(merged.find(channel.name)[0], channel.values[0], 2e-7 * std::fabs(channel.values[0]))
            << channel.name;
    }
}

TEST(Merge, RefusesWhatDoesNotFit) {
    std::array<Image, 2> parts{tiny_image(), tiny_image()};
    const std::array<std::string, 2> names{"a.exr", "b.exr"};
    const auto message = [&] { return input_error_of([&] { merge::merge_images(parts, names); }); };
    parts[1].samples = 0;
    EXPECT_EQ(message(), "b.exr: has no number of samples per pixel (attribute samples), which weighs the parts");
    parts[1] = tiny_image();
    parts[1].channels.pop_back();
    EXPECT_EQ(message(), "b.exr: has no channel " + tiny_image().channels.back().name + ", but a.exr has");
    parts[1] = tiny_image();
    parts[1].width = 2;
    parts[1].height = 6;
    EXPECT_EQ(message(), "b.exr: is 2 x 6, but a.exr is 4 x 3");
}

}  // namespace
}  // namespace loom
