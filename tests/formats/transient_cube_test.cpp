// Transient cubes: written by rows and read again; merged with exact moments, unlike ones refused.
#include "formats/transient_cube.h"

#include <gtest/gtest.h>
#include <hdf5.h>

#include <filesystem>
#include <random>

#include "formats/io/error.h"
#include "formats/io/hdf5_handle.h"
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

// Detected mutations: twice the quotient; the variance of one pair as if its cubes were independent.
TEST_F(TransientCubes, QuotientsAreDifferencesOverTheStep) {
    const auto samples = random_samples(8);
    for (const auto& [name, first, seed] :
         {std::tuple{"high-0.h5", 0, 1}, {"low-0.h5", 2, 1}, {"high-1.h5", 4, 2}, {"low-1.h5", 6, 2}}) {
        TransientCubeHeader h = header(2);
        h.provenance.seed = std::uint64_t(seed);
        write(folder / name, samples, std::size_t(first), std::size_t(first) + 2, h);
    }
    const auto quotient = [&](const std::vector<std::string>& high, const std::vector<std::string>& low,
                              const std::string& step) {
        merge::Options options;
        for (const std::string& name : high) options.parts.push_back(folder / name);
        for (const std::string& name : low) options.minus.push_back(folder / name);
        options.output = folder / "quotient.h5";
        options.quotient = step;
        app::Report report;
        report.set_quiet(true);
        merge::run(options, report);
        return read_transient_cube(options.output);
    };
    const TransientCube one = quotient({"high-0.h5"}, {"low-0.h5"}, "a=b=0.5:0.75"),
                        two = quotient({"high-0.h5", "high-1.h5"}, {"low-0.h5", "low-1.h5"}, "x=-0.125:0.125");
    const TransientCube parts[] = {read_transient_cube(folder / "high-0.h5"), read_transient_cube(folder / "low-0.h5"),
                                   read_transient_cube(folder / "high-1.h5"), read_transient_cube(folder / "low-1.h5")};
    EXPECT_EQ(one.parameters.name, std::vector<std::string>{"a=b"});
    EXPECT_EQ(one.parameters.value[0], 0.625);
    EXPECT_EQ(two.parameters.value[0], 0);
    EXPECT_EQ(two.film.samples_per_pixel, 4u);
    for (std::size_t i = 0; i < one.radiance.size(); ++i) {
        const double v[] = {parts[0].radiance[i], parts[1].radiance[i], parts[2].radiance[i], parts[3].radiance[i]};
        const double d0 = (v[0] - v[1]) / 0.25, d1 = (v[2] - v[3]) / 0.25;
        EXPECT_NEAR(one.radiance[i], (v[0] + v[1]) / 2, 1e-6);
        EXPECT_NEAR(one.derivative.bins[i], d0, 1e-5);
        EXPECT_NEAR(one.derivative.var_mean[i], 2 * (parts[0].var_mean[i] + parts[1].var_mean[i]) / 0.0625, 1e-4);
        EXPECT_NEAR(two.derivative.bins[i], (d0 + d1) / 2, 1e-5);
        EXPECT_NEAR(two.derivative.var_mean[i], (d0 - d1) * (d0 - d1) / 4, 1e-4);
    }
    for (std::size_t i = 0; i < 18; ++i)
        EXPECT_NEAR(one.derivative.steady[i], (parts[0].steady[i] - parts[1].steady[i]) / 0.25, 1e-5);

    const auto refused = [&](const std::vector<std::string>& high, const std::vector<std::string>& low,
                             const std::string& step) -> std::string {
        try {
            quotient(high, low, step);
        } catch (const InputError& error) {
            return error.what();
        }
        return "nothing";
    };
    EXPECT_NE(refused({"high-0.h5"}, {"low-1.h5"}, "x=0:1").find("was made with seed 2"), std::string::npos);
    EXPECT_NE(refused({"high-0.h5", "high-1.h5"}, {"low-0.h5"}, "x=0:1").find("1 cubes after --minus for 2 parts"),
              std::string::npos);
    for (const char* step : {"x", "x=1", "=0:1", "x=1:0", "x=0:nan"})
        EXPECT_NE(refused({"high-0.h5"}, {"low-0.h5"}, step).find("must be NAME=LOW:HIGH"), std::string::npos) << step;
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

class DerivativeCubes : public TransientCubes {
  protected:
    static TransientCubeHeader header(std::uint64_t samples, std::string temporal = "widened") {
        TransientCubeHeader h = TransientCubes::header(samples);
        h.parameters = {{"x", "albedo"}, {"m", "1"}, {std::move(temporal), "none"}, {0.25, 0.5}};
        return h;
    }
    /// Writes rows bottom first. Number i of derivative array a is f(a, i).
    template <class F>
    void write_cube(const std::string& name, const TransientCubeHeader& h, F f) const {
        const std::size_t n = h.n_parameters(), bins = h.row_size(), pixels = 3 * h.film.width, height = h.film.height;
        TransientCubeWriter writer(folder / name, h);
        for (std::uint32_t y = std::uint32_t(height); y-- > 0;) {
            const std::vector<float> value(bins, float(y + 1)), value_of_pixels(pixels, float(y + 2));
            std::vector<float> rows[7];
            for (std::size_t a = 0; a < 7; ++a) {
                const std::size_t row = a < 2 ? bins : pixels;
                for (std::size_t p = 0; p < n; ++p)
                    for (std::size_t i = 0; i < row; ++i) rows[a].push_back(f(a, (p * height + y) * row + i));
            }
            writer.write_rows(y, {value,
                                  value,
                                  value_of_pixels,
                                  value_of_pixels,
                                  value_of_pixels,
                                  value_of_pixels,
                                  {rows[0], rows[1], rows[2], rows[3], rows[4], rows[5], rows[6]}});
        }
        writer.commit(Sync::no);
    }
    static float number(std::size_t array, std::size_t i) { return float(1000 * (array + 1) + i); }
    static std::vector<const Column<float>*> arrays(const TransientCube& c) {
        const auto& d = c.derivative;
        return {&d.bins, &d.var_mean, &d.before, &d.after, &d.never, &d.steady, &d.steady_var_mean};
    }
    template <class Body>
    void edit(Body body) const {
        const Hdf5Handle open(H5Fopen((folder / "c.h5").c_str(), H5F_ACC_RDWR, H5P_DEFAULT), H5Fclose);
        body(open.get());
    }
    std::string complaint() const {
        try {
            read_transient_cube(folder / "c.h5");
        } catch (const InputError& error) {
            return error.what();
        }
        return "nothing";
    }
};

// Detected mutation: rows of all parameters written one after the other in the file.
TEST_F(DerivativeCubes, ReadAsWritten) {
    write_cube("c.h5", header(4), number);
    const TransientCube c = read_transient_cube(folder / "c.h5");
    EXPECT_EQ(c.parameters.name, (std::vector<std::string>{"x", "albedo"}));
    EXPECT_EQ(c.parameters.unit, (std::vector<std::string>{"m", "1"}));
    EXPECT_EQ(c.parameters.temporal, (std::vector<std::string>{"widened", "none"}));
    EXPECT_EQ(c.parameters.value[1], 0.5);
    const auto all = arrays(c);
    for (std::size_t a = 0; a < all.size(); ++a) {
        ASSERT_EQ(all[a]->size(), a < 2 ? 2u * 72 : 2u * 18);
        for (std::size_t i = 0; i < all[a]->size(); ++i) ASSERT_EQ((*all[a])[i], number(a, i)) << a << " " << i;
    }
    // One parameter in place of the radiance.
    const TransientCube one = read_any_derivative(folder / "c.h5", "albedo");
    EXPECT_EQ(one.n_parameters(), 0u);
    for (std::size_t i = 0; i < 72; ++i) {
        ASSERT_EQ(one.radiance[i], number(0, 72 + i));
        ASSERT_EQ(one.var_mean[i], number(1, 72 + i));
    }
    EXPECT_EQ(one.before[17], number(2, 35));
    EXPECT_EQ(one.steady[0], number(5, 18));
    try {
        read_any_derivative(folder / "c.h5", "y");
        FAIL();
    } catch (const InputError& error) {
        EXPECT_NE(std::string(error.what()).find("has no derivative by y, only by x, albedo"), std::string::npos);
    }
}

TEST_F(DerivativeCubes, WithoutParametersTheFileIsThatOfVersion1_0) {
    write_cube("c.h5", TransientCubes::header(4), number);
    const Hdf5Handle file = open_hdf5(folder / "c.h5");
    EXPECT_EQ(integer_attribute(file.get(), "version"), (std::vector<std::uint64_t>{1, 0}));
    EXPECT_EQ(H5Lexists(file.get(), "parameters", H5P_DEFAULT), 0);
    EXPECT_EQ(H5Lexists(file.get(), "derivative", H5P_DEFAULT), 0);
    write_cube("d.h5", header(4), number);
    EXPECT_EQ(integer_attribute(open_hdf5(folder / "d.h5").get(), "version"), (std::vector<std::uint64_t>{1, 1}));
}

TEST_F(DerivativeCubes, DamagedFilesAreRefused) {
    const auto damaged = [&](const char* dataset) {
        write_cube("c.h5", header(4), number);
        edit([&](hid_t open) { H5Ldelete(open, dataset, H5P_DEFAULT); });
        return complaint();
    };
    for (const char* dataset : {"derivative", "derivative_var_mean", "derivative_before", "derivative_after",
                                "derivative_never", "derivative_steady", "derivative_steady_var_mean"})
        EXPECT_NE(damaged(dataset).find(std::string(dataset) + ": has 0 numbers, but 2 parameters need"),
                  std::string::npos)
            << complaint();
    EXPECT_NE(damaged("parameters/unit").find("parameters: 2 names, 0 units"), std::string::npos) << complaint();
    EXPECT_NE(damaged("parameters/value").find("parameters: 2 names"), std::string::npos) << complaint();
    EXPECT_NE(damaged("parameters").find("c.h5: derivative"), std::string::npos) << complaint();
    write_cube("c.h5", header(4, "guessed"), number);
    EXPECT_NE(complaint().find("parameters/temporal: row 0 is guessed"), std::string::npos) << complaint();
    // Extents that another parameter, or another film, would have.
    for (const auto& extents : {std::vector<hsize_t>{2, 2, 3, 5, 3}, {3, 2, 3, 4, 3}, {2, 2, 3, 4}, {2, 3, 2, 4, 3}}) {
        write_cube("c.h5", header(4), number);
        edit([&](hid_t open) {
            H5Ldelete(open, "derivative", H5P_DEFAULT);
            const Hdf5Handle space(H5Screate_simple(int(extents.size()), extents.data(), nullptr), H5Sclose);
            const Hdf5Handle made(
                H5Dcreate2(open, "derivative", H5T_IEEE_F32LE, space.get(), H5P_DEFAULT, H5P_DEFAULT, H5P_DEFAULT),
                H5Dclose);
            const std::vector<float> zeros(2 * 2 * 3 * 5 * 3);
            H5Dwrite(made.get(), H5T_NATIVE_FLOAT, H5S_ALL, H5S_ALL, H5P_DEFAULT, zeros.data());
        });
        EXPECT_NE(complaint().find("c.h5: "), std::string::npos);
        EXPECT_NE(complaint().find("derivative"), std::string::npos) << complaint();
    }
}

// Parts of 3 and 1 samples. Detected mutations: rows of parameter 1 taken from parameter 0; parts weighted alike.
TEST_F(DerivativeCubes, MergedPartsAreWeightedBySamples) {
    const auto other = [](std::size_t array, std::size_t i) { return array % 5 == 1 ? 0.0f : -2 * number(array, i); };
    write_cube("a.h5", header(3, "none"), number);
    write_cube("b.h5", header(1), other);
    merge({"a.h5", "b.h5"}, "merged.h5");
    const TransientCube c = read_transient_cube(folder / "merged.h5");
    EXPECT_EQ(c.parameters.temporal, (std::vector<std::string>{"widened", "none"}));
    const auto all = arrays(c);
    for (std::size_t a = 0; a < all.size(); ++a)
        for (std::size_t i = 0; i < all[a]->size(); ++i) {
            const bool is_variance = a % 5 == 1;  // arrays 1 and 6
            const double mean_of = a == 1 ? number(0, i) : number(5, i), mean = mean_of / 4;
            // s^2 = [(n_1 - 1) n_1 v_1 + n_1 (m_1 - m)^2 + n_2 (m_2 - m)^2] / (N - 1)
            const double expected =
                is_variance
                    ? (2.0 * 3 * number(a, i) + 3 * std::pow(mean_of - mean, 2) + std::pow(-2 * mean_of - mean, 2)) /
                          3 / 4
                    : double(number(a, i)) / 4;
            ASSERT_NEAR((*all[a])[i], expected, 1e-6 * std::abs(expected)) << a << " " << i;
        }
}

TEST_F(DerivativeCubes, UnlikeParametersAreNotMerged) {
    write_cube("a.h5", header(3), number);
    TransientCubeHeader h = header(2);
    h.parameters.name[1] = "alpha";
    write_cube("name.h5", h, number);
    EXPECT_NE(refusal({"a.h5", "name.h5"}).find("name.h5: has parameter alpha in place 1, not albedo"),
              std::string::npos);
    h = header(2);
    h.parameters.unit[0] = "mm";
    write_cube("unit.h5", h, number);
    EXPECT_NE(refusal({"a.h5", "unit.h5"}).find("has parameter x in mm, not in m"), std::string::npos);
    h = header(2);
    h.parameters.value = std::vector<double>{0.25, 0.6};
    write_cube("value.h5", h, number);
    EXPECT_NE(refusal({"a.h5", "value.h5"}).find("has parameter albedo at 0.6, not at 0.5"), std::string::npos);
    write_cube("none.h5", TransientCubes::header(2), number);
    EXPECT_NE(refusal({"a.h5", "none.h5"}).find("has derivatives by 0 parameters, not by 2"), std::string::npos);
    write_cube("exact.h5", header(2, "exact"), number);
    EXPECT_NE(refusal({"a.h5", "exact.h5"}).find("derivatives by x are exact in time, those of other parts widened"),
              std::string::npos);
}

TEST_F(DerivativeCubes, InspectDescribesEachParameter) {
    write_cube("c.h5", header(4), [](std::size_t array, std::size_t i) {
        return array == 0 ? (i < 72 ? -0.5f : 0.25f) : array == 5 ? 3.0f : array == 6 ? 0.06f : 0.0f;
    });
    const std::string file = folder / "c.h5", text = inspect::text_of(survey_file(file), file);
    EXPECT_NE(text.find("derivative by x at 0.25 m: 3 +- 0.1 (mean luminance), of it -2 in the bins; sum of magnitudes "
                        "over the bins 2; moving between bins: widened\n"),
              std::string::npos)
        << text;
    EXPECT_NE(text.find("derivative by albedo at 0.5 1: 3 +- 0.1 (mean luminance), of it 1 in the bins;"),
              std::string::npos)
        << text;
    EXPECT_NE(inspect::json_of(survey_file(file), file).find("\"parameter\": \"albedo\""), std::string::npos);
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
