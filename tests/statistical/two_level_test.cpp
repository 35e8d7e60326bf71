// Frames by two levels of paths against path tracing of the same seeds: their difference has the mean zero for any cache.
// Diffuse, glossy, mirror, glass and emitting surfaces, a sky, a ball that moves and a camera of another frame.
// Detected mutations: no division by R; the cache not subtracted where a path is traced on; emission at the second vertex
// counted twice, or without its weight; the choice by a number that the path uses too; far answers used and not corrected.

#include "stages/residual/two_level.h"

#include <fmt/format.h>
#include <gtest/gtest.h>

#include <cmath>
#include <fstream>

#include "stages/core/edit/edit.h"
#include "stages/core/stats/chi_square.h"
#include "stages/core/stats/student.h"
#include "tests/learnt_cache.h"
#include "tests/statistical/path_graph_passes.h"

namespace loom {
namespace {

constexpr int n_replicates = 32;
constexpr std::uint64_t spp = 64;

constexpr const char* scene_text =
    R"(<scene version="3.0.0"><integrator type="path"><integer name="max_depth" value="7"/><integer name="rr_depth" value="3"/></integrator>
<sensor type="perspective"><float name="fov" value="50"/><transform name="to_world"><lookat origin="{},-3.4,1.4" target="0,0,.8" up="0,0,1"/></transform>
<film type="hdrfilm"><integer name="width" value="24"/><integer name="height" value="16"/><rfilter type="box"/></film></sensor>
<bsdf type="twosided" id="grey"><bsdf type="diffuse"><rgb name="reflectance" value=".6,.6,.5"/></bsdf></bsdf>
<shape type="rectangle"><transform name="to_world"><scale value="2"/></transform><bsdf type="twosided"><bsdf type="roughplastic"><float name="alpha" value=".2"/><rgb name="diffuse_reflectance" value=".5,.3,.2"/></bsdf></bsdf></shape>
<shape type="rectangle"><transform name="to_world"><scale value="2"/><rotate x="1" angle="90"/><translate y="1.6"/></transform><ref id="grey"/></shape>
<shape type="rectangle"><transform name="to_world"><scale value="2"/><rotate y="1" angle="90"/><translate x="-1.7"/></transform><ref id="grey"/></shape>
<shape type="rectangle"><transform name="to_world"><scale x=".5" y=".7"/><rotate x="1" angle="90"/><translate x="1.1" y="1.4" z=".8"/></transform><bsdf type="twosided"><bsdf type="conductor"><string name="material" value="none"/></bsdf></bsdf></shape>
<shape type="rectangle"><transform name="to_world"><scale value=".6"/><rotate x="1" angle="100"/><translate x="-.6" y="1.3" z=".8"/></transform><bsdf type="twosided"><bsdf type="roughconductor"><float name="alpha" value=".25"/></bsdf></bsdf></shape>
<shape type="sphere"><float name="radius" value=".3"/><point name="center" x=".8" y="-.5" z=".35"/><bsdf type="dielectric"/></shape>
<shape type="rectangle"><transform name="to_world"><scale value=".7"/><rotate x="1" angle="180"/><translate z="2.4"/></transform><emitter type="area"><rgb name="radiance" value="5,4,3"/></emitter></shape>
<emitter type="constant"><rgb name="radiance" value=".3,.4,.5"/></emitter>
{}</scene>)";

struct Room {
    std::unique_ptr<Scene> old_scene, new_scene;
    Edit edit;

