#pragma once
// What a loss compares of a histogram: linear functions of its bins.

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

namespace loom::fit {

enum class Loss : std::uint8_t { squares, pyramid, time_cdf };

/// Linear map of the bins of one pixel and channel to the values that a loss compares.
///   squares   sums of `merged` bins each; the last may have fewer
///   pyramid   these, and sums of 2, 4, 8 ... of them, up to all; the loss that the code of [TR] uses and its text does not name
///   time_cdf  running sums of the merged bins: squared differences are those of Cramer's distance, near to the earth
///             mover's distance in time, which grows with how far light has moved even where two histograms do not overlap
class TimeTransform {
  public:
    TimeTransform(Loss loss, std::size_t n_bins, std::uint32_t merged);

    std::size_t n_bins() const { return n_bins_; }
    std::size_t n_values() const { return loss_ == Loss::pyramid ? first_.back() : n_merged_; }
    /// Also maps variances of independent bins to those of the values.
    void apply(std::span<const double> bins, std::span<double> values) const;
    /// Transposed map.
    void adjoint(std::span<const double> values, std::span<double> bins) const;

  private:
    Loss loss_;
    std::size_t n_bins_, n_merged_;
    std::uint32_t merged_;
    std::vector<std::size_t> first_;  // pyramid: of each scale, and the number of all
};

}  // namespace loom::fit
