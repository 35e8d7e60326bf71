// Weights of the old image by what the camera sees of an edit: sums with a graph's residual stay unbiased, and lose the noise
// of old paths where they say nothing.

#include "stages/residual/control/coverage.h"

#include <fmt/format.h>
#include <gtest/gtest.h>
#include <tbb/parallel_for.h>

#include "stages/core/edit/edit_reach.h"
#include "stages/core/stats/chi_square.h"
#include "stages/residual/control/seen_emission.h"
#include "stages/residual/residual.h"
#include "stages/residual/sky_pair.h"
#include "stages/residual/stored/old_graph.h"
#include "tests/statistical/image_spread.h"
#include "tests/statistical/support.h"
#include "tests/traced_graph.h"

namespace loom::residual {
namespace {

constexpr int replicates = 32, size = 24;

/// A white pole as wide as a pixel in front of a dark wall.
constexpr const char* pole_text =
    R"(<scene version="3.0.0"><default name="x" value="0.03"/><default name="resx" value="24"/><default name="resy" value="24"/>
<integrator type="path"><integer name="max_depth" value="3"/></integrator>
<sensor type="perspective"><float name="fov" value="40"/><transform name="to_world"><lookat origin="0, 0, 3" target="0, 0, 0" up="0, 1, 0"/></transform>
<film type="hdrfilm"><integer name="width" value="$resx"/><integer name="height" value="$resy"/><rfilter type="box"/></film></sensor>
<shape type="rectangle"><transform name="to_world"><scale value="3"/><translate z="-0.5"/></transform><bsdf type="diffuse"><rgb name="reflectance" value="0.05, 0.05, 0.05"/></bsdf></shape>
<shape type="rectangle" id="pole"><transform name="to_world"><scale x="0.04" y="0.9"/><translate x="$x"/></transform><bsdf type="twosided"><bsdf type="diffuse"><rgb name="reflectance" value="0.9, 0.9, 0.9"/></bsdf></bsdf></shape>
<emitter type="point"><point name="position" x="0.3" y="0.5" z="3"/><rgb name="intensity" value="20, 20, 20"/></emitter>
</scene>)";

/// A ball that emits close to a wall, and a wide emitter; a board hides a part of both.
constexpr const char* lamps_text =
    R"(<scene version="3.0.0"><default name="x" value="-0.4"/><default name="wide" value="1"/><default name="resx" value="24"/><default name="resy" value="24"/>
<integrator type="path"><integer name="max_depth" value="4"/></integrator>
<sensor type="perspective"><float name="fov" value="40"/><transform name="to_world"><lookat origin="0, 0, 4" target="0, 0, 0" up="0, 1, 0"/></transform>
<film type="hdrfilm"><integer name="width" value="$resx"/><integer name="height" value="$resy"/><rfilter type="box"/></film></sensor>
<shape type="rectangle"><transform name="to_world"><scale value="3"/><translate z="-0.5"/></transform><bsdf type="diffuse"><rgb name="reflectance" value="0.6, 0.5, 0.4"/></bsdf></shape>
<shape type="rectangle"><transform name="to_world"><scale x="0.4" y="0.3"/><translate x="0.3" y="-0.3" z="0.2"/></transform><bsdf type="twosided"><bsdf type="diffuse"/></bsdf></shape>
<shape type="sphere"><point name="center" x="0" y="0" z="0"/><float name="radius" value="0.15"/><transform name="to_world"><translate x="$x" y="0.4" z="-0.1"/></transform><bsdf type="diffuse"><rgb name="reflectance" value="0, 0, 0"/></bsdf><emitter type="area"><rgb name="radiance" value="8, 7, 6"/></emitter></shape>
<shape type="rectangle"><transform name="to_world"><scale value="0.5"/><rotate x="1" angle="90"/><translate y="1.6" z="0.5"/></transform><bsdf type="diffuse"><rgb name="reflectance" value="0, 0, 0"/></bsdf><emitter type="area"><rgb name="radiance" value="$wide, $wide, $wide"/></emitter></shape>
</scene>)";

