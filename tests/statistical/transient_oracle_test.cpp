// The transient Cornell box against mitransient: pooled bins, bins of the whole image, sums of pixels, tiles and total;
// and the test detects light in wrong bins.
#include <gtest/gtest.h>

#include <cstdio>

#include "formats/transient_cube.h"
#include "stages/compare/pools.h"
#include "stages/compare/significance.h"
#include "stages/transient/transient.h"
#include "tests/statistical/support.h"
#include "tests/traced_graph.h"

namespace loom {
namespace {

using compare::Pooling;

/// Means over replicates, and what single ones sum up to.
struct Cube {
    std::vector<double> mean, var_mean;    // [y, x, bin, rgb]
    std::vector<std::vector<float>> sums;  // of each replicate [y, x, rgb]
    double samples = 0;
    int replicates = 0;

    void add(const PathGraph& graph, const TimeResponse& response, const Timing& timing) {
        app::Report report;
        report.set_quiet(true);
        app::Progress progress(report, "binning", graph.n_pixels());
        sums.emplace_back();
        transient::bin_graphs({&graph, 1}, {}, {}, response, timing, std::uint64_t(1) << 32, 0, progress,
                              [&](std::uint32_t, const TransientRows& rows) {
                                  mean.resize(rows.radiance.size()), var_mean.resize(mean.size());
                                  sums.back().resize(mean.size() / response.n_bins);
                                  for (std::size_t i = 0; i < mean.size(); ++i) {
                                      mean[i] += rows.radiance[i], var_mean[i] += rows.var_mean[i];
                                      sums.back()[i / (3 * response.n_bins) * 3 + i % 3] += rows.radiance[i];
                                  }
                              });
        ++replicates;
        samples += double(graph.tracing.samples_per_pixel);
    }
    compare::PoolTests pools(const TransientCube& reference, Pooling pooling, double brighter = 1) const {
        std::vector<float> m(mean.size()), v(mean.size());
        for (std::size_t i = 0; i < m.size(); ++i) {
            m[i] = float(brighter * mean[i] / replicates);
            v[i] = float(brighter * brighter * var_mean[i] / replicates / replicates);
        }
        return compare::test_pools({m, v, samples},
                                   {reference.radiance, reference.var_mean, double(reference.film.samples_per_pixel)},
                                   reference.film.width, reference.film.height, reference.time.n_bins, pooling, 0.05);
    }
};

std::vector<float> sums_of(std::span<const float> bins, std::size_t n_bins) {
    std::vector<float> sums(bins.size() / n_bins);
    for (std::size_t i = 0; i < bins.size(); ++i) sums[i / (3 * n_bins) * 3 + i % 3] += bins[i];
    return sums;
}

void print(const char* name, const compare::PoolTests& tests) {
    std::printf("    %-22s %-18s n %5zu, mean z %+.3f, rms z %.3f, worst z %+.2f in bin %zu, p %.2g\n", name,
                tests.name.c_str(), tests.n, tests.mean_z, tests.rms_z, tests.worst_z, tests.worst_bin, tests.p);
}

// 4096 independent samples (in the full run 32768) against 262144 of mitransient. Detected mutations, each below: the
// camera's segment left out, a bin late, or a hundredth of the light too much. 1 % moves the mean z of bins of the
// image by 0.84, whose standard error is 0.06 at most: its bound of 0.15 accepts 0.2 %, and not much more.
TEST(TransientOracle, CornellBoxInTime) {
    const auto shared = shared_dir();
    if (shared.empty()) GTEST_SKIP() << "the folder of references (../shared/oracles) is not there";
    const TransientCube reference = read_any_cube(shared / "oracles/transient/cornell_box_ref.h5");
    const auto scene = load_scene(shared / "oracles/transient/cornell_box.xml");

    // mitransient counts from the near plane, 0.001 / cos from the camera; 0.00102 in the mean over the image.
    TimeResponse right;
    right.n_bins = reference.time.n_bins;
    right.start = reference.time.start_opl + 0.00102;
    right.width = right.gate = reference.time.bin_width_opl;
    TimeResponse late = right;
    late.start += right.width;
    Cube ours, unwarped, a_bin_late;
    const int replicates = full_run() ? 64 : 16;
    for (int i = 0; i < replicates; ++i) {
        const PathGraph graph =
            testing::trace_graph(*scene, testing::path_options(*scene, std::uint64_t(100 + i)), full_run() ? 512 : 256);
        ours.add(graph, right, {});
        if (i >= 4) continue;
        unwarped.add(graph, right, {false});
        a_bin_late.add(graph, late, {});
    }

    for (const Pooling pooling : {Pooling::pixels, Pooling::image}) {
        const compare::PoolTests tests = ours.pools(reference, pooling);
        print("ours", tests);
        EXPECT_GT(tests.n, 500u);
        EXPECT_GT(tests.p, 1e-3);
        EXPECT_NEAR(tests.mean_z, 0, 0.15);
        EXPECT_NEAR(tests.rms_z, 1, 0.06);
    }
    const std::vector<float> sums = sums_of(reference.radiance, reference.time.n_bins),
                             var_sums = sums_of(reference.var_mean, reference.time.n_bins);
    const double p_pixels =
        compare::test_pixels(ours.sums, {}, ours.samples, sums, var_sums, double(reference.film.samples_per_pixel));
    const compare::Significance regions =
        compare::test_means({ours.sums, {}}, sums, var_sums, reference.film.width, reference.film.height);
    for (std::size_t c = 0; c < 3; ++c)
        std::printf("    channel %zu: total %+.3f +- %.3f of %.2f\n", c,
                    regions.tests[c][0].difference * reference.film.width * reference.film.height,
                    regions.tests[c][0].se * reference.film.width * reference.film.height,
                    1024 * compare::regions_of(sums, 32, 32).mean(c, 0));
    EXPECT_GT(p_pixels, 1e-3);
    EXPECT_GT(regions.p_image, 1e-3);
    EXPECT_GT(regions.p_tiles, 1e-3);

    // Power: what a quarter of the samples shows of light in wrong bins, and all of them of a hundredth too much.
    for (const Pooling pooling : {Pooling::pixels, Pooling::image}) {
        for (const auto& [name, cube] : {std::pair{"without camera segment", &unwarped}, {"a bin late", &a_bin_late}}) {
            const compare::PoolTests tests = cube->pools(reference, pooling);
            print(name, tests);
            EXPECT_LT(tests.p, 1e-10) << name;
        }
    }
    const compare::PoolTests brighter = ours.pools(reference, Pooling::image, 1.01);
    print("1 % too bright", brighter);
    EXPECT_GT(brighter.mean_z, 0.5);
}

}  // namespace
}  // namespace loom
