// The 15 derivative images of Mitsuba: public thresholds, image mean and tile means of the derivative summed over all
// times.
#include <fmt/format.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>
#include <fstream>
#include <map>
#include <sstream>

#include "formats/image.h"
#include "stages/compare/significance.h"
#include "tests/statistical/derivative_support.h"
#include "tests/statistical/support.h"

namespace loom {
namespace {

struct Case {
    const char* name;
    const char* wrt;
    std::uint64_t spp;                 // of each replicate
    std::vector<BoundarySet> parts{};  // boundaries that matter
    bool is_noisy = false;             // public thresholds need the samples of the full run
    double radiance = 0;               // not 0: compared with value / radiance, see below
    std::size_t parameter = 0;
    double scale = 1;             // our unit in units of theta
    bool touches_border = false;  // the largest error is not judged, see below
    bool is_smooth = false;       // the reference's noise is that between its neighbouring pixels
};

// Where theta is the radiance of all light, the derivative is the value by the radiance. These references are
// differences of values that were rounded to half floats: .977 where the derivative is 1. Only their public thresholds
// are used; mean and tiles are those of the value.
// The rims of two spheres touch the borders of pixels: within the step of the reference they cross them, and its
// derivative is shared between two pixels that differ by 6 to 20 standard errors from ours. Their sum does not.
const Case cases[] = {
    {"diffuse_albedo", "shape:plane/bsdf/reflectance", 4, {}, true},
    {"diffuse_albedo_g_i", "shape:green/bsdf/reflectance", 4, {}, true},
    {"area_light_radiance", "shape:light/radiance", 4, {}, true},
    {"directly_visible_area_light_radiance", "shape:light/radiance", 2, {}, true, 1},
    {"point_light_intensity", "emitter:light/radiance", 4, {}, false, 5},
    {"constant_emitter_radiance", "emitter:light/radiance", 4, {}, true, 1},
    {"rotate_shading_normals_plane", "shape:plane/normals", 4, {}, false, 0, 1, pi_double / 180, false, true},
    {"translate_textured_plane", "theta", 16, {}, true},
    {"translate_diffuse_rectangle_constant", "theta", 4, {primary_edges}},
    {"translate_diffuse_sphere_constant", "theta", 4, {primary_edges}, true, 0, 0, 1, true},
    {"translate_rectangle_emitter_on_black", "theta", 4, {primary_edges}},
    {"translate_sphere_emitter_on_black", "theta", 4, {primary_edges}},
    {"scale_sphere_emitter_on_black", "shape:light/scale", 4, {primary_edges}, false, 0, 0, 1, true},
    {"translate_occluder_area_light", "theta", 2, {direct_edges}},
    {"translate_shadow_receiver_area_light", "theta", 4, {primary_edges}},
};

struct Thresholds {
    double step = 0, mean = 0, max = 0;
};

Thresholds thresholds_of(const std::filesystem::path& folder, const std::string& name) {
    std::ifstream in(folder / "derivatives.tsv");
    for (std::string line; std::getline(in, line);) {
        std::vector<std::string> cells;
        std::istringstream text(line);
        for (std::string cell; std::getline(text, cell, '\t');) cells.push_back(cell);
        if (cells.size() >= 7 && cells[0] == name)
            return {std::stod(cells[4]), std::stod(cells[5]), std::stod(cells[6])};
    }
    ADD_FAILURE() << name << " is missing in derivatives.tsv";
    return {};
}

/// Replicates of a derivative image.
struct Images {
    std::vector<std::vector<float>> replicates;  // [y, x, rgb]
    std::vector<double> mean, var_mean;