/// A ball on a floor under the sun; a board beside them throws a shadow. A board at x = 9 is as good as none.
constexpr const char* sky_text =
    R"(<scene version="3.0.0"><default name="haze" value="2"/><default name="east" value="0.3"/><default name="x" value="-0.5"/><default name="resx" value="24"/><default name="resy" value="24"/>
<integrator type="path"><integer name="max_depth" value="4"/></integrator>
<sensor type="perspective"><float name="fov" value="40"/><transform name="to_world"><lookat origin="0, 1.6, 4" target="0, 0.3, 0" up="0, 1, 0"/></transform>
<film type="hdrfilm"><integer name="width" value="$resx"/><integer name="height" value="$resy"/><rfilter type="box"/></film></sensor>
<shape type="rectangle"><transform name="to_world"><scale value="2"/><rotate x="1" angle="-90"/></transform><bsdf type="twosided"><bsdf type="diffuse"/></bsdf></shape>
<shape type="sphere"><point name="center" x="0.5" y="0.4" z="0"/><float name="radius" value="0.4"/><bsdf type="roughconductor"><float name="alpha" value="0.2"/></bsdf></shape>
<shape type="rectangle" id="board"><transform name="to_world"><scale x="0.3" y="0.5"/><rotate y="1" angle="20"/><translate x="$x" y="0.5" z="0.1"/></transform><bsdf type="twosided"><bsdf type="diffuse"/></bsdf></shape>
<emitter type="sunsky"><float name="turbidity" value="$haze"/><vector name="sun_direction" x="$east" y="0.7" z="0.5"/><float name="sun_scale" value="0.05"/></emitter>
</scene>)";

struct CoverageCase {
    const char* name;
    const char* scene;                       // file of the project; or one of the texts above
    std::vector<std::string> before, after;  // NAME=VALUE
    double gain_at_least;                    // in covered pixels: variance with weight 1 over that by coverage
    double of_fresh_at_most = 1.1;           // there: variance by coverage over a fresh image's
    double of_fresh_everywhere = INFINITY;   // the same in all pixels
    std::uint64_t spp = 16;                  // of the graph; four times as many in the full run
    bool shares_sky = false;                 // light samples of two skies are in common directions
    double seen_gain =
        0;  // where emission is seen by rays of its own: variance with that of the paths over it; 0: nowhere
};

class CoverageOfEdits : public ::testing::TestWithParam<CoverageCase> {
  protected:
    const std::filesystem::path text_ = testing::scratch_file(".xml");

    void SetUp() override { std::ofstream(text_) << GetParam().scene; }
    void TearDown() override { std::filesystem::remove(text_); }

    SceneDescription description(std::vector<std::string> values) const {
        for (const char* side : {"resx", "resy"}) values.push_back(fmt::format("{}={}", side, size));
        const std::string_view scene = GetParam().scene;
        const std::filesystem::path file = scene.starts_with('<') ? text_ : source_dir() / "scenes" / scene;
        return read_scene(file.string(), parse_defines(values));
    }
};

