// Derivatives of every bin against central differences of mitransient, for four parameters of one scene.
//
// A central difference is the mean of the derivative over its interval: ours is averaged over that interval too. With
// the derivative at its middle alone, pixels at the border of a moving shadow differ by 100 standard errors: there the
// step reaches light that the derivative does not.
#include <fmt/format.h>
#include <gtest/gtest.h>

#include <cmath>
#include <cstdio>

#include "formats/io/hdf5_handle.h"
#include "stages/compare/pools.h"
#include "stages/compare/significance.h"
#include "stages/transient/transient.h"
#include "tests/statistical/derivative_support.h"
#include "tests/statistical/support.h"

namespace loom {
namespace {

// Box pulse and bins of this many fine bins of the reference: a bin weighs the light by a triangle, which has no jumps.
constexpr std::size_t n_pulse = 8;

/// One derivative cube [y, x, pooled bin, rgb]; the channels are equal.
struct Cube {
    std::vector<float> mean, var;
    double samples = 0;
};

std::vector<double> read_array(const std::filesystem::path& file, const char* name) {
    start_hdf5();
    const Hdf5Handle h5 = open_hdf5(file);
    const Hdf5Handle set(H5Dopen2(h5.get(), name, H5P_DEFAULT), H5Dclose), space(H5Dget_space(set.get()), H5Sclose);
    std::vector<double> values(std::size_t(H5Sget_simple_extent_npoints(space.get())));
    EXPECT_GE(H5Dread(set.get(), H5T_NATIVE_DOUBLE, H5S_ALL, H5S_ALL, H5P_DEFAULT, values.data()), 0);
    return values;
}

/// Sums tiles of block x block pixels of one channel, stored as three of which only the first is not 0.
std::vector<float> tiled(const std::vector<double>& bins, std::size_t width, std::size_t n_bins, std::size_t channels,
                         std::size_t block) {
    const std::size_t n = width / block;
    std::vector<double> sum(n * n * n_bins * 3);
    for (std::size_t p = 0; p < width * width; ++p)
        for (std::size_t k = 0; k < n_bins; ++k)
            sum[((p / width / block * n + p % width / block) * n_bins + k) * 3] += bins[(p * n_bins + k) * channels];
    return {sum.begin(), sum.end()};
}

struct Weighed {
    std::vector<double> mean, var;  // [pixel, bin]
};

/// Weighs fine bins of a reference by the triangles of a response. Where the light of a fine bin lies in it is not
/// known: its weight has a variance of its own, which matters at first arrivals only.
Weighed weighed(const std::vector<double>& mean, const std::vector<double>& var, const TimeResponse& fine,
                const TimeResponse& response) {
    const std::size_t n_pixels = mean.size() / fine.n_bins, n = response.n_bins;
    Weighed out{std::vector<double>(n_pixels * n), std::vector<double>(n_pixels * n)};
    for (std::size_t j = 0; j < fine.n_bins; ++j) {
        const double middle = fine.start + (double(j) + 0.5) * fine.width, spread = fine.width / std::sqrt(12.0);
        for (std::size_t k = 0; k < n; ++k) {
            const auto weight = [&](double t) { return response.weight(std::int64_t(k), t); };
            const double w = weight(middle), change = 0.5 * (weight(middle + spread) - weight(middle - spread));
            if (w == 0 && change == 0) continue;
            for (std::size_t p = 0; p < n_pixels; ++p) {
                const double x = mean[p * fine.n_bins + j];
                out.mean[p * n + k] += w * x;
                out.var[p * n + k] += w * w * var[p * fine.n_bins + j] + sqr(change * x);
            }
        }
    }
    return out;
}

struct Ours {
    std::vector<double> mean, var;         // [pixel, bin, rgb]
    std::vector<std::vector<float>> sums;  // of each replicate [pixel, rgb]; the first channel
    std::array<std::vector<double>, n_boundary_families> boundary;
    int replicates = 0;
    std::size_t n_bins = 0, width = 0, block = 1;
    double samples = 0;