    Room() {
        const File without(0.6, ""),
            with(0.6,
                 "<shape type='sphere'><float name='radius' value='.35'/><point name='center' x='-.3' y='-.4' "
                 "z='.5'/><bsdf type='diffuse'><rgb name='reflectance' value='.7,.4,.3'/></bsdf></shape>");
        SceneDescription before = read_scene(without.path, {}), after = read_scene(with.path, {});
        edit = find_edit(before, after);
        old_scene = build_scene(std::move(before));
        new_scene = build_scene(std::move(after));
    }
    struct File {
        const std::filesystem::path path = testing::scratch_file(".xml");
        File(double eye, const char* ball) { std::ofstream(path) << fmt::format(fmt::runtime(scene_text), eye, ball); }
        ~File() { std::filesystem::remove(path); }
    };
    /// Learns a cache from another camera.
    RadianceCache learnt() const {
        const File file(-0.4, "");
        const std::unique_ptr<Scene> view = load_scene(file.path);
        PathOptions path = options_of(*view);
        path.seed = 99;
        return testing::learnt_cache(*view, path, 64, 64);
    }
};

/// Tests that the mean of `ours` minus path tracing is zero, in the image and in its tiles.
/// in:      bias  relative, of the image, that the test must detect
void expect_unbiased(RadianceCache cache, double share, double bias) {
    const Room room;
    const auto reader = make_cache_reader(std::move(cache));
    Replicates differences, paths;
    app::Report report;
    report.set_quiet(true);
    for (int i = 0; i < n_replicates; ++i) {
        PathOptions path = options_of(*room.new_scene);
        path.seed = 6000 + std::uint64_t(i);
        residual::CachedCounts counts;
        const RegionMeans ours = region_means(residual::render_corrected(
            {*room.old_scene, *room.new_scene}, room.edit, *reader, share, path, {0, spp, 0}, report, counts));
        trace::Counts traced;
        paths.regions.push_back(region_means(trace::render_image(*room.new_scene, path, {0, spp, 0}, report, traced)));
        differences.regions.push_back(ours);
        for (std::size_t c = 0; c < 3; ++c)
            for (std::size_t k = 0; k < ours[c].size(); ++k)
                differences.regions.back()[c][k] -= paths.regions.back()[c][k];
        EXPECT_EQ(counts.counts.nonfinite, 0u);
        EXPECT_EQ(counts.samples, 24 * 16 * spp);
        EXPECT_GT(counts.queries, counts.samples / 4);
        EXPECT_NEAR(double(counts.traced_on), share * double(counts.queries - counts.far) + double(counts.far),
                    0.02 * double(counts.queries));
    }
    const double alpha = sidak_alpha(3 * 3 * (1 + n_tiles * n_tiles));
    double least = 1;
    std::string where;
    for (int c = 0; c < 3; ++c)
        for (int region = 0; region <= n_tiles * n_tiles; ++region) {
            const Estimate difference = differences.estimate(c, region);
            const double p = welch_p_value(difference, {0, 0, INFINITY});
            if (p < least) least = p, where = fmt::format("channel {}, region {}", c, region);
            if (region > 0) continue;
            // Power: that bias of the image would be detected in nine of ten runs.
            EXPECT_LE((student_critical(alpha, difference.dof) + 1.28) * difference.se,
                      bias * paths.estimate(c, 0).mean);
            ::testing::Test::RecordProperty(fmt::format("p_of_image_{}", c), fmt::format("{:.3g}", p));
        }
    EXPECT_GE(least, alpha) << where;
    ::testing::Test::RecordProperty("least_p", fmt::format("{:.3g}", least));
}

TEST(TwoLevelMean, IsThatOfPathTracing) {
    expect_unbiased(Room().learnt(), 0.25, 0.01);
}

TEST(TwoLevelMean, IsThatOfPathTracingWhenTheCacheIsThreeTimesTooBright) {
    expect_unbiased(testing::with_values(Room().learnt(), [](float e) { return 3 * e; }), 0.25, 0.02);
}

TEST(TwoLevelMean, IsThatOfPathTracingWhenTheCacheIsConstant) {
    expect_unbiased(testing::with_values(Room().learnt(), [](float) { return 0.5f; }), 0.5, 0.02);
}

}  // namespace
}  // namespace loom