// Any weight that does not depend on the samples is right: by coverage, and random ones in [-1, 2]; so is emission that is
// seen by rays of its own. Detected mutations: untouched paths left out of the weighted sum; weights from the graph's own
// first hits (pole); emission left in the old paths, or in the new ones; its old part added with weight 1.
TEST_P(CoverageOfEdits, SumsAreUnbiasedWithAnyWeight) {
    const CoverageCase& edited = GetParam();
    SceneDescription before = description(edited.before), after = description(edited.after);
    const Edit edit = find_edit(before, after);
    const auto old_scene = build_scene(std::move(before)), fresh_scene = build_scene(std::move(after));
    const SkyPair skies = find_sky_pair(*old_scene, *fresh_scene);
    const auto paired_scene = skies.shared ? with_proposals(*fresh_scene, skies.shared) : nullptr;
    const Scene* const new_scene = skies.shared ? paired_scene.get() : fresh_scene.get();
    EXPECT_EQ(bool(skies.shared), edited.shares_sky);
    const ScenePair scenes{*old_scene, *new_scene};
    const EditReach reach(*old_scene, *new_scene, edit);
    app::Report report;
    report.set_quiet(true);
    const std::uint64_t spp = edited.spp * (full_run() ? 4 : 1), old_spp = 4 * spp;
    const auto path_of = [&](const Scene& scene, std::uint64_t seed) {
        PathOptions path = options_of(scene);
        path.sampler = SamplerKind::independent;
        path.seed = seed;
        return path;
    };
    const auto trace = [&](const Scene& scene, std::uint64_t seed, std::uint64_t n) {
        Counts counts;
        return trace::render_image(scene, path_of(scene, seed), {0, n, 1}, report, counts);
    };
    std::vector<Spectrum> random(size * size);
    for (std::size_t p = 0; p < random.size(); ++p)
        random[p] = Spectrum(3 * Sampler(SamplerKind::independent, 3, p, 0).pair(0).x - 1);

    enum Way { fresh, plain, covered, any, seen, n_ways };
    std::vector<std::array<Image, n_ways>> images(replicates);
    std::vector<float> least(size * size, 1);
    std::vector<std::uint8_t> at_edge(size * size);
    tbb::parallel_for(0, replicates, [&](int i) {
        const auto seed = std::uint64_t(i);
        const PathOptions of_graph = path_of(*old_scene, 900 + seed);
        OldGraph graph;
        for (const std::uint64_t first : {std::uint64_t(0), spp / 2})
            graph.passes.push_back(testing::trace_graph(*old_scene, of_graph, spp / 2, first, {.misses = true}));
        graph.files = {"graph-0.h5", "graph-1.h5"};
        graph.path = of_graph;
        graph.spp = spp;
        const Image old_picture = trace(*old_scene, 700 + seed, old_spp);
        const auto with = [&](std::optional<ControlSums> control, const SeenEmission& by_rays = {}) {
            const GraphJob job{*new_scene, reach, nullptr, control ? &*control : nullptr, nullptr, &by_rays};
            GraphResidual residual = std::move(render_residuals(*old_scene, {&job, 1}, graph, 1, report)[0]);
            by_rays.add_to(residual.image);
            if (control && control->fits) control->fit(new_scene->sensor, old_spp);
            return control ? controlled_picture(old_picture, residual.image, *control, &by_rays).image
                           : add_residual(old_picture, residual.image);
        };
        std::array<Image, n_ways>& mine = images[std::size_t(i)];
        mine[fresh] = trace(*fresh_scene, 500 + seed, spp);
        mine[plain] = with({});
        const auto control = graph_control(scenes, reach, of_graph.seed, 1);
        ASSERT_TRUE(control);
        if (i == 0)
            for (std::size_t p = 0; p < least.size(); ++p) least[p] = control->alpha[p].r;
        mine[covered] = with(control);
        const SeenEmission by_rays(scenes, reach, of_graph.seed, spp, 1);
        EXPECT_EQ(by_rays.empty(), edited.seen_gain == 0);
        mine[any] = with(ControlSums(random), by_rays);
        mine[seen] = by_rays.empty() ? mine[covered] : with(control, by_rays);
        if (i == 0)
            for (std::size_t p = 0; p < at_edge.size(); ++p) at_edge[p] = by_rays.has(p);
    });
    std::vector<ImageSpread> of(n_ways, ImageSpread(size * size));
    for (const auto& image : images)
        for (int way = 0; way < n_ways; ++way) of[std::size_t(way)].add(image[std::size_t(way)]);
    const double alpha = sidak_alpha(4 * 3 * (1 + n_tiles * n_tiles) * 3);
    for (const Way way : {plain, covered, any, seen})
        for (std::size_t c = 0; c < 3; ++c)
            for (std::size_t region = 0; region < 1 + n_tiles * n_tiles; ++region) {
                const Estimate ours = of[way].estimate(c, region), theirs = of[fresh].estimate(c, region);
                EXPECT_GT(welch_p_value(ours, theirs), alpha)
                    << fmt::format("{} way {} channel {} region {}: {:.5g} +- {:.2g}, fresh {:.5g} +- {:.2g}",
                                   edited.name, int(way), c, region, ours.mean, ours.se, theirs.mean, theirs.se);
            }
    const auto is_covered = [](float a) { return a < 0.5f; };
    const bool any_covered = std::any_of(least.begin(), least.end(), is_covered);
    const auto inside = [&](std::size_t p) { return is_covered(least[p]) || !any_covered; };
    const double said = of[covered].stored_variance(inside) / of[covered].variance(inside);
    const double gain = of[plain].variance(inside) / of[covered].variance(inside);
    fmt::print(
        "    {}: {} pixels covered; variance there {:.3g} times less than with weight 1, {:.3g} times a fresh one's, "
        "stored "
        "{:.3g} of it; everywhere {:.3g} times a fresh one's\n",
        edited.name, std::count_if(least.begin(), least.end(), is_covered), gain,
        of[covered].variance(inside) / of[fresh].variance(inside), said,
        of[covered].variance(ImageSpread::everywhere) / of[fresh].variance(ImageSpread::everywhere));
    EXPECT_GT(gain, edited.gain_at_least);
    EXPECT_LT(of[covered].variance(inside), edited.of_fresh_at_most * of[fresh].variance(inside));
    EXPECT_LT(of[covered].variance(ImageSpread::everywhere), 1.05 * of[plain].variance(ImageSpread::everywhere));
    EXPECT_LT(of[covered].variance(ImageSpread::everywhere),
              edited.of_fresh_everywhere * of[fresh].variance(ImageSpread::everywhere));
    EXPECT_NEAR(said, 1, 0.25);
    if (edited.seen_gain == 0) return;
    const auto edge = [&](std::size_t p) { return bool(at_edge[p]); };
    const double seen_gain = of[covered].variance(edge) / of[seen].variance(edge);
    fmt::print("    emission by rays of its own in {} pixels: variance there {:.3g} times less, stored {:.3g} of it\n",
               std::count(at_edge.begin(), at_edge.end(), 1), seen_gain,
               of[seen].stored_variance(edge) / of[seen].variance(edge));
    EXPECT_GT(seen_gain, edited.seen_gain);
    EXPECT_NEAR(of[seen].stored_variance(edge) / of[seen].variance(edge), 1, 0.25);
}

