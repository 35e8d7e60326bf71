#pragma once
#include <array>
#include <vector>

#include "stages/core/cache/cache_reader.h"

namespace loom {

/// Points of a cache, found by a k-d tree over positions and normals (FLANN), and blended:
///   L = reflectance sum_i w_i E_i / sum_i w_i,   w_i = n_i / (d_i^2 + d_1^2),   d_i^2 = |dp|^2 / s^2 + w^2 |dn|^2
/// over the point nearest to the query, at d_1, and the points nearest to that point, `neighbours` together: searching
/// those of the query itself takes three times as long. n_i is the number of vertices behind a point: clusters at the edges
/// of objects have few, and noise.
class PointCache : public CacheReader {
  public:
    static constexpr std::size_t neighbours = 8;
    /// A query farther from the nearest point than so many times the median distance of held-back vertices is far.
    static constexpr float far_away = 3;

    explicit PointCache(RadianceCache cache);
    ~PointCache() override;

    void answer(std::span<const CacheQuery> queries, std::span<CacheAnswer> answers) const override;

  private:
    /// A point in the space of the metric, in one cache line with its value.
    struct alignas(64) Row {
        std::array<float, 6> place;
        Spectrum E;
        float members;
    };
    struct Index;
    std::unique_ptr<Index> index_;
    std::vector<Row> rows_;                  // [point]
    std::vector<std::uint32_t> neighbours_;  // [point, k] the nearest points, itself first
    std::size_t k_ = 0;
    float inv_length_ = 1, normal_weight_ = 0, far_ = 0;
    bool demodulated_ = false;
};

}  // namespace loom
