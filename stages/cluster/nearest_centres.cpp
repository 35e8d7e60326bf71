#include "stages/cluster/nearest_centres.h"

#include <flann/algorithms/dist.h>
#include <flann/algorithms/kdtree_single_index.h>

#include <vector>

#include "stages/core/compute/parallel.h"

namespace loom::cluster {
namespace {

flann::Matrix<float> matrix_of(std::span<const Point> points, int dimensions) {
    // FLANN takes no const data but does not write to it.
    auto* data = const_cast<float*>(points[0].x.data());
    return {data, points.size(), std::size_t(dimensions), sizeof(Point)};
}

}  // namespace

void nearest_centres(std::span<const Point> points, std::span<const Point> centres, int dimensions, int threads,
                     std::span<std::uint32_t> nearest) {
    if (points.empty()) return;
    flann::KDTreeSingleIndex<flann::L2_Simple<float>> index(matrix_of(centres, dimensions),
                                                            flann::KDTreeSingleIndexParams(10));
    index.buildIndex();
    flann::SearchParams exact(flann::FLANN_CHECKS_UNLIMITED);
    exact.cores = 1;  // the chunks use all threads
    parallel_chunks(points.size(), 4096, threads, [&](std::uint64_t, std::uint64_t begin, std::uint64_t end) {
        const std::size_t n = end - begin;
        std::vector<std::size_t> rows(n);
        std::vector<float> distances(n);
        flann::Matrix<std::size_t> row_matrix(rows.data(), n, 1);
        flann::Matrix<float> distance_matrix(distances.data(), n, 1);
        index.knnSearch(matrix_of(points.subspan(begin, n), dimensions), row_matrix, distance_matrix, 1, exact);
        for (std::size_t i = 0; i < n; ++i) nearest[begin + i] = std::uint32_t(rows[i]);
    });
}

}  // namespace loom::cluster