    void add(const DerivedBins& bins, double spp) {
        const auto accumulate = [](std::vector<double>& to, const std::vector<double>& from) {
            to.resize(from.size());
            for (std::size_t i = 0; i < to.size(); ++i) to[i] += from[i];
        };
        n_bins = bins.n_bins;
        accumulate(mean, bins.derivative), accumulate(var, bins.var_mean);
        for (std::size_t f = 0; f < boundary.size(); ++f) accumulate(boundary[f], bins.boundary[f]);
        sums.emplace_back(3 * bins.n_pixels);
        for (std::size_t i = 0; i < bins.steady.size(); i += 3) sums.back()[i] = float(bins.steady[i]);
        ++replicates, samples += spp;
    }
    /// in:      boundaries  taken by a factor
    Cube cube(BoundarySet boundaries = 0, double factor = 0) const {
        std::vector<double> m = mean, v = var;
        for (std::size_t f = 0; f < n_boundary_families; ++f)
            if (boundaries >> f & 1)
                for (std::size_t i = 0; i < m.size(); ++i) m[i] -= (1 - factor) * boundary[f][i];
        for (double& x : m) x /= replicates;
        for (double& x : v) x /= sqr(double(replicates));
        return {tiled(m, width, n_bins, 3, block), tiled(v, width, n_bins, 3, block), samples};
    }
};

void print(const std::string& name, const compare::PoolTests& t) {
    std::printf("    %-28s %-18s n %5zu, mean z %+.3f, rms z %.3f, worst z %+7.2f at %zu:%zu bin %zu, p %.2g\n",
                name.c_str(), t.name.c_str(), t.n, t.mean_z, t.rms_z, t.worst_z, t.worst_x, t.worst_y, t.worst_bin,
                t.p);
}

struct Case {
    const char* name;
    double step;                     // of the reference
    std::vector<BoundarySet> parts;  // that matter
    bool detects_tenth = true;       // whether a tenth of them lost is detected
};

// Detected mutations: the eye's velocity without its factor 1 - s; no cosine at the camera in the shadow edges.
// 8192 samples per pixel in tiles of 4 x 4 pixels, in the full run 262144 in tiles of 2 x 2. Detected mutations, each
// below: a family left out, or all of them. Nine tenths of the primary edges (camera_x, occluder_x: z of 8 and 22) and
// of the shadow edges (z of 8 to 15) are detected as well.
class TransientDerivative : public ::testing::TestWithParam<Case> {};

TEST_P(TransientDerivative, BinsAgreeWithMitransient) {
    const auto shared = shared_dir();
    if (shared.empty()) GTEST_SKIP() << "the folder of references (../shared/oracles) is not there";
    const auto folder = shared / "oracles" / "transient_derivative";
    const std::string name = GetParam().name;
    const auto scene = load_scene(folder / "shadow.xml");
    const TimeResponse fine = film_response(*scene);
    TimeResponse response = fine;
    response.n_bins = fine.n_bins / n_pulse;
    response.width = response.gate = fine.width * double(n_pulse);
    response.pulse = Pulse::box(response.width);
    const std::size_t n_bins = response.n_bins, width = scene->sensor.width, block = full_run() ? 2 : 4,
                      n_tiles = width / block;
    const auto file = folder / (name + "_ref.h5");
    const std::vector<double> mean = read_array(file, "derivative"), var = read_array(file, "derivative_var_mean");
    ASSERT_EQ(mean.size(), width * width * fine.n_bins);
    const Weighed all_weighed = weighed(mean, var, fine, response);
    Cube reference{tiled(all_weighed.mean, width, n_bins, 1, block), tiled(all_weighed.var, width, n_bins, 1, block),
                   5242880};
    // Bins far below the largest of their tile have too few of our samples to know their noise.
    for (std::size_t tile = 0; tile < n_tiles * n_tiles; ++tile) {
        float largest = 0;
        for (std::size_t k = 0; k < n_bins; ++k)
            largest = std::max(largest, std::abs(reference.mean[(tile * n_bins + k) * 3]));
        for (std::size_t k = 0; k < n_bins; ++k) reference.var[(tile * n_bins + k) * 3] += sqr(1e-3f * largest);
    }

    Ours ours;
    ours.width = width, ours.block = block;
    const int replicates = full_run() ? 64 : 16;
    const std::uint64_t spp = full_run() ? 4096 : 512;
    for (int i = 0; i < replicates; ++i) {
        const DerivableScene at(folder / "shadow.xml", {name},
                                {{name, fmt::format("{:.10g}", GetParam().step * place_in(i, replicates))}});
        const PathGraph graph = trace_derivable(*at.scene, spp, std::uint64_t(100 + i));
        const Derivative derivative = differentiate(graph, at, std::uint64_t(500 + i));
        ours.add(bins_of(graph, &derivative, response), double(spp));
    }

    const auto pools = [&](const Cube& cube, compare::Pooling pooling) {
        return compare::test_pools({cube.mean, cube.var, cube.samples},
                                   {reference.mean, reference.var, reference.samples}, n_tiles, n_tiles, n_bins,
                                   pooling, 0.1, compare::Estimators::different);
    };
    const Cube all = ours.cube();
    for (const auto pooling : {compare::Pooling::pixels, compare::Pooling::image}) {
        const compare::PoolTests t = pools(all, pooling);
        print(name, t);
        EXPECT_GT(t.p, 1e-3);
        EXPECT_LT(t.rms_z, 1.15);
    }
    std::vector<float> sums(3 * width * width), var_sums(sums.size());
    for (std::size_t i = 0; i < mean.size(); ++i)
        sums[i / fine.n_bins * 3] += float(mean[i]), var_sums[i / fine.n_bins * 3] += float(var[i]);
    const double p_pixels = compare::test_pixels(ours.sums, {}, ours.samples, sums, var_sums, reference.samples,
                                                 compare::Estimators::different);
    const compare::Significance regions = compare::test_means({ours.sums, {}}, sums, var_sums, width, width);
    const auto& image = regions.tests[0][0];
    std::printf("    %-28s sums: p of pixels %.2g, p of tiles %.2g; mean %+.6f +- %.6f of %+.6f\n", name.c_str(),
                p_pixels, regions.p_tiles, image.difference, image.se,
                compare::regions_of(sums, width, width).mean(0, 0));
    EXPECT_GT(p_pixels, 1e-3);
    EXPECT_GT(regions.p_tiles, 1e-3);
    EXPECT_LT(std::abs(image.difference), 3 * image.se);

    std::vector<BoundarySet> left_out = GetParam().parts;
    left_out.push_back(all_edges);
    for (const BoundarySet part : left_out)
        for (const double factor : {0.0, 0.9}) {
            const std::string what = fmt::format("{:.0f} % of {}", 100 * factor, name_of(part));
            double p = 1;
            for (const auto pooling : {compare::Pooling::pixels, compare::Pooling::image}) {
                const compare::PoolTests t = pools(ours.cube(part, factor), pooling);
                print("  " + what, t);
                p = std::min(p, t.p);
            }
            if (factor == 0 || GetParam().detects_tenth) {
                EXPECT_LT(p, factor == 0 ? 1e-10 : 1e-3) << what;
            }
        }
}

INSTANTIATE_TEST_SUITE_P(Shadow, TransientDerivative,
                         ::testing::Values(Case{"occluder_x", 0.02, {primary_edges, direct_edges}},
                                           Case{"light_x", 0.02, {direct_edges}},
                                           Case{"floor_z", 0.01, {direct_edges}, false},
                                           Case{"camera_x", 0.01, {primary_edges, direct_edges}}),
                         [](const auto& c) { return test_name(c.param.name); });

}  // namespace
}  // namespace loom
