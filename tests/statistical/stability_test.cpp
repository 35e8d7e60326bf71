// Scenes that are hard on path graphs, each with the criterion by which they are judged: METHODS, stress scenes.
// `make stability` runs them at full length.
#include <fmt/format.h>
#include <gtest/gtest.h>

#include <cmath>
#include <numeric>

#include "stages/refine/solve.h"
#include "tests/statistical/path_graph_passes.h"

namespace loom {
namespace {

const std::string grey = R"(<bsdf type="diffuse"><rgb name="reflectance" value="0.7"/></bsdf>)";

/// An emitter that faces down, of half side `half`.
std::string lamp(double x, double y, double z, double half, double Le) {
    return fmt::format(
        R"(<shape type="rectangle"><transform name="to_world"><scale x="{3}" y="{3}"/><rotate x="1" angle="180"/>
<translate x="{0}" y="{1}" z="{2}"/></transform><bsdf type="diffuse"><rgb name="reflectance" value="0"/></bsdf>
<emitter type="area"><rgb name="radiance" value="{4}"/></emitter></shape>)",
        x, y, z, half, Le);
}

std::string camera(const char* origin, const char* target, double fov) {
    return fmt::format(
        R"(type="perspective"><float name="fov" value="{}"/><transform name="to_world"><lookat origin="{}" target="{}" up="0, 0, 1"/></transform>)",
        fov, origin, target);
}

/// Mean over pixels of the squared bias relative to brightness, from two independent halves, so that noise is not in
/// it.
double squared_bias(const std::vector<double>& a, const std::vector<double>& b, const std::vector<double>& reference) {
    double sum = 0;
    for (std::size_t i = 0; i < a.size(); ++i)
        sum += (a[i] - reference[i]) * (b[i] - reference[i]) / (sqr(reference[i]) + 0.01);
    return sum / double(a.size());
}

// Two chambers, an emitter in one, a wall of 1 mm between them; the camera's near plane removes the ceiling. Floor and
// ceiling on both sides of the wall share light where a cluster extends through it: in a strip as wide as a cluster, so
// the leak falls with the resolution (48 x 48: 2.7 %).
TEST(StabilityLeak, WallOfAMillimetre) {
    const auto scene = testing::load_inline(
        {R"(type="orthographic"><float name="near_clip" value="4.05"/>
<transform name="to_world"><lookat origin="0, 0, 5" target="0, 0, 0" up="0, 1, 0"/></transform>)",
         R"(<shape type="cube"><transform name="to_world"><scale z="0.5"/><translate z="0.5"/></transform>
<boolean name="flip_normals" value="true"/>)" +
             grey + R"(</shape>
<shape type="cube"><transform name="to_world"><scale x="0.0005" z="0.5"/><translate z="0.5"/></transform>)" +
             grey + "</shape>" + lamp(-0.5, 0, 0.99, 0.2, 10),
         192, 192, -1});
    double lit = 0, dark = 0, true_dark = 0;
    const int passes = full_run() ? 16 : 1;
    for (int i = 0; i < passes; ++i) {
        const Pass pass = make_pass(*scene, 40 + std::uint64_t(i), {});
        const double left = mean_of(pass.image, "G", {0, 0, 96, 192}),
                     right = mean_of(pass.image, "G", {96, 0, 192, 192});
        lit += std::max(left, right) / passes;
        dark += std::min(left, right) / passes;
        true_dark +=
            std::min(mean_of(pass.paths, "G", {0, 0, 96, 192}), mean_of(pass.paths, "G", {96, 0, 192, 192})) / passes;
    }
    std::printf("    lit %.4f, dark %.2e: %.3f %% leaks\n", lit, dark, 100 * dark / lit);
    EXPECT_LT(true_dark, 1e-6 * lit);  // the wall is tight
    EXPECT_LT(dark, 0.01 * lit);
    EXPECT_GT(lit, 0.1);
}

