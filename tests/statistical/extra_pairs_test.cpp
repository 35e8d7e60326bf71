// Adaptive pairs on top of a graph's, and fewer than one per pixel alone: image means and 8 x 8 tiles against a fresh image, and
// how much less variance they have than as many pairs spread evenly.

#include <fmt/format.h>
#include <gtest/gtest.h>
#include <tbb/parallel_for.h>

#include "stages/core/stats/chi_square.h"
#include "stages/residual/adaptive_pairs.h"
#include "stages/residual/residual.h"
#include "stages/residual/stored/old_graph.h"
#include "tests/statistical/image_spread.h"
#include "tests/statistical/support.h"
#include "tests/traced_graph.h"

namespace loom::residual {
namespace {

constexpr int replicates = 32, size = 32;

struct Case {
    const char* name;
    const char* scene;
    std::vector<std::string> before, after;  // NAME=VALUE
};

/// Sum with an old image, and what the pairs bring to it.
struct Sum {
    Image image, of_pairs;

    Sum() = default;
    Sum(const Image& old_picture, const Image& residual, const ControlSums& control)
        : image(controlled_picture(old_picture, residual, control).image) {
        Image black = old_picture;
        for (Image::Channel& channel : black.channels) std::fill(channel.values.begin(), channel.values.end(), 0.0f);
        of_pairs = controlled_picture(black, residual, control).image;
    }
};

class AdaptivePairs : public ::testing::TestWithParam<Case> {
  protected:
    static SceneDescription description(std::vector<std::string> values) {
        for (const char* side : {"resx", "resy"}) values.push_back(fmt::format("{}={}", side, size));
        return read_scene((source_dir() / "scenes" / GetParam().scene).string(), parse_defines(values));
    }
    void SetUp() override {
        SceneDescription before = description(GetParam().before), after = description(GetParam().after);
        edit_ = find_edit(before, after);
        old_scene_ = build_scene(std::move(before));
        new_scene_ = build_scene(std::move(after));
        report_.set_quiet(true);
    }
    ScenePair pair() const { return {*old_scene_, *new_scene_}; }
    PathOptions path(std::uint64_t seed) const {
        PathOptions path = options_of(*new_scene_);
        path.sampler = SamplerKind::independent;
        path.seed = seed;
        return path;
    }
    Image trace(const Scene& scene, std::uint64_t seed, std::uint64_t spp) {
        Counts counts;
        return trace::render_image(scene, path(seed), {0, spp, 1}, report_, counts);
    }
    /// Compares the means of images with fresh ones.
    void expect_equal(const char* what, const std::vector<Sum>& sums, int n_comparisons) {
        ImageSpread ours(size * size);
        for (const Sum& sum : sums) ours.add(sum.image);
        const double alpha = sidak_alpha(n_comparisons * 3 * (1 + n_tiles * n_tiles));
        for (std::size_t c = 0; c < 3; ++c)
            for (std::size_t region = 0; region < 1 + n_tiles * n_tiles; ++region) {
                const Estimate a = ours.estimate(c, region), b = fresh().estimate(c, region);
                EXPECT_GT(welch_p_value(a, b), alpha)
                    << fmt::format("{} {} channel {} region {}: {:.5g} +- {:.2g}, fresh {:.5g} +- {:.2g}",
                                   GetParam().name, what, c, region, a.mean, a.se, b.mean, b.se);
            }
    }
    const ImageSpread& fresh() {
        if (!fresh_) {
            std::vector<Image> images(replicates);
            tbb::parallel_for(0, replicates, [&](int i) {
                images[std::size_t(i)] = trace(*new_scene_, std::uint64_t(500 + i), full_run() ? 256 : 16);
            });
            fresh_.emplace(size * size);
            for (const Image& image : images) fresh_->add(image);
        }
        return *fresh_;
    }
    double variance(const std::vector<Sum>& sums) const {
        ImageSpread spread(size * size);
        for (const Sum& sum : sums) spread.add(sum.of_pairs);
        return spread.variance(ImageSpread::everywhere);
    }

