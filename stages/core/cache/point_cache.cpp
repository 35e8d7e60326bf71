#include "stages/core/cache/point_cache.h"

#include <flann/algorithms/dist.h>
#include <flann/algorithms/kdtree_single_index.h>

#include <algorithm>
#include <cmath>

#include "formats/io/octahedral.h"
#include "stages/core/compute/parallel.h"

namespace loom {
namespace {

using Place = std::array<float, 6>;  // in the space of the metric

Place place_of(const Point3f& p, const Normal3f& n, float inv_length, float normal_weight) {
    return {p.x * inv_length,    p.y * inv_length,    p.z * inv_length,
            n.x * normal_weight, n.y * normal_weight, n.z * normal_weight};
}

float distance2(const Place& a, const Place& b) {
    float sum = 0;
    for (std::size_t i = 0; i < a.size(); ++i) sum += sqr(a[i] - b[i]);
    return sum;
}

}  // namespace

struct PointCache::Index {
    std::vector<Place> places;
    flann::KDTreeSingleIndex<flann::L2_Simple<float>> tree;

    explicit Index(std::vector<Place> all)
        : places(std::move(all)), tree(matrix_of(places), flann::KDTreeSingleIndexParams(10)) {
        tree.buildIndex();
    }
    static flann::Matrix<float> matrix_of(std::vector<Place>& places) { return {places[0].data(), places.size(), 6}; }

    /// Finds the k nearest points of each query, the nearest first.
    /// out:     rows  [query, k]
    void nearest(std::vector<Place>& queries, std::size_t k, std::vector<std::size_t>& rows) const {
        rows.resize(queries.size() * k);
        std::vector<float> distances(rows.size());
        flann::Matrix<std::size_t> row_matrix(rows.data(), queries.size(), k);
        flann::Matrix<float> distance_matrix(distances.data(), queries.size(), k);
        flann::SearchParams exact(flann::FLANN_CHECKS_UNLIMITED);
        exact.cores = 1;  // the caller has a thread for each batch
        tree.knnSearch(matrix_of(queries), row_matrix, distance_matrix, k, exact);
    }
};

PointCache::PointCache(RadianceCache cache) : CacheReader(std::move(cache)) {
    const auto& points = cache_.points;
    inv_length_ = 1 / cache_.metric.length_scale;
    normal_weight_ = cache_.metric.normal_weight;
    far_ = cache_.metric.median_distance > 0 ? far_away * cache_.metric.median_distance : INFINITY;
    demodulated_ = cache_.demodulated != 0;
    std::vector<Place> places;
    const std::size_t n = cache_.n_points();
    for (std::size_t i = 0; i < n; ++i) {
        const auto normal = unit_from_octahedral(points.n[2 * i], points.n[2 * i + 1]);
        places.push_back(place_of({points.p[3 * i], points.p[3 * i + 1], points.p[3 * i + 2]},
                                  {normal[0], normal[1], normal[2]}, inv_length_, normal_weight_));
        rows_.push_back(
            {places[i], {points.E[3 * i], points.E[3 * i + 1], points.E[3 * i + 2]}, float(points.members[i])});
    }
    index_ = std::make_unique<Index>(std::move(places));

    // Find the neighbours of each point.
    k_ = std::min(neighbours, n);
    neighbours_.resize(n * k_);
    parallel_chunks(n, 1024, 0, [&](std::uint64_t, std::uint64_t begin, std::uint64_t end) {
        std::vector<Place> queries(index_->places.begin() + std::ptrdiff_t(begin),
                                   index_->places.begin() + std::ptrdiff_t(end));
        std::vector<std::size_t> found;
        index_->nearest(queries, k_, found);
        for (std::size_t i = 0; i < found.size(); ++i) neighbours_[begin * k_ + i] = std::uint32_t(found[i]);
        // Of points at one place any may come first.
        for (std::uint64_t i = begin; i < end; ++i) {
            const auto list = neighbours_.begin() + std::ptrdiff_t(i * k_);
            const auto self = std::find(list, list + std::ptrdiff_t(k_), std::uint32_t(i));
            if (self == list + std::ptrdiff_t(k_))
                *list = std::uint32_t(i);
            else
                std::iter_swap(list, self);
        }
    });
}

PointCache::~PointCache() = default;

void PointCache::answer(std::span<const CacheQuery> queries, std::span<CacheAnswer> answers) const {
    if (queries.empty()) return;
    std::vector<Place> places;
    for (const CacheQuery& query : queries) places.push_back(place_of(query.p, query.n, inv_length_, normal_weight_));
    std::vector<std::size_t> nearest;
    index_->nearest(places, 1, nearest);
    for (std::size_t i = 0; i < queries.size(); ++i) {
        const std::uint32_t* list = &neighbours_[nearest[i] * k_];
        const float first = distance2(places[i], rows_[nearest[i]].place), floor = first + 1e-12f;
        float weights = 0;
        Spectrum sum;
        for (std::size_t m = 0; m < k_; ++m) {
            const Row& row = rows_[list[m]];
            const float w = row.members / (distance2(places[i], row.place) + floor);
            weights += w;
            sum += row.E * w;
        }
        CacheAnswer& answer = answers[i];
        answer.L = sum * (1 / weights);
        if (demodulated_) answer.L *= queries[i].reflectance;
        answer.distance = std::sqrt(first);
        answer.is_far = answer.distance > far_;
    }
}

}  // namespace loom