// A box 2 mm over the floor: the shadow at its foot is narrower than clusters; smaller ones blur it less.
TEST(StabilityLeak, ContactShadowSharpensWithSmallerClusters) {
    const auto scene = testing::load_inline(
        {camera("0.9, -0.9, 0.5", "0, 0, 0.05", 40),
         R"(<shape type="rectangle"><transform name="to_world"><scale x="2" y="2"/></transform>)" + grey + R"(</shape>
<shape type="cube"><transform name="to_world"><scale x="0.15" y="0.15" z="0.15"/><translate z="0.152"/></transform>)" +
             grey + "</shape>" + lamp(-0.6, 0.6, 1.5, 0.1, 60),
         48, 36, 4});
    const auto reference = reference_of(*scene, full_run() ? 16384 : 2048);
    const int passes = full_run() ? 64 : 12;
    double before = 0;
    for (const std::uint32_t k : {4u, 16u, 64u}) {
        Recipe recipe;
        recipe.k = k;
        MeanImage half[2];
        for (int i = 0; i < passes; ++i) half[i % 2].add(make_pass(*scene, 60 + std::uint64_t(i), recipe).image);
        const double bias2 = squared_bias(half[0].mean(), half[1].mean(), reference);
        std::printf("    K = %u: bias %.4f of the brightness\n", k, std::sqrt(std::max(bias2, 0.0)));
        EXPECT_GT(bias2, before);
        before = bias2;
    }
}

/// A closed box that reflects 0.98, with balls of GGX whose weights f cos / p are far above 1, because normals are
/// sampled without visibility.
std::unique_ptr<Scene> bright_box() {
    std::string balls;
    for (const char* centre : {"0.4, -0.3, -0.6", "-0.3, 0.5, -0.5", "0.5, 0.6, 0.2"})
        balls += fmt::format(R"(<shape type="sphere"><point name="center" value="{}"/><float name="radius" value="0.4"/>
<bsdf type="roughconductor"><float name="alpha" value="0.6"/><string name="distribution" value="ggx"/><string name="material" value="none"/>
<boolean name="sample_visible" value="false"/></bsdf></shape>)",
                             centre);
    return testing::load_inline({camera("-0.9, -0.9, 0.8", "0.3, 0.3, -0.2", 80),
                                 R"(<shape type="cube"><boolean name="flip_normals" value="true"/>
<bsdf type="diffuse"><rgb name="reflectance" value="0.98"/></bsdf></shape>)" +
                                     balls + lamp(0, 0, 0.98, 0.2, 10),
                                 32, 24, -1});
}

TEST(StabilityDivergence, BrightBoxConvergesUnderBothClamps) {
    const auto scene = bright_box();
    for (const refine::Clamp clamp : {refine::Clamp::column, refine::Clamp::cluster})
        for (const refine::Start start : {refine::Start::paths, refine::Start::zero}) {
            Recipe recipe;
            recipe.refine.clamp = clamp;
            recipe.refine.start = start;
            recipe.refine.iterations = full_run() ? 400 : 60;
            for (std::uint64_t seed = 0; seed < (full_run() ? 8u : 2u); ++seed) {
                const Radiance r = make_pass(*scene, 80 + seed, recipe).radiance;
                ASSERT_EQ(int(r.residual.size()), recipe.refine.iterations);
                for (std::size_t i = 1; i < r.residual.size(); ++i)
                    if (r.residual[i - 1] > 1e-6) {
                        EXPECT_LT(r.residual[i], r.residual[i - 1]) << i;
                    }
                for (const float L : r.L) ASSERT_TRUE(std::isfinite(L) && L >= 0);
                EXPECT_GT(r.clamped_share, 0);
                EXPECT_LT(r.clamped_share, 0.05);
                if (seed == 0)
                    std::printf("    %s clamp from %s: residual %.1e, %.3f %% of the energy clamped\n",
                                clamp == refine::Clamp::column ? "column" : "cluster",
                                start == refine::Start::zero ? "darkness" : "paths", r.residual[r.residual.size() - 1],
                                100 * r.clamped_share);
            }
        }
}