// The mask of [HY] Eq. (10) is biased where a pixel sees more than what differs, and less so with more samples: it is an
// option for comparison alone.
TEST(MaskByFirstHits, IsBiasedAtEdges) {
    const auto file = testing::scratch_file(".xml");
    std::ofstream(file) << pole_text;
    const auto described = [&](const char* x) { return read_scene(file.string(), {{"x", x}}); };
    SceneDescription before = described("0.03"), after = described("9");
    const Edit edit = find_edit(before, after);
    const auto old_scene = build_scene(std::move(before)), new_scene = build_scene(std::move(after));
    std::filesystem::remove(file);
    const ScenePair scenes{*old_scene, *new_scene};
    const EditReach reach(*old_scene, *new_scene, edit);
    app::Report report;
    report.set_quiet(true);
    Counts counts;
    std::vector<double> masked(replicates), fresh(replicates), by_coverage(replicates);
    constexpr std::uint64_t spp = 8;
    for (int i = 0; i < replicates; ++i) {
        const auto mean = [&](const Image& image) { return region_means(image)[1][0]; };
        PathOptions path = options_of(*old_scene);
        path.sampler = SamplerKind::independent;
        path.seed = std::uint64_t(700 + i);
        const Image old_picture = trace::render_image(*old_scene, path, {0, 4 * spp, 1}, report, counts);
        path.seed = std::uint64_t(500 + i);
        fresh[std::size_t(i)] = mean(trace::render_image(*new_scene, path, {0, 4 * spp, 1}, report, counts));
        path.seed = std::uint64_t(900 + i);
        OldGraph graph;
        graph.passes.push_back(testing::trace_graph(*old_scene, path, spp));
        graph.files = {"graph.h5"};
        graph.path = path;
        graph.spp = spp;
        const auto with = [&](std::optional<ControlSums> control) {
            const GraphResidual residual = render_residual(scenes, reach, graph, 1, nullptr, report, &*control);
            return mean(controlled_picture(old_picture, residual.image, *control).image);
        };
        masked[std::size_t(i)] = with(first_hit_control(scenes, reach, path.sampler, path.seed, graph.samples(), 1));
        by_coverage[std::size_t(i)] = with(graph_control(scenes, reach, path.seed, 1));
    }
    const Estimate ours = estimate_of(masked), theirs = estimate_of(fresh), unbiased = estimate_of(by_coverage);
    fmt::print("    image mean {:.5g} +- {:.2g} by first hits, {:.5g} +- {:.2g} by coverage, {:.5g} +- {:.2g} fresh\n",
               ours.mean, ours.se, unbiased.mean, unbiased.se, theirs.mean, theirs.se);
    EXPECT_GT(std::abs(ours.mean / theirs.mean - 1), 0.02);
    EXPECT_LT(welch_p_value(ours, theirs), 1e-4);
    EXPECT_GT(welch_p_value(unbiased, theirs), 1e-3);
}