    void finish() {
        const double n = double(replicates.size());
        mean.assign(replicates[0].size(), 0), var_mean = mean;
        for (std::size_t i = 0; i < mean.size(); ++i) {
            double squares = 0;
            for (const auto& r : replicates) mean[i] += double(r[i]) / n;
            for (const auto& r : replicates) squares += sqr(double(r[i]) - mean[i]);
            var_mean[i] = squares / (n - 1) / n;
        }
    }
};

struct Judged {
    double mean_error = 0, max_error = 0;  // public measure
    double z = 0;                          // of the image mean, the channel with the largest
    double se = 0, reference_mean = 0;     // of that channel
    double p_tiles = 1;
};

/// Variances of the pixels of a reference, which no file stores. A difference of step h changes a share 2 h |D| / J of
/// the samples by J / (2 h), where D is the derivative and J the light that jumps, here the largest value of the image.
/// What does not jump has the variance of our own samples.
///   var = |D| J / (2 h n) + var_sample / n,  n = 12000
std::vector<float> reference_variance(std::span<const float> reference, double jump, double step,
                                      const Images& interior, double spp) {
    constexpr double n = 12000;
    std::vector<float> var(reference.size());
    for (std::size_t i = 0; i < var.size(); ++i)
        var[i] = float(std::abs(double(reference[i])) * jump / (2 * step * n) + interior.var_mean[i] * spp / n);
    return var;
}

/// The same of a smooth image, from what pixels differ from the mean of their four neighbours, over squares of 16 x 16.
/// Where normals turn, the reference's BSDF samples turn with them, and jump over the border of the light: it has more than
/// ten times the variance of our samples.
std::vector<float> variance_of_smooth(std::span<const float> image, std::size_t width, std::size_t height) {
    constexpr std::size_t side = 16;
    std::vector<float> var(image.size());
    for (std::size_t i = 0; i < image.size(); ++i) {
        const std::size_t x0 = i / 3 % width / side * side, y0 = i / 3 / width / side * side;
        double sum = 0;
        int n = 0;
        for (std::size_t y = std::max<std::size_t>(y0, 1); y < std::min(y0 + side, height - 1); ++y)
            for (std::size_t x = std::max<std::size_t>(x0, 1); x < std::min(x0 + side, width - 1); ++x, ++n) {
                const auto at = [&](std::size_t px, std::size_t py) {
                    return double(image[3 * (py * width + px) + i % 3]);
                };
                const double around = (at(x - 1, y) + at(x + 1, y) + at(x, y - 1) + at(x, y + 1)) / 4;
                sum += sqr(at(x, y) - around) / (1 + 1.0 / 4);
            }
        var[i] = float(sum / n);
    }
    return var;
}

Judged judge(const Images& ours, std::span<const float> reference, std::span<const float> var_reference,
             std::size_t width, std::size_t height) {
    Judged j;
    const std::size_t n = reference.size();
    for (std::size_t i = 0; i < n; ++i) {
        const double d = ours.mean[i] - double(reference[i]);
        const double error = std::abs(d) / std::max(std::abs(double(reference[i])), 0.2);
        j.mean_error += error / double(n), j.max_error = std::max(j.max_error, error);
    }
    const compare::Significance s = compare::test_means({ours.replicates, {}}, reference, var_reference, width, height);
    j.p_tiles = s.p_tiles;
    for (std::size_t c = 0; c < 3; ++c) {
        const auto& image = s.tests[c][0];
        const double z = image.difference == 0 ? 0 : image.difference / image.se;
        if (c > 0 && !(std::abs(z) > std::abs(j.z))) continue;
        j.z = z, j.se = image.se;
        j.reference_mean = compare::regions_of(reference, width, height).mean(c, 0);
    }
    return j;
}

void print(const std::string& name, const Judged& j, const Thresholds& limit) {
    std::printf(
        "    %-40s mean %+.6f, z %+6.2f of SE %.6f; p of tiles %.2g; error mean %.4f of %.3f, max %.3f of %.2f\n",
        name.c_str(), j.reference_mean, j.z, j.se, j.p_tiles, j.mean_error, limit.mean, j.max_error, limit.max);
}

// Standard errors of the means are 0.02 to 3 % of the derivative. Detected mutations, each below: boundaries left out,
// of one kind or all.
class DerivativeOracle : public ::testing::TestWithParam<Case> {};

TEST_P(DerivativeOracle, SumOverTimesAgrees) {
    const auto shared = shared_dir();
    if (shared.empty()) GTEST_SKIP() << "the folder of references (../shared/oracles) is not there";
    const auto folder = shared / "oracles" / "derivative";
    const Case& c = GetParam();
    const DerivableScene scene(folder / (std::string(c.name) + ".xml"), {c.wrt});
    const Thresholds limit = thresholds_of(folder, c.name);
    const std::vector<float> given = read_image(folder / "refs" / (std::string(c.name) + "_fwd.exr")).interleaved("");
    const std::vector<float> value =
        read_image(folder / "refs" / (std::string(c.name) + "_primal.exr")).interleaved("");
    const std::size_t width = scene.scene->sensor.width, height = scene.scene->sensor.height;
    ASSERT_EQ(given.size(), 3 * width * height);

    TimeResponse response;
    response.n_bins = 1, response.start = 0, response.width = response.gate = 1e3;
    Images ours, interior;
    std::map<BoundarySet, Images> without;
    std::array<double, n_boundary_families> share{};
    const int replicates = 16;
    const std::uint64_t spp = c.spp * (full_run() ? 16 : 1);
    for (int i = 0; i < replicates; ++i) {
        const PathGraph graph = trace_derivable(*scene.scene, spp, std::uint64_t(100 + i));
        const Derivative derivative = differentiate(graph, scene, std::uint64_t(500 + i));
        const DerivedBins bins = bins_of(graph, &derivative, response, c.parameter);
        const auto scaled = [&](const std::vector<double>& image) {
            std::vector<float> out;
            for (const double x : image) out.push_back(float(c.scale * x));
            return out;
        };
        ours.replicates.push_back(scaled(bins.steady));
        interior.replicates.push_back(scaled(bins.steady_without(all_edges)));
        for (int f = 0; f < n_boundary_families; ++f)
            for (const double x : bins.steady_boundary[std::size_t(f)])
                share[std::size_t(f)] += c.scale * x / replicates / double(given.size());
        for (const BoundarySet f : c.parts) without[f].replicates.push_back(scaled(bins.steady_without(f)));
    }
    ours.finish(), interior.finish();
    const double jump = *std::max_element(value.begin(), value.end());
    const std::vector<float> var_given = c.is_smooth ? variance_of_smooth(given, width, height)
                                                     : reference_variance(given, c.parts.empty() ? 0 : jump, limit.step,
                                                                          interior, double(replicates * spp));
    const Judged against_given = judge(ours, given, var_given, width, height);
    Judged j = against_given;
    if (c.radiance > 0) {
        std::vector<float> by_radiance = value, var = var_given;
        for (std::size_t i = 0; i < value.size(); ++i) {
            by_radiance[i] /= float(c.radiance);
            var[i] = float(double(var[i]) + sqr(double(by_radiance[i]) * 0x1p-11) / 12);  // half floats
        }
        j = judge(ours, by_radiance, var, width, height);
    }
    print(c.name, j, limit);
    std::printf("        boundary by family %+.5f %+.5f %+.5f %+.5f\n", share[0], share[1], share[2], share[3]);
    if (!c.is_noisy || full_run()) {
        if (!c.touches_border) {
            EXPECT_LE(j.max_error, limit.max);
        }
        EXPECT_LE(against_given.mean_error, limit.mean);
    }
    EXPECT_LE(std::abs(j.z), 3);
    EXPECT_GT(j.p_tiles, 1e-3);

    for (auto& [part, images] : without) {
        images.finish();
        const Judged less = judge(images, given, var_given, width, height);
        print(fmt::format("  without {}", name_of(part)), less, limit);
        EXPECT_TRUE(std::abs(less.z) > 10 || less.p_tiles < 1e-10);
    }
    if (!c.parts.empty()) {
        const Judged less = judge(interior, given, var_given, width, height);
        print("  interior alone", less, limit);
        EXPECT_TRUE(std::abs(less.z) > 10 || less.p_tiles < 1e-10);
    }
}

INSTANTIATE_TEST_SUITE_P(Mitsuba, DerivativeOracle, ::testing::ValuesIn(cases),
                         [](const auto& c) { return test_name(c.param.name); });

}  // namespace
}  // namespace loom
