#include "formats/radiance_cache.h"

#include <gtest/gtest.h>

#include <limits>

#include "stages/inspect/inspect.h"
#include "tests/formats/field_bytes.h"
#include "tests/formats/tiny_graph.h"
#include "tests/formats/tiny_radiance_cache.h"

namespace loom {
namespace {

using testing::expect_equal;
using testing::file_bytes;
using testing::input_error_of;
using testing::ScratchFolder;
using testing::tiny_grid_cache;
using testing::tiny_point_cache;

TEST(RadianceCacheFile, ReadsBackBitForBit) {
    const ScratchFolder folder;
    write_radiance_cache(tiny_point_cache(), folder / "p.h5");
    expect_equal(tiny_point_cache(), read_radiance_cache(folder / "p.h5"));
    write_radiance_cache(tiny_grid_cache(), folder / "g.h5");
    expect_equal(tiny_grid_cache(), read_radiance_cache(folder / "g.h5"));
}

TEST(RadianceCacheFile, RewritingWhatWasReadGivesEqualBytes) {
    const ScratchFolder folder;
    for (const RadianceCache& cache : {tiny_point_cache(), tiny_grid_cache()}) {
        write_radiance_cache(cache, folder / "a.h5");
        write_radiance_cache(read_radiance_cache(folder / "a.h5"), folder / "b.h5");
        EXPECT_TRUE(file_bytes(folder / "a.h5") == file_bytes(folder / "b.h5"));
    }
}

TEST(RadianceCacheFile, FixturesOfVersion_1_0_Read) {
    expect_equal(tiny_point_cache(), read_radiance_cache("tests/fixtures/radiance_cache_1.0_points.h5"));
    expect_equal(tiny_grid_cache(), read_radiance_cache("tests/fixtures/radiance_cache_1.0_grid.h5"));
}

/// Returns the complaint about a cache after a change, without the name of the file.
template <class Change>
std::string complaint(RadianceCache cache, Change&& change) {
    const ScratchFolder folder;
    const std::string file = folder / "c.h5";
    change(cache);
    write_radiance_cache(cache, file);
    const std::string text = input_error_of([&] { read_radiance_cache(file); }), head = file + ": ";
    return text.starts_with(head) ? text.substr(head.size()) : "does not name the file: " + text;
}

TEST(RadianceCacheFile, BrokenPointsAreRefusedByDataset) {
    const auto of = [](auto change) { return complaint(tiny_point_cache(), change); };
    using C = RadianceCache;
    EXPECT_EQ(of([](C& c) { c.settings.method = "magic"; }), "settings/method: is magic, expected points or grid");
    EXPECT_EQ(of([](C& c) { c.settings.method = "grid"; }),
              "grid/resolution: is absent or empty, but settings/method is grid");
    EXPECT_EQ(of([](C& c) { c.demodulated = 2; }), "demodulated: is 2, expected 0 or 1");
    EXPECT_EQ(of([](C& c) { c.settings.smallest_roughness = -1; }), "settings/smallest_roughness: is negative");
    EXPECT_EQ(of([](C& c) { c.domain.size = 0; }), "domain/size: is not positive");
    EXPECT_EQ(of([](C& c) { c.points.var = Column<float>(); }),
              "points/var: is absent or empty, but settings/method is points");
    EXPECT_EQ(of([](C& c) { c.points = {}; }), "points/p: is absent or empty, but settings/method is points");
    EXPECT_EQ(of([](C& c) { c.metric.normal_weight = -1; }), "metric/normal_weight: is negative");
    EXPECT_EQ(of([](C& c) { c.metric.length_scale = 0; }), "metric/length_scale: is not positive");
    EXPECT_EQ(of([](C& c) { c.metric.median_distance = -1; }), "metric/median_distance: is negative");
    EXPECT_EQ(of([](C& c) { c.points.members = std::vector<std::uint16_t>{1, 0, 2}; }), "points/members: row 1 is 0");
    EXPECT_EQ(of([](C& c) { c.points.var = std::vector<float>{0, 0, 0, 0, -1, 0, 0, 0, 0}; }),
              "points/var: row 1 is negative");
    EXPECT_EQ(of([](C& c) {
                  c.validation.relative_l2 = std::vector<double>{0, -1};
              }),
              "validation/relative_l2: row 1 is negative");
    EXPECT_EQ(of([](C& c) {
                  c.validation.mean_ratio = std::vector<double>{-1, 0};
              }),
              "validation/mean_ratio: row 0 is negative");
}

TEST(RadianceCacheFile, BrokenGridsAreRefusedByDataset) {
    const auto of = [](auto change) { return complaint(tiny_grid_cache(), change); };
    using C = RadianceCache;
    using U = std::vector<std::uint32_t>;
    EXPECT_EQ(of([](C& c) { c.settings.method = "points"; }),
              "points/p: is absent or empty, but settings/method is points");
    EXPECT_EQ(of([](C& c) { c.grid.first = U{1, 8, 24}; }), "grid/first: starts at 1, not at 0");
    EXPECT_EQ(of([](C& c) { c.grid.first = U{0, 8, 25}; }), "grid/first: ends at 25, but there are 24 entries");
    EXPECT_EQ(of([](C& c) { c.grid.first = U{0, 24, 24}; }), "grid/first: does not grow from 24 to 24 at row 2");
    EXPECT_EQ(of([](C& c) {
                  c.grid.first = U{0, 4000000000u, 24};
              }),
              "grid/first: does not grow from 4000000000 to 24 at row 2");
    EXPECT_EQ(of([](C& c) { c.grid.resolution = U{1, 0}; }), "grid/resolution: row 1 is 0");
    EXPECT_EQ(of([](C& c) { c.grid.first = {}; }), "grid/first: is absent, but settings/method is grid");
    EXPECT_EQ(of([](C& c) { c.mlp = {}; }), "mlp/rows: is absent or empty, but settings/method is grid");
    EXPECT_EQ(of([](C& c) { c.mlp.columns = {}; }), "mlp/columns: is absent, but settings/method is grid");
    EXPECT_EQ(of([](C& c) { c.inputs.pop_back(); }), "mlp/columns: row 0 is 5, but there are 4 inputs");
    EXPECT_EQ(of([](C& c) { c.mlp.rows = U{2, 4}; }), "mlp/rows: row 1 is 4, expected 3 (rgb)");
    EXPECT_EQ(of([](C& c) { c.mlp.columns = U{5, 3}; }), "mlp/columns: row 1 is 3, but the layer before has 2 outputs");
    EXPECT_EQ(of([](C& c) { c.mlp.rows = U{0, 3}, c.mlp.columns = U{5, 0}; }), "mlp/rows, mlp/columns: row 0 is 0");
    EXPECT_EQ(of([](C& c) { c.mlp.weight = std::vector<float>(15); }),
              "mlp/weight: has 15 rows, fewer than mlp/rows times mlp/columns");
    EXPECT_EQ(of([](C& c) {
                  c.mlp.rows = U{4000000000u, 3}, c.mlp.columns = U{5, 4000000000u};
              }),
              "mlp/weight: has 16 rows, fewer than mlp/rows times mlp/columns");
    EXPECT_EQ(of([](C& c) { c.mlp.weight = std::vector<float>(17); }),
              "mlp/weight: has 1 rows more than mlp/rows times mlp/columns");
}

// A value that is not finite would spread to every pixel that queries it.
TEST(RadianceCacheFile, NanInAPointIsRefused) {
    RadianceCache cache = tiny_point_cache();
    std::vector<float> E(cache.points.E.begin(), cache.points.E.end());
    E[4] = std::numeric_limits<float>::quiet_NaN();
    cache.points.E = E;
    const ScratchFolder folder;
    testing::write_nonfinite(folder / "c.h5", [&] { write_radiance_cache(cache, folder / "c.h5"); });
    EXPECT_NE(input_error_of([&] { read_radiance_cache(folder / "c.h5"); }).find("points/E: row 1 is NaN or infinite"),
              std::string::npos);
}

TEST(RadianceCacheFile, AGraphIsNoCache) {
    const ScratchFolder folder;
    write_path_graph(testing::tiny_graph(), folder / "g.h5");
    EXPECT_NE(input_error_of([&] {
                  read_radiance_cache(folder / "g.h5");
              }).find("is a path_graph, expected a radiance_cache"),
              std::string::npos);
}

TEST(RadianceCacheFile, TruncatedAnywhere) {
    const ScratchFolder folder;
    write_radiance_cache(tiny_point_cache(), folder / "c.h5");
    const std::string whole = file_bytes(folder / "c.h5");
    for (std::size_t n = 0; n < whole.size(); n += n < 4096 ? 13 : 97) {
        testing::write_bytes(folder / "c.h5", std::string_view(whole).substr(0, n));
        EXPECT_NE(input_error_of([&] { read_radiance_cache(folder / "c.h5"); }), "nothing was thrown") << n;
    }
}

TEST(RadianceCacheFile, InspectPrintsTheErrorByMaterial) {
    const ScratchFolder folder;
    const std::string file = folder / "c.h5";
    write_radiance_cache(tiny_point_cache(), file);
    const std::string text = inspect::text_of(survey_file(file), file);
    EXPECT_NE(text.find("points of 6 vertices of 2 graphs"), std::string::npos) << text;
    EXPECT_NE(text.find("wall: relative L2 0.0625, mean ratio 0.99 (12 vertices held back)"), std::string::npos)
        << text;
    EXPECT_EQ(text.find("floor: relative L2"), std::string::npos) << text;
}

}  // namespace
}  // namespace loom
