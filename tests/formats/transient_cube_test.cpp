// Transient cubes: written by rows and read again; merged with exact moments, unlike ones refused.
#include "formats/transient_cube.h"

#include <gtest/gtest.h>

#include <filesystem>
#include <random>

#include "formats/io/error.h"
#include "stages/core/app/report.h"
#include "stages/inspect/inspect.h"
#include "stages/merge/merge.h"

namespace loom {
namespace {

namespace fs = std::filesystem;

class TransientCubes : public testing::Test {
  protected:
    void SetUp() override {
        std::string name = (fs::temp_directory_path() / "loom-XXXXXX").string();
        ASSERT_NE(mkdtemp(name.data()), nullptr);
        folder = name;
    }
    void TearDown() override { fs::remove_all(folder); }

    static TransientCubeHeader header(std::uint64_t samples) {
        TransientCubeHeader h;
        h.film = {3, 2, samples};
        h.time = {4, 1.5, 0.25, 0.25, "opl", 1, 1};
        h.provenance.stage = "loom-test";
        return h;
    }
    /// The cube of samples [first, end) of every pixel and bin.
    static void write(const fs::path& file, const std::vector<std::vector<float>>& samples, std::size_t first,
                      std::size_t end, const TransientCubeHeader& h) {
        const std::size_t n = samples[0].size(), n_pixels = 3 * 6;
        std::vector<float> mean(n), var(n), pixels(n_pixels);
        for (std::size_t i = 0; i < n; ++i) {
            double sum = 0, squares = 0;
            for (std::size_t s = first; s < end; ++s) sum += samples[s][i];
            const double m = sum / double(end - first);
            for (std::size_t s = first; s < end; ++s) squares += (samples[s][i] - m) * (samples[s][i] - m);
            mean[i] = float(m);
            var[i] = end - first > 1 ? float(squares / double(end - first - 1) / double(end - first)) : 0.0f;
        }
        for (std::size_t i = 0; i < n_pixels; ++i) pixels[i] = mean[i];
        TransientCubeWriter writer(file, h);
        const std::span<const float> m(mean), v(var), p(pixels);
        for (std::uint32_t y : {1u, 0u})
            writer.write_rows(y, {m.subspan(y * n / 2, n / 2), v.subspan(y * n / 2, n / 2), p.subspan(y * 9, 9),
                                  p.subspan(y * 9, 9), p.subspan(y * 9, 9), p.subspan(y * 9, 9)});
        writer.commit(Sync::no);
    }
    static std::vector<std::vector<float>> random_samples(std::size_t n) {
        std::mt19937 random(5);
        std::exponential_distribution<float> value(3);
        std::vector<std::vector<float>> samples(n, std::vector<float>(6 * 4 * 3));
        for (auto& sample : samples)
            for (float& x : sample) x = random() % 3 == 0 ? value(random) : 0;
        return samples;
    }
    void merge(const std::vector<std::string>& names, const std::string& output) {
        merge::Options options;
        for (const std::string& name : names) options.parts.push_back(folder / name);
        options.output = folder / output;
        app::Report report;
        report.set_quiet(true);
        merge::run(options, report);
    }
    std::string refusal(const std::vector<std::string>& names) {
        try {
            merge(names, "refused.h5");
        } catch (const InputError& error) {
            EXPECT_FALSE(fs::exists(folder / "refused.h5"));
            return error.what();
        }
        return "nothing";
    }
    fs::path folder;
};

// Detected mutation: n instead of n - 1 for the variance inside a part.
TEST_F(TransientCubes, MergedPartsAreTheCubeOfAllSamples) {
    const auto samples = random_samples(9);
    write(folder / "all.h5", samples, 0, 9, header(9));
    write(folder / "a.h5", samples, 0, 5, header(5));
    write(folder / "b.h5", samples, 5, 8, header(3));
    write(folder / "c.h5", samples, 8, 9, header(1));
    merge({"a.h5", "b.h5", "c.h5"}, "merged.h5");
    const TransientCube all = read_transient_cube(folder / "all.h5"),
                        merged = read_transient_cube(folder / "merged.h5");
    EXPECT_EQ(merged.film.samples_per_pixel, 9u);
    EXPECT_EQ(merged.time.start_opl, 1.5);
    EXPECT_EQ(merged.provenance.inputs.size(), 3u);
    ASSERT_EQ(merged.radiance.size(), all.radiance.size());
    for (std::size_t i = 0; i < all.radiance.size(); ++i) {
        EXPECT_NEAR(merged.radiance[i], all.radiance[i], 3e-7f * all.radiance[i]);
        EXPECT_NEAR(merged.var_mean[i], all.var_mean[i], 1e-6f * all.var_mean[i]);
    }
    for (const auto field :
         {&TransientCube::before, &TransientCube::after, &TransientCube::never, &TransientCube::steady})
        for (std::size_t i = 0; i < 18; ++i) EXPECT_NEAR((merged.*field)[i], (all.*field)[i], 3e-7f * (all.*field)[i]);
}

TEST_F(TransientCubes, UnlikePartsAreRefused) {
    const auto samples = random_samples(4);
    write(folder / "a.h5", samples, 0, 2, header(2));
    write(folder / "same.h5", samples, 0, 2, header(2));
    EXPECT_NE(refusal({"a.h5", "same.h5"}).find("same.h5: holds the same samples as"), std::string::npos);
    TransientCubeHeader h = header(2);
    h.time.start_opl = 1.5000001;
    write(folder / "window.h5", samples, 2, 4, h);
    EXPECT_NE(refusal({"a.h5", "window.h5"}).find("has bins of 0.25 m (gate 0.25) from 1.5000001, not of"),
              std::string::npos);
    h = header(2);
    h.response.pulse = "box";
    h.response.length_opl = 0.5;
    write(folder / "pulse.h5", samples, 2, 4, h);
    EXPECT_NE(refusal({"a.h5", "pulse.h5"}).find("has a box pulse (length 0.5"), std::string::npos);
    h = header(2);
    h.time.camera_segment = 0;
    write(folder / "unwarped.h5", samples, 2, 4, h);
    EXPECT_NE(refusal({"a.h5", "unwarped.h5"}).find("from the first hit, not from the camera"), std::string::npos);
    h = header(0);
    write(folder / "none.h5", samples, 2, 4, h);
    EXPECT_NE(refusal({"none.h5", "a.h5"}).find("has no number of samples"), std::string::npos);
    h = header(2);
    h.film.width = 2, h.film.height = 3;
    EXPECT_EQ(difference_in_words(h, header(2)), "is 2 x 3 pixels, not 3 x 2");
    // Labels make no difference, nor does less than the slack.
    h = header(2);
    h.time.unit = "ns";
    h.time.start_opl += 0.02;
    EXPECT_EQ(difference_in_words(h, header(2), 0.1), "");
    EXPECT_NE(difference_in_words(h, header(2), 0.01), "");
}

TEST_F(TransientCubes, InspectSaysWhereTheLightIs) {
    TransientCubeHeader h = header(4);
    h.response.pulse = "box";
    h.response.length_opl = 0.5;
    std::vector<float> mean(6 * 4 * 3), var(mean.size()), none(18), after(18, 0.25f), steady(18, 1.0f);
    // Pixel 2:1, bin 3 has all the light but what comes after.
    for (std::size_t c = 0; c < 3; ++c) mean[3 * (5 * 4 + 3) + c] = 6 * 0.75f;
    for (std::size_t c = 0; c < 3; ++c) var[3 * (5 * 4 + 3) + c] = 0.09f * 0.09f;
    TransientCubeWriter writer(folder / "cube.h5", h);
    const std::span<const float> m(mean), v(var), n(none), a(after), s(steady);
    for (std::uint32_t y : {0u, 1u})
        writer.write_rows(y, {m.subspan(y * 36, 36), v.subspan(y * 36, 36), n.subspan(y * 9, 9), a.subspan(y * 9, 9),
                              n.subspan(y * 9, 9), s.subspan(y * 9, 9)});
    writer.commit(Sync::no);
    const std::string file = folder / "cube.h5", text = inspect::text_of(survey_file(file), file);
    EXPECT_NE(text.find("3 x 2 pixels of 4 samples; 4 bins of 0.25 m from 1.5 to 2.5, counted from the camera\npulse: "
                        "box, length 0.5 m\n"),
              std::string::npos)
        << text;
    EXPECT_NE(text.find("(mean luminance), of it 75 % in the bins, 0 % before, 25 % after, 0 % never\n"),
              std::string::npos)
        << text;
    EXPECT_NE(text.find("brightest bin: 4.5 at pixel 2:1, bin 3 (2.25 m); half of the light by 2.5 m; standard error "
                        "of the sum 2 %\n"),
              std::string::npos)
        << text;
    EXPECT_NE(inspect::json_of(survey_file(file), file).find("\"share_inside\": 0.75"), std::string::npos);
}

}  // namespace
}  // namespace loom