INSTANTIATE_TEST_SUITE_P(
    Edits, CoverageOfEdits,
    ::testing::Values(
        CoverageCase{"arrives", "animated/ball.xml", {"y=9"}, {"y=0.6"}, 2},
        CoverageCase{"leaves", "animated/ball.xml", {"y=0.6"}, {"y=9"}, 1},
        CoverageCase{"moves", "animated/ball.xml", {"x=-0.3", "y=0.6"}, {"x=0.2", "y=0.7"}, 1.5},
        CoverageCase{"pole", pole_text, {}, {"x=9"}, 1, INFINITY}, CoverageCase{"box", "edits.xml", {}, {"x=0.2"}, 1},
        CoverageCase{"dimmed", "edits.xml", {}, {"light=4, 3, 2"}, 2, INFINITY, 0.2, 16, false, 1.1},
        CoverageCase{"brighter", "edits.xml", {}, {"light=40, 30, 20"}, 1, INFINITY, 0.4, 16, false, 1.1},
        CoverageCase{"lamp_moves", lamps_text, {}, {"x=-0.1"}, 1, INFINITY, 1.1, 4, false, 8},
        CoverageCase{"lamp_moves_far", lamps_text, {}, {"x=0.7"}, 1, INFINITY, 1.1, 4, false, 8},
        CoverageCase{"wide_lamp_dimmed", lamps_text, {}, {"wide=0.2"}, 1, INFINITY, 0.9, 4},
        CoverageCase{"sky_clears", sky_text, {"haze=3"}, {"haze=2"}, 1, INFINITY, 0.5, 16, true},
        CoverageCase{
            "sky_clears_and_board_moves", sky_text, {"haze=3"}, {"haze=2", "x=-0.2"}, 1, INFINITY, 0.7, 16, true},
        CoverageCase{"sky_clears_and_board_goes", sky_text, {"haze=6"}, {"haze=2", "x=9"}, 1, INFINITY, 1.1, 16, true},
        CoverageCase{"sun_moves", sky_text, {}, {"east=0.2"}, 1, INFINITY, 1.1}),
    [](const ::testing::TestParamInfo<CoverageCase>& info) { return info.param.name; });

}  // namespace
}  // namespace loom::residual
