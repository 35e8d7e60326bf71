#pragma once
// Piecewise-constant densities sampled by inversion. Inversion is monotone in u, so well-distributed samples stay well
// distributed.

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <span>
#include <stdexcept>
#include <vector>

#include "stages/core/math/vector.h"

namespace loom {

/// Cumulative sums of n >= 1 non-negative weights, normalised to 1, in n + 1 numbers, with a guide table of the same
/// length. guide[k] is the last cell that starts at or before k / n, so that a look-up is O(1) on average.
/// throws:  std::logic_error unless the sum is positive and finite
struct CumulativeCells {
    static double fill(std::span<const double> weights, float* cdf, std::uint32_t* guide) {
        const std::size_t n = weights.size();
        double sum = 0;
        bool negative = false;
        for (double w : weights) {
            sum += w;
            negative |= w < 0;
        }
        if (negative || !(sum > 0) || !std::isfinite(sum))
            throw std::logic_error("a distribution needs weights >= 0 with a positive, finite sum");
        double running = 0;
        for (std::size_t i = 0; i < n; ++i) {
            cdf[i] = float(running / sum);
            running += weights[i];
        }
        cdf[n] = 1.0f;
        std::size_t cell = 0;
        for (std::size_t k = 0; k <= n; ++k) {
            while (cell + 1 < n && cdf[cell + 1] <= float(k) / float(n)) ++cell;
            guide[k] = std::uint32_t(cell);
        }
        return sum;
    }

    /// Returns the index in the guide where a look-up begins.
    static std::size_t guide_place(float u, std::size_t n) { return std::min(std::size_t(u * float(n)), n - 1); }

    /// Returns the cell that contains u, searching from the guide's cell i. Replaces u by its relative position in the
    /// cell, again uniform.
    static std::size_t find(const float* cdf, std::size_t n, std::size_t i, float& u) {
        while (i > 0 && cdf[i] > u) --i;
        while (i + 1 < n && cdf[i + 1] <= u) ++i;
        u = std::min((u - cdf[i]) / (cdf[i + 1] - cdf[i]), 0x1.fffffep-1f);
        return i;
    }
};

/// Discrete distribution over n >= 1 non-negative weights with a positive sum.
class Distribution1 {
  public:
    Distribution1() = default;
    explicit Distribution1(std::span<const double> weights) : cdf_(weights.size() + 1), guide_(weights.size() + 1) {
        sum_ = CumulativeCells::fill(weights, cdf_.data(), guide_.data());
    }

    std::size_t size() const { return guide_.empty() ? 0 : guide_.size() - 1; }
    double sum() const { return sum_; }
    float pmf(std::size_t i) const { return cdf_[i + 1] - cdf_[i]; }

    /// Returns an index with probability pmf(index). Replaces u by its relative position in the cell, again uniform.
    std::size_t sample(float& u) const {
        return CumulativeCells::find(cdf_.data(), size(), guide_[CumulativeCells::guide_place(u, size())], u);
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
        : width_(width), height_(height), cdf_((width + 1) * height), guide_((width + 1) * height) {
        std::vector<double> row_sums(height), ones(width, 1.0);
        for (std::size_t y = 0; y < height; ++y) {
            const auto row = weights.subspan(y * width, width);
            for (double w : row) row_sums[y] += w;
            // Keep a row of zero weight valid; it is never chosen.
            CumulativeCells::fill(row_sums[y] > 0 ? row : std::span<const double>(ones), row_start(cdf_, y),
                                  row_start(guide_, y));
        }
        marginal_ = Distribution1(row_sums);
    }

    double sum() const { return marginal_.sum(); }

    /// A look-up in steps; each prefetches the memory that the next one reads. Run each step over a whole batch so that
    /// cache misses overlap.
    struct Search {
        Point2f u;
        std::size_t x = 0, y = 0;
    };
    Search begin(Point2f u) const {
        Search s{u};
        s.y = marginal_.sample(s.u.y);
        __builtin_prefetch(row_start(guide_, s.y) + CumulativeCells::guide_place(u.x, width_));
        return s;
    }
    void guess(Search& s) const {
        s.x = row_start(guide_, s.y)[CumulativeCells::guide_place(s.u.x, width_)];
        __builtin_prefetch(row_start(cdf_, s.y) + s.x);
    }
    Point2f finish(Search& s, float& pdf) const {
        s.x = CumulativeCells::find(row_start(cdf_, s.y), width_, s.x, s.u.x);
        pdf = density(s.x, s.y);
        return {(float(s.x) + s.u.x) / float(width_), (float(s.y) + s.u.y) / float(height_)};
    }

    /// Samples a point.
    /// in:      u in [0,1)^2
    /// out:     point in [0,1)^2 and its density per unit area of the square
    Point2f sample(Point2f u, float& pdf) const {
        Search s = begin(u);
        guess(s);
        return finish(s, pdf);
    }

    /// Evaluate the density in two steps: the cell of a point, whose memory is prefetched, then its density.
    Search cell(Point2f p) const {
        Search s{p, std::min(std::size_t(p.x * float(width_)), width_ - 1),
                 std::min(std::size_t(p.y * float(height_)), height_ - 1)};
        __builtin_prefetch(row_start(cdf_, s.y) + s.x);
        return s;
    }
    float pdf(const Search& cell) const { return density(cell.x, cell.y); }
    float pdf(Point2f p) const { return pdf(cell(p)); }

  private:
    template <class T>
    T* row_start(std::vector<T>& rows, std::size_t y) const {
        return rows.data() + (width_ + 1) * y;
    }
    template <class T>
    const T* row_start(const std::vector<T>& rows, std::size_t y) const {
        return rows.data() + (width_ + 1) * y;
    }
    float density(std::size_t x, std::size_t y) const {
        const float* cdf = row_start(cdf_, y) + x;
        return marginal_.pmf(y) * (cdf[1] - cdf[0]) * float(width_) * float(height_);
    }

    std::size_t width_ = 0, height_ = 0;
    Distribution1 marginal_;
    std::vector<float> cdf_;  // rows concatenated
    std::vector<std::uint32_t> guide_;
};

}  // namespace loom
