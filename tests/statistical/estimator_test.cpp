// Estimators against one another, and what the tracer claims about its own noise.
#include <fmt/format.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <cmath>

#include "stages/core/stats/chi_square.h"
#include "stages/gather/gather.h"
#include "tests/statistical/support.h"

namespace loom {
namespace {

std::unique_ptr<Scene> own_scene(const char* name, int width, int height) {
    return load_scene(source_dir() / "scenes" / name,
                      {{"resx", std::to_string(width)}, {"resy", std::to_string(height)}});
}

/// Root mean square difference over the root mean square; the difference itself where all is 0.
double relative_difference(const Image& a, const Image& b, const char* channel) {
    const auto x = a.find(channel), y = b.find(channel);
    double difference = 0, level = 0;
    for (std::size_t i = 0; i < x.size(); ++i) {
        difference += sqr(double(x[i]) - y[i]);
        level += sqr(double(y[i]));
    }
    return std::sqrt(level > 0 ? difference / level : difference);
}

class GraphAgainstImage : public testing::TestWithParam<const char*> {};

// The graph stores all that the tracer used: the image gathered from it is the traced image up to rounding. The
// sharpest lobes (alpha 0.05) amplify rounding to 1e-5, because their value is at a direction in world space converted
// back to the frame. Detected mutations: normals stored after, but used before their rounding; textured reflectance
// stored for materials without texture; pdf stored without roulette.
TEST_P(GraphAgainstImage, GatheredImageEqualsTracedImage) {
    const auto scene = own_scene(GetParam(), 64, 48);
    app::Report report;
    report.set_quiet(true);
    trace::Counts counts;
    const trace::Work work{3, 4, 0};
    const Image traced = trace::render_image(*scene, options_of(*scene), work, report, counts);
    const auto file = std::filesystem::temp_directory_path() / fmt::format("loom-graph-{}.h5", getpid());
    write_path_graph(trace::render_graph(*scene, options_of(*scene), work, report, counts), file, Sync::no);
    const PathGraph graph = read_path_graph(file);  // throws when an invariant does not hold
    std::filesystem::remove(file);                  // the mapping keeps its bytes
    const Image gathered = gather::path_traced_image(graph, 0);
    for (const char* channel : {"R", "G", "B", "Albedo.R", "Albedo.G", "N.X", "Depth.Z", "VarMean.G"})
        EXPECT_LT(relative_difference(gathered, traced, channel), channel[0] == 'V' ? 1e-4 : 3e-5) << channel;
}

TEST_P(GraphAgainstImage, ThreadsDoNotMatter) {
    const auto scene = own_scene(GetParam(), 64, 48);
    app::Report report;
    report.set_quiet(true);
    trace::Counts counts;
    const Image one = trace::render_image(*scene, options_of(*scene), {0, 2, 1}, report, counts);
    const Image two = trace::render_image(*scene, options_of(*scene), {0, 2, 2}, report, counts);
    for (const auto& channel : one.channels) {
        const auto other = two.find(channel.name);
        EXPECT_TRUE(std::equal(other.begin(), other.end(), channel.values.begin())) << channel.name;
    }
}

// Many paths side by side are the paths that the plain tracer follows one by one, with the same vertices. Rays in
// packets may differ from single ones in the last bit, and a tie of two surfaces may fall either way.
TEST_P(GraphAgainstImage, BatchEqualsPathsOneByOne) {
    const auto scene = own_scene(GetParam(), 64, 48);
    const PathOptions options = options_of(*scene);
    PathBatch batch(*scene, options);
    std::vector<PathId> ids;
    for (std::uint64_t pixel = 0; pixel < PathBatch::capacity; ++pixel) ids.push_back({3 * pixel, pixel % 5});
    std::vector<PathResult> results(ids.size()), bare(ids.size());
    PathRecords records;
    batch.trace(ids, results, records);
    batch.trace(ids, bare);
    int differ = 0;
    for (std::size_t i = 0; i < ids.size(); ++i) {
        PathRecords record;
        const PathResult one = trace_path(*scene, options, ids[i], record);
        EXPECT_EQ(bare[i].L, results[i].L);
        const float scale = std::max(max_channel(one.L), 0.01f);
        const Spectrum d = one.L - results[i].L;
        const bool same = std::abs(d.r) <= 1e-3f * scale && std::abs(d.g) <= 1e-3f * scale &&
                          std::abs(d.b) <= 1e-3f * scale && record.paths[0].n_vertices == records.paths[i].n_vertices &&
                          record.paths[0].n_light_edges == records.paths[i].n_light_edges &&
                          one.n_rays == results[i].n_rays;
        differ += !same;
    }
    EXPECT_LE(differ, 2);
}

INSTANTIATE_TEST_SUITE_P(Scenes, GraphAgainstImage,
                         testing::Values("cornell-box.xml", "glossy-box.xml", "all-emitters.xml", "caustic.xml",
                                         "textured.xml", "mask.xml", "environment-map.xml"),
                         [](const auto& info) { return test_name(info.param); });

class SamplersAndRoulettes : public testing::TestWithParam<const char*> {};

// Two samplers and two rules of roulette estimate the same image. Detected mutation: the sobol pairs of light and
// direction share a scramble.
TEST_P(SamplersAndRoulettes, SameImageMeanAndTiles) {
    const auto scene = own_scene(GetParam(), 64, 48);
    PathOptions path = options_of(*scene);
    path.sampler = SamplerKind::independent;
    const Replicates reference = trace_replicates(*scene, path, 32, 32);
    struct Variant {
        SamplerKind sampler;
        Roulette roulette;
        int rr_depth;
    };
    for (const Variant v :
         {Variant{SamplerKind::sobol, Roulette::albedo, 5}, Variant{SamplerKind::sobol, Roulette::throughput, 1},
          Variant{SamplerKind::independent, Roulette::albedo, 1}}) {
        path.sampler = v.sampler;
        path.roulette = v.roulette;
        path.rr_depth = v.rr_depth;
        const Replicates other = trace_replicates(*scene, path, 32, 32);
        const double alpha = sidak_alpha(3 * 4 * 3 * 65);
        for (int c = 0; c < 3; ++c)
            for (int region = 0; region < 65; ++region) {
                const Estimate a = reference.estimate(c, region), b = other.estimate(c, region);
                EXPECT_GE(welch_p_value(a, b), alpha) << fmt::format(
                    "region {} channel {}: {:.6g} +- {:.2g}, {:.6g} +- {:.2g}", region, c, a.mean, a.se, b.mean, b.se);
            }
    }
}

INSTANTIATE_TEST_SUITE_P(Scenes, SamplersAndRoulettes,
                         testing::Values("cornell-box.xml", "glossy-box.xml", "all-emitters.xml",
                                         "environment-map.xml"),
                         [](const auto& info) { return test_name(info.param); });

TEST(Noise, ClaimedVarianceIsTheSpreadBetweenReplicates) {
    const auto scene = own_scene("cornell-box.xml", 48, 48);
    PathOptions path = options_of(*scene);
    path.sampler = SamplerKind::independent;
    const Replicates r = trace_replicates(*scene, path, 32, 32);
    EXPECT_NEAR(r.spread_per_pixel / r.claimed_per_pixel, 1.0, 0.1);
    // Stratified samples have less noise than their stored variance, never more.
    path.sampler = SamplerKind::sobol;
    const Replicates q = trace_replicates(*scene, path, 32, 32);
    EXPECT_LT(q.spread_per_pixel / q.claimed_per_pixel, 1.0);
    std::printf("    independent: spread / claim %.3f; sobol: %.3f\n", r.spread_per_pixel / r.claimed_per_pixel,
                q.spread_per_pixel / q.claimed_per_pixel);
}

TEST(Noise, ErrorFallsWithTheRootOfTheSamples) {
    const auto scene = own_scene("cornell-box.xml", 48, 48);
    app::Report report;
    report.set_quiet(true);
    PathOptions path = options_of(*scene);
    path.sampler = SamplerKind::independent;
    // Slope of log RMS difference of two independent renders over six doublings.
    double sx = 0, sy = 0, sxx = 0, sxy = 0;
    int n = 0;
    for (std::uint64_t spp = 1; spp <= 64; spp *= 2, ++n) {
        trace::Counts counts;
        path.seed = 2 * n;
        const Image a = trace::render_image(*scene, path, {0, spp, 0}, report, counts);
        path.seed = 2 * n + 1;
        const Image b = trace::render_image(*scene, path, {0, spp, 0}, report, counts);
        double sum = 0;
        for (const char* channel : {"R", "G", "B"})
            for (std::size_t i = 0; i < a.n_pixels(); ++i) sum += sqr(double(a.find(channel)[i]) - b.find(channel)[i]);
        const double x = std::log(double(spp)), y = 0.5 * std::log(sum);
        sx += x, sy += y, sxx += x * x, sxy += x * y;
    }
    EXPECT_NEAR((n * sxy - sx * sy) / (n * sxx - sx * sx), -0.5, 0.05);
}

}  // namespace
}  // namespace loom
