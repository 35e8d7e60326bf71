// Run once per version: test_formats --gtest_also_run_disabled_tests --gtest_filter='*WriteFixtures'. A
// fixture is never renewed: it is what that version wrote.

#include <gtest/gtest.h>

#include "tests/formats/tiny_clusters.h"
#include "tests/formats/tiny_graph.h"
#include "tests/formats/tiny_image.h"
#include "tests/formats/tiny_radiance.h"
#include "tests/formats/tiny_radiance_cache.h"

namespace loom {
namespace {

TEST(Fixtures, DISABLED_WriteFixtures) {
    const auto unless_there = [](const std::filesystem::path& path, auto write) {
        if (!std::filesystem::exists(path)) write(path);
    };
    unless_there("tests/fixtures/path_graph_1.0.h5",
                 [](const auto& path) { write_path_graph(testing::tiny_graph(), path); });
    unless_there("tests/fixtures/path_graph_2.0.h5",
                 [](const auto& path) { write_path_graph(testing::tiny_graph_with_own_lobes(), path); });
    unless_there("tests/fixtures/clusters_1.0.h5",
                 [](const auto& path) { write_clusters(testing::tiny_clusters(), path); });
    unless_there("tests/fixtures/radiance_1.0.h5",
                 [](const auto& path) { write_radiance(testing::tiny_radiance(), path); });
    unless_there("tests/fixtures/radiance_cache_1.0_points.h5",
                 [](const auto& path) { write_radiance_cache(testing::tiny_point_cache(), path); });
    unless_there("tests/fixtures/radiance_cache_1.0_grid.h5",
                 [](const auto& path) { write_radiance_cache(testing::tiny_grid_cache(), path); });
    unless_there("tests/fixtures/image_1.0.exr", [](const auto& path) { write_image(testing::tiny_image(), path); });
    unless_there("tests/fixtures/image_1.1.exr", [](const auto& path) { write_image(testing::tiny_sum(), path); });
    unless_there("tests/fixtures/image_1.2.exr", [](const auto& path) { write_image(testing::tiny_residual(), path); });
}

}  // namespace
}  // namespace loom
