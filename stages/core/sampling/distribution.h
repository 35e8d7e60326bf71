#pragma once
// Piecewise-constant densities sampled by inversion: monotone in u, so that well-spread random numbers
// stay well spread.

#include <algorithm>
#include <cstddef>
#include <span>
#include <vector>

#include "stages/core/math/vector.h"

namespace loom {

/// Discrete distribution over n >= 1 non-negative weights with a positive sum.
class Distribution1 {
  public:
    Distribution1() = default;
    explicit Distribution1(std::span<const double> weights) : cdf_(weights.size() + 1) {
        double sum = 0;
        for (double w : weights) sum += w;
        double running = 0;
        for (std::size_t i = 0; i < weights.size(); ++i) {
            cdf_[i] = float(running / sum);
            running += weights[i];
        }
        cdf_.back() = 1.0f;
        sum_ = sum;
        // guide_[k]: the last cell that starts at or before k / n, so that a look-up is O(1) on average.
        const std::size_t n = weights.size();
        guide_.resize(n + 1);
        std::size_t cell = 0;
        for (std::size_t k = 0; k <= n; ++k) {
            while (cell + 1 < n && cdf_[cell + 1] <= float(k) / float(n)) ++cell;
            guide_[k] = std::uint32_t(cell);
        }
    }

    std::size_t size() const { return guide_.empty() ? 0 : guide_.size() - 1; }
    double sum() const { return sum_; }
    float pmf(std::size_t i) const { return cdf_[i + 1] - cdf_[i]; }

    /// Index with probability pmf(index); u is replaced by its place inside the cell, again uniform.
    std::size_t sample(float& u) const {
        const std::size_t n = size();
        std::size_t i = guide_[std::min(std::size_t(u * float(n)), n - 1)];
        while (i > 0 && cdf_[i] > u) --i;
        while (i + 1 < n && cdf_[i + 1] <= u) ++i;
        u = std::min((u - cdf_[i]) / (cdf_[i + 1] - cdf_[i]), 0x1.fffffep-1f);
        return i;
    }

  private:
    std::vector<float> cdf_;
    std::vector<std::uint32_t> guide_;
    double sum_ = 0;
};

/// Density over [0,1)^2, constant on each of width x height cells (row by row).
class Distribution2 {
  public:
    Distribution2() = default;
    Distribution2(std::span<const double> weights, std::size_t width, std::size_t height)
        : width_(width), height_(height) {
        std::vector<double> row_sums(height);
        rows_.reserve(height);
        for (std::size_t y = 0; y < height; ++y) {
            std::vector<double> row(weights.begin() + y * width, weights.begin() + (y + 1) * width);
            double sum = 0;
            for (double w : row) sum += w;
            if (sum <= 0) std::fill(row.begin(), row.end(), 1.0);  // never chosen; keeps the row valid
            rows_.emplace_back(row);
            row_sums[y] = sum;
        }
        marginal_ = Distribution1(row_sums);
    }

    double sum() const { return marginal_.sum(); }

    /// in: u in [0,1)^2; out: point in [0,1)^2 and its density per unit of the square.
    Point2f sample(Point2f u, float& pdf) const {
        const std::size_t y = marginal_.sample(u.y);
        const std::size_t x = rows_[y].sample(u.x);
        pdf = density(x, y);
        return {(float(x) + u.x) / float(width_), (float(y) + u.y) / float(height_)};
    }

    float pdf(Point2f p) const {
        return density(std::min(std::size_t(p.x * float(width_)), width_ - 1),
                       std::min(std::size_t(p.y * float(height_)), height_ - 1));
    }

  private:
    float density(std::size_t x, std::size_t y) const {
        return marginal_.pmf(y) * rows_[y].pmf(x) * float(width_) * float(height_);
    }

    std::size_t width_ = 0, height_ = 0;
    Distribution1 marginal_;
    std::vector<Distribution1> rows_;
};

}  // namespace loom