// Where vertices of one path share, light that rough glass traps grows without a clamp (see SystemSpectrum). The
// iteration reports it by ending early, with finite values. With clusters that separate a path's vertices it does not
// grow.
TEST(StabilityDivergence, UnclampedGlassIsFoundOut) {
    const auto scene = testing::own_scene("glossy-box.xml", 48, 36, {{"max_depth", "-1"}});
    PathOptions path = testing::path_options(*scene, 11);
    path.max_depth = -1;
    const PathGraph graph = testing::trace_graph(*scene, path, 1);
    PathGraph scattered =
        testing::trace_graph(*scene, path, 1);  // the same, each vertex a path of its own: nothing is separated
    std::vector<std::uint64_t> first(graph.n_vertices() + 1);
    std::iota(first.begin(), first.end(), std::uint64_t{0});
    scattered.paths.first_vertex = std::move(first);
    const Clusters mixed = testing::clusters_of(scattered, 16), apart = testing::clusters_of(graph, 16);
    refine::Options options;
    options.iterations = 400;
    options.clamp = refine::Clamp::none;
    const Radiance growing = testing::radiance_of(graph, mixed, options);
    std::printf("    found out after %zu steps\n", growing.residual.size());
    EXPECT_LT(growing.residual.size(), 400u);
    for (const float L : growing.L) ASSERT_TRUE(std::isfinite(L) && L >= 0);
    const Radiance calm = testing::radiance_of(graph, apart, options);
    ASSERT_EQ(calm.residual.size(), 400u);
    EXPECT_LT(calm.residual[399], 1e-4);
    options.clamp = refine::Clamp::column;
    EXPECT_EQ(testing::radiance_of(graph, mixed, options).residual.size(), 400u);
}

/// A ring of metal on a floor, lit from the side: the caustic is from the ring alone.
std::unique_ptr<Scene> ring_caustic(double alpha) {
    const std::string metal =
        alpha > 0
            ? fmt::format(
                  R"(<bsdf type="twosided"><bsdf type="roughconductor"><float name="alpha" value="{}"/><string name="material" value="Ag"/></bsdf></bsdf>)",
                  alpha)
            : R"(<bsdf type="twosided"><bsdf type="conductor"><string name="material" value="Ag"/></bsdf></bsdf>)";
    std::string ring;
    constexpr int facets = 24;
    for (int i = 0; i < facets; ++i)
        ring += fmt::format(
            R"(<shape type="rectangle"><transform name="to_world"><scale x="0.15" y="{}"/><rotate y="1" angle="-90"/>
<translate x="0.5" z="0.15"/><rotate z="1" angle="{}"/></transform>{}</shape>)",
            0.5 * std::tan(pi_double / facets), 360.0 * i / facets, metal);
    return testing::load_inline(
        {camera("0, -1.2, 1.2", "0, 0, 0", 45),
         R"(<shape type="rectangle"><transform name="to_world"><scale x="2" y="2"/></transform>)" + grey + R"(</shape>
)" + ring + lamp(0.9, 0.3, 1.2, 0.25, 20),
         32, 24, 6});
}

// The criterion: never above path tracing by more than 5 %, at any roughness. Clusters blur the caustic most at alpha
// 0.3, where the blend is at 1.036 over sixteen runs of 16 passes (clusters: 3.5); below 1.2 in the short run, whose
// reference is noisy. Detected mutation: bias accepted only above two standard errors (1.25).
TEST(StabilitySpecular, RingCausticIsNoWorseThanPathTracing) {
    const std::vector<double> alphas =
        full_run() ? std::vector{0.3, 0.2, 0.1, 0.05, 0.03, 0.02, 0.01, 0.0} : std::vector{0.3, 0.0};
    const int runs = full_run() ? 16 : 2;
    for (const double alpha : alphas) {
        const auto scene = ring_caustic(alpha);
        const auto reference = reference_of(*scene, full_run() ? 32768 : 1024);
        Errors sum;
        for (int run = 0; run < runs; ++run) {
            const Errors e = errors_of(*scene, 100 + 50 * std::uint64_t(run), 16, {}, reference);
            sum.blend += e.blend, sum.cluster += e.cluster, sum.paths += e.paths;
        }
        std::printf("    alpha %.2f: error over that of path tracing: blend %.3f, clusters %.3f\n", alpha,
                    sum.blend / sum.paths, sum.cluster / sum.paths);
        EXPECT_LT(sum.blend, (alpha > 0.1 && !full_run() ? 1.2 : 1.05) * sum.paths) << alpha;
    }
}

/// A corner with an emitter close to it: shadow edges and bright spots narrower than a cluster.
std::unique_ptr<Scene> bright_corner() {
    return testing::load_inline(
        {camera("1.2, 1.2, 0.9", "0.2, 0.2, 0.3", 55),
         R"(<shape type="cube"><transform name="to_world"><translate x="1" y="1" z="1"/></transform>
<boolean name="flip_normals" value="true"/>)" +
             grey + "</shape>" + lamp(0.25, 0.25, 0.6, 0.05, 60),
         24, 18, 6});
}

