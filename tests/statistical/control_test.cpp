// The old image as control variate of the new one: unbiased, with the variance that it stores, and no worse than either
// a new image or old plus residual.

#include <fmt/format.h>
#include <gtest/gtest.h>
#include <tbb/parallel_for.h>

#include "stages/core/stats/chi_square.h"
#include "stages/residual/control/controlled.h"
#include "stages/residual/dynamic_estimator.h"
#include "stages/residual/residual.h"
#include "tests/statistical/image_spread.h"
#include "tests/statistical/support.h"

namespace loom::residual {
namespace {

constexpr int replicates = 32, size = 24;

struct ControlCase {
    const char* name;
    std::vector<std::string> both, edit;  // NAME=VALUE of scenes/edits.xml
    bool ordinary;
    double gain_at_least;  // variance of old plus residual over that of the controlled image, after 64 samples
};

SceneDescription description(std::vector<std::string> values) {
    for (const char* side : {"resx", "resy"}) values.push_back(fmt::format("{}={}", side, size));
    return read_scene((source_dir() / "scenes/edits.xml").string(), parse_defines(values));
}

class ControlledPictures : public testing::TestWithParam<ControlCase> {};

// Independent samples, because stratified ones have less error than their spread shows. Detected mutations: the
// covariance with the other sign; the old image's variance not multiplied by alpha^2; its variance from the pixel
// itself instead of its neighbours (biased).
TEST_P(ControlledPictures, AreUnbiasedAndNoWorseThanEither) {
    const ControlCase& edited = GetParam();
    if (!edited.ordinary && !full_run()) GTEST_SKIP() << "in full runs";
    std::vector<std::string> changed = edited.both;
    changed.insert(changed.end(), edited.edit.begin(), edited.edit.end());
    SceneDescription before = description(edited.both), after = description(changed);
    const Edit edit = find_edit(before, after);
    const auto old_scene = build_scene(std::move(before)), new_scene = build_scene(std::move(after));
    const std::uint64_t spp = full_run() ? 64 : 32;
    app::Report report;
    report.set_quiet(true);
    PathOptions path = options_of(*new_scene);
    path.sampler = SamplerKind::independent;

    std::vector<Image> images(replicates);
    const auto make = [&](auto&& one) {
        tbb::parallel_for(0, replicates, [&](int i) {
            PathOptions mine = path;
            mine.seed = std::uint64_t(500 + i);
            images[std::size_t(i)] = one(mine);
        });
        ImageSpread pictures(size * size);
        for (const Image& image : images) pictures.add(image);
        return pictures;
    };
    const auto trace = [&](const Scene& scene, PathOptions mine, std::uint64_t n) {
        Counts counts;
        return trace::render_image(scene, mine, {0, n, 1}, report, counts);
    };
    const ImageSpread fresh = make([&](const PathOptions& mine) { return trace(*new_scene, mine, spp); });
    for (const std::uint64_t base : {8, 64}) {
        std::vector<Image> sums(replicates);
        const ImageSpread controlled = make([&](const PathOptions& mine) {
            const Image old_picture = trace(*old_scene, mine, base);
            DynamicOptions options;
            options.pilot = true;
            options.must_gain = 1e9;
            options.old_picture = &old_picture;
            DynamicCounts counts;
            Image residual = render_dynamic({*old_scene, *new_scene}, edit, options, mine, {0, spp, 1}, report, counts);
            residual.ledger = {LedgerLink{}};
            sums[mine.seed - 500] = add_residual(old_picture, residual);
            const Image picture = take_controlled(old_picture, residual, *counts.controlled);
            EXPECT_NEAR(accumulated_var_mean(picture.ledger, 2), mean_var_mean(picture), 1e-4 * mean_var_mean(picture));
            return picture;
        });
        ImageSpread plain(size * size);
        for (const Image& image : sums) plain.add(image);
        const double alpha = sidak_alpha(2 * 5 * 3 * 65);
        for (int c = 0; c < 3; ++c)
            for (int region = 0; region < 1 + n_tiles * n_tiles; ++region) {
                const Estimate ours = controlled.estimate(std::size_t(c), std::size_t(region)),
                               theirs = fresh.estimate(std::size_t(c), std::size_t(region));
                EXPECT_GT(welch_p_value(ours, theirs), alpha)
                    << fmt::format("base {} channel {} region {}: {:.5g} +- {:.2g}, fresh {:.5g} +- {:.2g}", base, c,
                                   region, ours.mean, ours.se, theirs.mean, theirs.se);
            }
        const auto variance_of = [](const ImageSpread& of) { return of.variance(ImageSpread::everywhere); };
        const double variance = variance_of(controlled), of_fresh = variance_of(fresh), of_sum = variance_of(plain),
                     said = controlled.stored_variance(ImageSpread::everywhere);
        fmt::print(
            "{} on {} samples: variance {:.3g} (said {:.3g}); of a fresh picture {:.3g} times, of old plus residual "
            "{:.3g} times that\n",
            edited.name, base, variance, said, of_fresh / variance, of_sum / variance);
        EXPECT_NEAR(variance / said, 1, base == 8 ? 0.25 : 0.15);  // of 8 samples, VarMean is a guess
        EXPECT_LT(variance, 1.15 * of_fresh);
        EXPECT_LT(variance, 1.05 * of_sum);
        if (base == 64) {
            EXPECT_GT(of_sum / variance, edited.gain_at_least);
        }
    }
}

INSTANTIATE_TEST_SUITE_P(Edits, ControlledPictures,
                         testing::Values(ControlCase{"darker", {}, {"light=3,3,3"}, true, 20},
                                         ControlCase{"brighter", {}, {"light=40,30,10"}, false, 1},
                                         ControlCase{"metal", {"floor=tile", "tall=metal"}, {"short=metal"}, false, 1},
                                         ControlCase{"moved", {}, {"across=100"}, true, 1},
                                         ControlCase{"nothing", {}, {}, false, 1.2}),
                         [](const auto& info) { return std::string(info.param.name); });

}  // namespace
}  // namespace loom::residual
