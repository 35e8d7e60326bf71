#include "stages/transient/derivative_bins.h"

#include <algorithm>
#include <array>

#include "stages/core/math/vector.h"

namespace loom::transient {
namespace {

std::size_t first_at_least(const Column<std::uint32_t>& keys, std::uint64_t key) {
    return std::size_t(std::lower_bound(keys.begin(), keys.end(), key) - keys.begin());
}

/// Order of families in BoundaryRows: those whose samples are paths come first and together.
int class_of(std::uint8_t family) {
    switch (BoundaryFamily(family)) {
        case BoundaryFamily::primary:
            return 1;
        case BoundaryFamily::edge_light:
            return 2;
        case BoundaryFamily::vertex_light:
        case BoundaryFamily::indirect:
        case BoundaryFamily::joined_light:
            break;
    }
    return 0;
}

}  // namespace

void DerivativeHistogram::clear() {
    for (std::vector<double>* values : {&sum, &square, &mean_of_samples, &var_of_samples})
        std::fill(values->begin(), values->end(), 0.0);
}

RowCursor::RowCursor(const Derivative& derivative, std::size_t path, std::size_t edge)
    : derivative_(derivative),
      interior_(first_at_least(derivative.interior.edge, edge)),
      light_points_(first_at_least(derivative.light_points.edge, edge)),
      seen_(first_at_least(derivative.seen.path, path)) {}

void BoundaryRows::set(const Derivative& derivative, std::size_t first_pixel, std::size_t n) {
    const auto& b = derivative.boundary;
    derivative_ = &derivative;
    order_.clear();
    for (auto* ranges : {&of_paths_, &primary_, &edge_light_}) ranges->assign(n, {});
    std::size_t row = first_at_least(b.pixel, first_pixel);
    const auto key = [&](std::size_t i) { return std::pair(class_of(b.family[i]), b.sample[i]); };
    for (std::size_t i = 0; i < n; ++i) {
        const std::size_t begin = order_.size();
        for (; row < b.pixel.size() && b.pixel[row] == first_pixel + i; ++row) order_.push_back(row);
        std::stable_sort(order_.begin() + std::ptrdiff_t(begin), order_.end(),
                         [&](std::size_t a, std::size_t c) { return key(a) < key(c); });
        std::size_t at = begin;
        int next_class = 0;
        for (auto* ranges : {&of_paths_, &primary_, &edge_light_}) {
            Range& range = (*ranges)[i];
            range.begin = at;
            while (at < order_.size() && class_of(b.family[order_[at]]) == next_class) ++at;
            range.end = at;
            ++next_class;
        }
    }
}

std::span<const std::size_t> BoundaryRows::of_samples(std::size_t pixel, BoundaryFamily family) const {
    const Range& r = (family == BoundaryFamily::primary ? primary_ : edge_light_)[pixel];
    return std::span(order_).subspan(r.begin, r.end - r.begin);
}

DerivativeBinner::DerivativeBinner(const TimeResponse& response, std::size_t n_parameters)
    : response_(response),
      width_(3 * n_parameters),
      sums_(n_columns() * width_),
      dL_(width_),
      L_dopl_(width_),
      is_touched_(n_columns()) {}

void DerivativeBinner::add_boundary(double opl, const float* dL, double scale) {
    for (std::size_t i = 0; i < width_; ++i) dL_[i] = double(dL[i]) * scale;
    add(column(Share::steady), 1);
    if (opl < 0) {
        add(column(Share::never), 1);
        return;
    }
    const auto outside = response_.spread(opl, [&](std::uint32_t k, double w) { add(column(k), w); });
    if (outside.before != 0) add(column(Share::before), outside.before);
    if (outside.after != 0) add(column(Share::after), outside.after);
}

template <class Take>
void DerivativeBinner::drain(Take&& take) {
    for (const std::uint32_t k : touched_) {
        double* values = &sums_[k * width_];
        take(k, values);
        each([&](std::size_t i) { values[i] = 0; });
        is_touched_[k] = 0;
    }
    touched_.clear();
}

void DerivativeBinner::end_path(DerivativeHistogram& pixel) {
    drain([&](std::uint32_t k, const double* values) {
        double* __restrict sum = &pixel.sum[k * width_];
        double* __restrict square = &pixel.square[k * width_];
        each([&](std::size_t i) __attribute__((always_inline)) {
            sum[i] += values[i];
            square[i] += sqr(values[i]);
        });
    });
}

void DerivativeBinner::add_samples(const Derivative& derivative, std::span<const std::size_t> rows, double n_samples,
                                   double weight, bool camera_segment, DerivativeHistogram& pixel) {
    if (rows.empty()) return;
    const auto& b = derivative.boundary;
    total_.resize(sums_.size());
    square_.resize(sums_.size());
    total_touched_.clear();
    for (std::size_t i = 0; i < rows.size(); ++i) {
        add_boundary(boundary_opl(derivative, rows[i], camera_segment), &b.dL[rows[i] * width_], 1);
        if (i + 1 < rows.size() && b.sample[rows[i + 1]] == b.sample[rows[i]]) continue;
        drain([&](std::uint32_t k, const double* values) {
            total_touched_.push_back(k);
            for (std::size_t j = 0; j < width_; ++j) {
                total_[k * width_ + j] += values[j];
                square_[k * width_ + j] += sqr(values[j]);
            }
        });
    }
    // A column touched by several samples is taken once: its sums are 0 from then on.
    for (const std::uint32_t k : total_touched_)
        for (std::size_t i = k * width_; i < (k + 1) * width_; ++i) {
            pixel.mean_of_samples[i] += weight * total_[i];
            if (n_samples > 1)
                pixel.var_of_samples[i] +=
                    sqr(weight) * n_samples / (n_samples - 1) * std::max(square_[i] - sqr(total_[i]) / n_samples, 0.0);
            total_[i] = square_[i] = 0;
        }
}

void DerivativeBinner::add_flux(const Derivative& derivative, std::size_t pixel, std::uint32_t first,
                                std::uint32_t step, double weight, DerivativeHistogram& to) const {
    const auto& t = derivative.temporal;
    const std::uint32_t n = response_.n_bins;
    const auto add = [&](std::uint32_t column, std::size_t row, double sign) {
        for (std::size_t i = 0; i < width_; ++i) {
            to.mean_of_samples[column * width_ + i] += sign * weight * double(t.flux[row * width_ + i]);
            to.var_of_samples[column * width_ + i] += sqr(weight) * double(t.var_mean[row * width_ + i]);
        }
    };
    for (std::size_t row = first_at_least(t.pixel, pixel); row < t.pixel.size() && t.pixel[row] == pixel; ++row) {
        if (t.border[row] < first || (t.border[row] - first) % step != 0) continue;
        const std::uint32_t k = (t.border[row] - first) / step;
        if (k > n) break;
        add(k == n ? n + std::uint32_t(Share::after) : k, row, 1);
        add(k == 0 ? n + std::uint32_t(Share::before) : k - 1, row, -1);
    }
}

}  // namespace loom::transient