/// Slope of a line through points.
double slope_of(const std::vector<double>& x, const std::vector<double>& y) {
    double mx = 0, my = 0, xy = 0, xx = 0;
    for (std::size_t i = 0; i < x.size(); ++i) mx += x[i] / double(x.size()), my += y[i] / double(x.size());
    for (std::size_t i = 0; i < x.size(); ++i) xy += (x[i] - mx) * (y[i] - my), xx += sqr(x[i] - mx);
    return xy / xx;
}

// Averaging graphs of one sample keeps their blur; graphs with more samples have smaller clusters. With K growing
// slower than the samples the radius goes to 0, and so does the bias. The root mean square error falls nearly as that
// of path tracing (slope -0.41 from 128 to 8,192 samples; noise alone has -0.5) and stays far below it. Detected
// mutation: one sample per pass, as many passes (0.12: larger clusters only blur more).
TEST(StabilityPlateau, PooledPathsAreConsistent) {
    const auto scene = bright_corner();
    const auto reference = reference_of(*scene, full_run() ? 262144 : 16384);
    const std::uint64_t first = full_run() ? 32 : 8, last = full_run() ? 5120 : 128;
    std::vector<double> x, y;
    for (std::uint64_t spp = first; spp <= last; spp *= 4) {
        Recipe recipe;
        recipe.spp = spp;
        recipe.k = std::min(128u, std::uint32_t(std::lround(64 * std::pow(double(spp) / double(first), 0.3))));
        const Errors e = errors_of(*scene, 10000, 4, recipe, reference);
        x.push_back(std::log(double(spp)));
        y.push_back(0.5 * std::log(e.blend));
        std::printf("    4 passes of %4d, K = %3u: clusters %.2e, blend %.2e, paths %.2e\n", int(spp), recipe.k,
                    e.cluster, e.blend, e.paths);
        EXPECT_LT(e.blend, 0.6 * e.paths);
    }
    std::printf("    slope of the root mean square error %.3f\n", slope_of(x, y));
    EXPECT_LE(slope_of(x, y), full_run() ? -0.4 : -0.3);
}

// Passes of one sample, clusters of 64: their blur stays, so the blend must let go of them in time. From few passes on,
// where clusters are far ahead, its error falls slowly until paths catch up, then as theirs does: 0.99 of it at 2048.
TEST(StabilityPlateau, BlendLetsGoOfClusters) {
    const auto scene = bright_corner();
    const auto reference = reference_of(*scene, full_run() ? 131072 : 2048);
    Recipe recipe;
    recipe.k = 64;
    double before = INFINITY;
    for (int passes = 8; passes <= (full_run() ? 2048 : 32); passes *= 4) {
        double blend = 0, cluster = 0, paths = 0;
        const int runs = passes <= 8 ? 2 : 1;
        for (int run = 0; run < runs; ++run) {
            const Errors e = errors_of(*scene, 10000 + 3000 * std::uint64_t(run), passes, recipe, reference);
            blend += e.blend / runs, cluster += e.cluster / runs, paths += e.paths / runs;
        }
        std::printf("    %4d passes: blend %.2e, clusters %.2e, paths %.2e\n", passes, blend, cluster, paths);
        EXPECT_LT(blend, 1.05 * paths);
        EXPECT_LT(blend, before);
        before = blend;
    }
}

// Four times as many vertices per area on one half: no cluster is larger than 2 K, or its cost would go with K^2.
TEST(StabilityCost, DenseVerticesMakeNoLargeClusters) {
    const auto scene = testing::load_inline(
        {camera("0, -6, 1.5", "0, 0, 0", 40),
         R"(<shape type="rectangle"><transform name="to_world"><scale x="10" y="10"/></transform>)" + grey +
             "</shape>" + lamp(0, 0, 3, 1, 5),
         96, 72, 4});
    const PathGraph graph = testing::trace_graph(*scene, testing::path_options(*scene, 3), 2);
    for (const auto method : {cluster::Method::balanced, cluster::Method::centres})
        for (const std::uint32_t k : {4u, 16u, 64u}) {
            cluster::ClusterOptions options;
            options.method = method;
            options.k = k;
            const Clusters c = cluster::make_clusters(graph, options);
            std::uint32_t largest = 0;
            for (std::size_t i = 0; i < c.n_clusters(); ++i) largest = std::max(largest, c.first[i + 1] - c.first[i]);
            EXPECT_LE(largest, 2 * k);
            EXPECT_GT(c.n_clusters(), 10u);
        }
}

}  // namespace
}  // namespace loom
