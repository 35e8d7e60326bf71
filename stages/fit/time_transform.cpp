#include "stages/fit/time_transform.h"

#include <algorithm>

namespace loom::fit {

TimeTransform::TimeTransform(Loss loss, std::size_t n_bins, std::uint32_t merged)
    : loss_(loss), n_bins_(n_bins), n_merged_((n_bins + merged - 1) / merged), merged_(merged), first_{0} {
    for (std::size_t n = n_merged_; loss == Loss::pyramid && n > 0; n = n > 1 ? (n + 1) / 2 : 0)
        first_.push_back(first_.back() + n);
}

// Every entry of the map is 0 or 1, so that it maps variances of independent bins as well.
void TimeTransform::apply(std::span<const double> bins, std::span<double> values) const {
    std::fill(values.begin(), values.end(), 0.0);
    for (std::size_t k = 0; k < n_bins_; ++k) values[k / merged_] += bins[k];
    if (loss_ == Loss::time_cdf)
        for (std::size_t k = 1; k < n_merged_; ++k) values[k] += values[k - 1];
    if (loss_ == Loss::pyramid)
        for (std::size_t s = 1; s + 1 < first_.size(); ++s)
            for (std::size_t k = first_[s - 1]; k < first_[s]; ++k)
                values[first_[s] + (k - first_[s - 1]) / 2] += values[k];
}

void TimeTransform::adjoint(std::span<const double> values, std::span<double> bins) const {
    std::vector<double> sums(values.begin(), values.end());
    if (loss_ == Loss::time_cdf)
        for (std::size_t k = n_merged_; k-- > 1;) sums[k - 1] += sums[k];
    if (loss_ == Loss::pyramid)
        for (std::size_t s = first_.size() - 2; s > 0; --s)
            for (std::size_t k = first_[s - 1]; k < first_[s]; ++k)
                sums[k] += sums[first_[s] + (k - first_[s - 1]) / 2];
    for (std::size_t k = 0; k < n_bins_; ++k) bins[k] = sums[k / merged_];
}

}  // namespace loom::fit
