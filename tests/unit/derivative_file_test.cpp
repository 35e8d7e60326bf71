// What a file of derivatives with points of lights must hold.
#include <gtest/gtest.h>

#include <functional>

#include "formats/derivative.h"
#include "formats/io/error.h"
#include "tests/traced_graph.h"

namespace loom {
namespace {

std::string complaint_of(const std::function<void()>& f) {
    try {
        f();
    } catch (const InputError& error) {
        return error.what();
    }
    return {};
}

// Detected mutations: each check left out.
TEST(DerivativeFile, PointsOfLightsAreChecked) {
    const auto scene = testing::own_scene("glossy-box.xml", 4, 4, {});
    const PathGraph g = testing::trace_graph(*scene, testing::path_options(*scene, 3), 8);
    const auto file = testing::scratch_file(".h5");
    const auto is_first = [&](std::uint32_t edge) {
        const auto& first = g.paths.first_vertex;
        return std::binary_search(first.begin(), first.end() - 1, g.light_edges.vertex[edge]);
    };
    std::vector<std::uint32_t> firsts, others;
    for (std::uint32_t k = 0; k < g.n_light_edges(); ++k) (is_first(k) ? firsts : others).push_back(k);
    ASSERT_GE(firsts.size(), 3u);
    ASSERT_GE(others.size(), 1u);

    const auto with_edges = [&](const std::vector<std::uint32_t>& edges, std::uint32_t interior) {
        Derivative d;
        d.graph = "0123456789abcdef";
        d.n_light_edges = g.n_light_edges(), d.n_paths = g.n_paths();
        d.parameters.name = {"x"}, d.parameters.unit = {"m"}, d.parameters.value = std::vector<double>{0};
        d.boundary_samples = std::vector<std::uint64_t>(n_boundary_families);
        const std::size_t n = edges.size();
        d.interior = {std::vector<std::uint32_t>{interior}, std::vector<float>(3), std::vector<float>(1)};
        d.light_points = {edges, std::vector<float>(n, 1), std::vector<float>(3 * n), std::vector<float>(3 * n),
                          std::vector<float>(n)};
        return d;
    };
    const auto make_good = [&] { return with_edges({firsts[0], firsts[0], firsts[2]}, firsts[1]); };
    const Derivative good = make_good();
    EXPECT_EQ(good.problem(), "");
    write_derivative(good, file, Sync::no);
    const Derivative read = read_derivative(file);
    EXPECT_EQ(read.light_points.edge[2], firsts[2]);
    const auto refusal = [&](const Derivative& d) {
        return complaint_of([&] { require_derivative_of(g, {"g.h5", d.graph}, d, file); });
    };
    EXPECT_EQ(refusal(read), "");
    EXPECT_NE(refusal(with_edges({others[0]}, firsts[0])).find("the first of no path"), std::string::npos);

    const auto problem = [&](auto&& change) {
        Derivative d = make_good();
        change(d);
        return d.problem();
    };
    EXPECT_NE(with_edges({firsts[0], firsts[1]}, firsts[1]).problem().find("interior/edge, too"), std::string::npos);
    EXPECT_NE(with_edges({firsts[2], firsts[0]}, firsts[1]).problem().find("decreasing"), std::string::npos);
    EXPECT_NE(with_edges({std::uint32_t(g.n_light_edges())}, firsts[1]).problem().find("not below"), std::string::npos);
    EXPECT_NE(problem([](Derivative& d) {
                  d.light_points.to_light = std::vector<float>{1, -1, 1};
              }).find("to_light"),
              std::string::npos);
    EXPECT_NE(problem([](Derivative& d) { d.light_points.L = std::vector<float>(8); }).find("different numbers"),
              std::string::npos);
    EXPECT_NE(problem([](Derivative& d) {
                  d.temporal_bins = {std::vector<double>{0},        std::vector<double>{1},
                                     std::vector<std::uint32_t>{4}, std::vector<std::uint8_t>{1},
                                     std::vector<double>{0},        std::vector<double>{0}};
                  d.temporal.is_exact = std::vector<std::uint8_t>{0};
              }).find("beside light_points"),
              std::string::npos);
    std::filesystem::remove(file);
}

}  // namespace
}  // namespace loom