    std::unique_ptr<Scene> old_scene_, new_scene_;
    Edit edit_;
    app::Report report_;
    std::optional<ImageSpread> fresh_;
    const std::uint64_t old_spp_ = full_run() ? 256 : 16;
};

TEST_P(AdaptivePairs, OnTopOfAGraphAreUnbiased) {
    const EditReach reach(*old_scene_, *new_scene_, edit_);
    const std::uint64_t spp = full_run() ? 8 : 4;
    std::vector<Sum> alone(replicates), with(replicates), evenly(replicates);
    tbb::parallel_for(0, replicates, [&](int i) {
        const auto seed = std::uint64_t(i);
        const Image old_picture = trace(*old_scene_, 700 + seed, old_spp_);
        const auto render = [&](std::uint64_t n, double mean) {
            OldGraph graph;
            graph.path = path(900 + seed);
            graph.passes.push_back(testing::trace_graph(*old_scene_, graph.path, n, 0, {.misses = true}));
            graph.files = {"graph.h5"};
            graph.spp = n;
            std::optional<ControlSums> control = graph_control(pair(), reach, graph.path.seed, 1);
            if (!control) control.emplace(std::vector<Spectrum>(size * size, Spectrum(1)));
            GraphResidual residual = render_residual(pair(), reach, graph, 1, nullptr, report_, &*control);
            std::optional<ExtraPairs> extra;
            if (mean > 0)
                extra = trace_extra_pairs(pair(), edit_, {mean, false, path(1900 + seed), 1}, residual.image, n,
                                          &*control, report_);
            if (control->fits) control->fit(new_scene_->sensor, old_spp_);
            if (extra) add_pairs(extra->sums, n, residual.image, &*control);
            return Sum(old_picture, residual.image, *control);
        };
        alone[std::size_t(i)] = render(spp, 0);
        with[std::size_t(i)] = render(spp, double(spp));
        evenly[std::size_t(i)] = render(2 * spp, 0);
    });
    expect_equal("with extra pairs", with, 12);
    const double v_alone = variance(alone), v_with = variance(with), v_even = variance(evenly);
    fmt::print(
        "    {}: variance of {} pairs over that with as many extra ones {:.3g}; of twice as many over that {:.3g}\n",
        GetParam().name, spp, v_alone / v_with, v_even / v_with);
    EXPECT_LT(v_with, v_alone);
}

TEST_P(AdaptivePairs, BelowOneAreUnbiased) {
    const EditReach reach(*old_scene_, *new_scene_, edit_);
    for (const double mean : {0.25, 0.5, 1.0}) {
        std::vector<Sum> by_map(replicates), evenly(replicates);
        tbb::parallel_for(0, replicates, [&](int i) {
            const auto seed = std::uint64_t(i);
            const Image old_picture = trace(*old_scene_, 700 + seed, old_spp_);
            for (const bool even : {false, true}) {
                std::optional<ControlSums> control = graph_control(pair(), reach, 900 + seed, 1);
                if (!control) control.emplace(std::vector<Spectrum>(size * size, Spectrum(1)));
                const SparseResidual sparse =
                    render_sparse_residual(pair(), edit_, {mean, even, path(1900 + seed), 1}, control->alpha, report_);
                (even ? evenly : by_map)[std::size_t(i)] = Sum(old_picture, sparse.weighted, *control);
            }
        });
        expect_equal(fmt::format("{} pairs", mean).c_str(), by_map, 12);
        expect_equal(fmt::format("{} pairs evenly", mean).c_str(), evenly, 12);
        EXPECT_GT(variance(evenly), 0.95 * variance(by_map));
        fmt::print("    {}: {} pairs evenly have {:.3g} times the variance of as many by a map\n", GetParam().name,
                   mean, variance(evenly) / variance(by_map));
    }
}

INSTANTIATE_TEST_SUITE_P(Edits, AdaptivePairs,
                         ::testing::Values(Case{"arrives", "animated/ball.xml", {"y=9"}, {"y=0.6"}},
                                           Case{"moves", "animated/ball.xml", {"x=-0.3", "y=0.6"}, {"x=0.2", "y=0.7"}},
                                           Case{"box", "edits.xml", {}, {"x=0.2"}},
                                           Case{"brighter", "edits.xml", {}, {"light=20, 16, 12"}}),
                         [](const ::testing::TestParamInfo<Case>& info) { return info.param.name; });

}  // namespace
}  // namespace loom::residual
