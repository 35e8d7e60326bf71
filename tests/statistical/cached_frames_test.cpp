// Frames with a radiance cache against path tracing. With a converged cache their mean is that of path tracing, up to the
// error that the cache's validation states; and nothing of the cache is in what is seen of the edit. Detected mutations:
// f_new - f_old of touched pairs left out; nothing masked (what is seen of the ball is then far from the cache, and path-traced).

#include <gtest/gtest.h>

#include <cmath>

#include "formats/io/content_hash.h"
#include "stages/core/edit/animation.h"
#include "stages/residual/cached_estimator.h"
#include "stages/residual/control/seen_emission.h"
#include "tests/learnt_cache.h"
#include "tests/statistical/path_graph_passes.h"

namespace loom {
namespace {

struct Walk {
    std::unique_ptr<Scene> old_scene, new_scene;
    Edit edit;

    /// in:      values  of the frame's parameters; "y=9" takes the ball out of the static scene
    explicit Walk(Defines values) {
        const auto file = source_dir() / "scenes/animated/walk.xml";
        for (const auto& [name, value] : {std::pair("resx", "24"), std::pair("resy", "16")})
            values.emplace_back(name, value);
        const SceneDescription after = read_scene(file, values);
        SceneDescription before = read_scene(file, values);
        auto root = std::make_shared<Object>(*before.root);
        std::erase_if(root->nested, [](const auto& child) { return child.first->id == "ball"; });
        before.root = root;
        edit = find_edit(before, after);
        old_scene = build_scene(std::move(before));
        new_scene = build_scene(SceneDescription(after));
    }
    RadianceCache learnt(std::uint64_t spp) const {
        PathOptions path = options_of(*old_scene);
        path.seed = 99;
        return testing::learnt_cache(*old_scene, path, spp, 64);
    }
};

/// Mean of images by seed, with the spread of the means of regions.
Replicates replicates_of(const Walk& walk, const CacheReader& cache, int n, std::uint64_t spp, bool masked,
                         Image* last = nullptr) {
    Replicates out;
    app::Report report;
    report.set_quiet(true);
    for (int i = 0; i < n; ++i) {
        PathOptions path = options_of(*walk.new_scene);
        path.seed = 4000 + std::uint64_t(i);
        residual::CachedCounts counts;
        Image image = residual::render_cached({*walk.old_scene, *walk.new_scene}, walk.edit, cache, {masked}, path,
                                              {0, spp, 0}, report, counts);
        EXPECT_EQ(counts.counts.nonfinite, 0u);
        // What sees the edit is masked, and does not only happen to be far from the cache.
        EXPECT_EQ(counts.masked > 0, masked);
        out.regions.push_back(region_means(image));
        if (last) *last = std::move(image);
    }
    return out;
}

/// Tests frames against path tracing.
void expect_mean_of_path_tracing(const Walk& walk) {
    const auto reader = make_cache_reader(walk.learnt(256));
    double stated = 0;
    for (const double l2 : reader->cache().validation.relative_l2) stated = std::max(stated, std::sqrt(l2));
    const Replicates ours = replicates_of(walk, *reader, 24, 64, true),
                     fresh = trace_replicates(*walk.new_scene, options_of(*walk.new_scene), 64, 24);
    for (int c = 0; c < 3; ++c) {
        const Estimate a = ours.estimate(c, 0), b = fresh.estimate(c, 0);
        EXPECT_NEAR(a.mean / b.mean, 1, 0.01 + 5 * std::sqrt(sqr(a.se) + sqr(b.se)) / b.mean) << c;
        for (int tile = 1; tile <= n_tiles * n_tiles; ++tile) {
            const Estimate x = ours.estimate(c, tile), y = fresh.estimate(c, tile);
            EXPECT_NEAR(x.mean, y.mean, stated * y.mean + 5 * std::sqrt(sqr(x.se) + sqr(y.se)))
                << c << ", tile " << tile;
        }
    }
    EXPECT_LT(stated, 0.2);
}

// 24 replicates of 64 samples: a standard error of .1 % of the image, of about 1 % of a tile.
TEST(CachedFramesMean, IsThatOfPathTracingUpToTheCache) {
    expect_mean_of_path_tracing(Walk({{"x", "0.1"}, {"y", "0.5"}, {"eye", "0.3, 1.1, 3"}}));
}

// The camera looks up to the emitter. Detected mutation: its emission by rays of its own left out, or counted twice.
TEST(CachedFramesMean, HasTheEmissionThatTheCameraSees) {
    const Walk walk({{"x", "0.1"}, {"y", "1.4"}, {"eye", "0.3, 0.7, 1.8"}, {"target", "0, 1.8, 0"}});
    EXPECT_GT(residual::SeenEmission(*walk.new_scene, 1, 8, 1).n_pixels(), 10u);
    expect_mean_of_path_tracing(walk);
}

// A cache that is wrong by half: what is seen of the ball does not know of it; with the mask left out all of it leaks in.
TEST(CachedFramesMean, WithoutTheMaskTheCacheLeaksIntoWhatMoves) {
    const Walk walk({{"x", "0.1"}, {"y", "0.7"}, {"eye", "0.1, 0.9, 1.1"}});  // the ball fills tiles
    const auto reader = make_cache_reader(testing::with_values(walk.learnt(64), [](float e) { return 1.5f * e; }));
    Image image;
    const Replicates fresh = trace_replicates(*walk.new_scene, options_of(*walk.new_scene), 64, 16),
                     masked = replicates_of(walk, *reader, 16, 64, true, &image),
                     unmasked = replicates_of(walk, *reader, 16, 64, false);
    const RegionMeans by_cache = region_means(image, "CacheError");
    int n = 0;
    for (int tile = 1; tile <= n_tiles * n_tiles; ++tile) {
        if (by_cache[1][std::size_t(tile)] > 0) continue;  // sees more than the ball
        ++n;
        for (int c = 0; c < 3; ++c) {
            const Estimate x = masked.estimate(c, tile), y = fresh.estimate(c, tile), z = unmasked.estimate(c, tile);
            const double se = std::sqrt(sqr(x.se) + sqr(y.se)), wrong_se = std::sqrt(sqr(z.se) + sqr(y.se));
            EXPECT_LT(std::abs(x.mean - y.mean), 4.5 * se) << c << ", tile " << tile;
            EXPECT_GT(z.mean - y.mean, 4.5 * wrong_se) << c << ", tile " << tile;
        }
    }
    EXPECT_GE(n, 4);
}

}  // namespace
}  // namespace loom
