#include "stages/cluster/metric.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include "formats/io/octahedral.h"
#include "stages/cluster/median_splits.h"
#include "stages/core/graph/graph_reader.h"
#include "stages/core/sampling/streams.h"

namespace loom::cluster {
namespace {

/// Returns the rows of a uniformly random rotation from three numbers in [0, 1), by a random unit quaternion.
///                                          [Shoemake1992] "Uniform Random Rotations", Graphics Gems III
std::array<Vector3f, 3> random_rotation(float u1, float u2, float u3) {
    const float a = std::sqrt(1 - u1), b = std::sqrt(u1), two_pi = 6.2831853f;
    const float x = a * std::sin(two_pi * u2), y = a * std::cos(two_pi * u2);
    const float z = b * std::sin(two_pi * u3), w = b * std::cos(two_pi * u3);
    return {Vector3f{1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)},
            Vector3f{2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)},
            Vector3f{2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)}};
}

std::array<Vector3f, 3> random_rotation(std::uint64_t key, float scale) {
    const auto u = [&](std::uint64_t i) { return unit_float(std::uint32_t(mix64(key + i) >> 32)); };
    auto rows = random_rotation(u(0), u(1), u(2));
    for (Vector3f& row : rows) row = row * scale;
    return rows;
}

/// Number of sampled vertices: enough for a median with an error of 1 to 2 percent.
constexpr std::size_t subset_size = 32768;
constexpr std::uint32_t subset_k = 16;

}  // namespace

Metric::Metric(const Pool& pool, float length_scale, float normal_weight, std::uint64_t seed)
    : pool_(pool),
      p_rows_(random_rotation(streams::position_rotation(seed), 1 / length_scale)),
      n_rows_(random_rotation(streams::normal_rotation(seed), normal_weight)),
      length_scale_(length_scale) {
    // Rounding is smallest near the middle of the scene; the exact origin does not matter.
    if (pool.size() == 0) return;
    const auto [graph, row] = pool[0];
    origin_ = Vector3f(loom::position(graph, row));
}

Point Metric::operator()(std::size_t vertex) const {
    const auto [graph, j] = pool_[vertex];
    const Vector3f p = Vector3f(loom::position(graph, j)) - origin_;
    const Vector3f n(facing(shading_normal(graph, j), outgoing(graph, j)));
    return {{dot(p_rows_[0], p), dot(p_rows_[1], p), dot(p_rows_[2], p), dot(n_rows_[0], n), dot(n_rows_[1], n),
             dot(n_rows_[2], n)},
            std::uint32_t(vertex)};
}

std::array<std::int16_t, 2> Metric::geometric_normal(std::size_t vertex) const {
    const auto [graph, j] = pool_[vertex];
    const auto& normals = graph.vertices.ng.empty() ? graph.vertices.ns : graph.vertices.ng;
    const std::array code{normals[2 * j], normals[2 * j + 1]};
    const bool behind = dot(loom::geometric_normal(graph, j), outgoing(graph, j)) < 0;
    return behind ? octahedral_opposite(code[0], code[1]) : code;
}

float typical_radius(const Pool& pool, std::size_t n_sharing, std::uint32_t k) {
    const std::size_t n = pool.size();
    const Metric positions(pool, 1, 0, 0);
    std::vector<Point> points;
    const std::size_t n_tried = std::min(n, subset_size);
    for (std::size_t i = 0; i < n_tried; ++i) {
        const std::size_t j = n <= subset_size ? i : std::size_t(mix64(i) % n);
        if (pool.shares(j)) points.push_back(positions(j));
    }
    if (points.empty()) return 1;
    std::vector<std::uint32_t> sizes;
    split_by_medians(points, {.k = subset_k, .normal_spread = infinite_spread, .seed = 0}, sizes);
    std::vector<double> squares;
    const Point* at = points.data();
    for (const std::uint32_t size : sizes) {
        std::array<double, 3> sum{}, sum2{};
        for (std::uint32_t i = 0; i < size; ++i)
            for (int c = 0; c < 3; ++c) {
                const double d = double(at[i].x[c]) - double(at[0].x[c]);
                sum[c] += d;
                sum2[c] += d * d;
            }
        double variance = 0;
        for (int c = 0; c < 3; ++c) variance += sum2[c] / size - (sum[c] / size) * (sum[c] / size);
        squares.push_back(std::max(variance, 0.0));
        at += size;
    }
    const auto middle = squares.begin() + std::ptrdiff_t(squares.size() / 2);
    std::nth_element(squares.begin(), middle, squares.end());
    const double density = double(points.size()) / double(std::max<std::size_t>(n_sharing, 1));
    const auto radius = float(std::sqrt(*middle * density * double(k) / double(subset_k)));
    return radius > 0 && std::isfinite(radius) ? radius : 1.0f;
}

}  // namespace loom::cluster
