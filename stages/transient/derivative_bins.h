#pragma once
// Bins the rows of a derivative: the derivative of each bin of the histogram of a pixel, with its variance.

#include <algorithm>
#include <cstdint>
#include <span>
#include <utility>
#include <vector>

#include "formats/derivative.h"
#include "formats/path_graph.h"
#include "stages/core/graph/time_response.h"
#include "stages/core/math/vector.h"

namespace loom::transient {

/// Columns of a histogram beside its bins.
enum class Share : std::uint8_t { before, after, never, steady };
inline constexpr std::uint32_t n_shares = 4;

/// Derivatives of the histogram of one pixel, by all parameters.
///   mean = sum / n_paths + mean_of_samples
class DerivativeHistogram {
  public:
    /// in:      columns         bins and shares
    ///          width           numbers of a column, 3 per parameter
    ///          has_own_samples  boundary samples that belong to no path
    DerivativeHistogram(std::size_t columns, std::size_t width, bool has_own_samples)
        : sum(columns * width),
          square(columns * width),
          mean_of_samples(has_own_samples ? columns * width : 0),
          var_of_samples(mean_of_samples.size()) {}
    void clear();

    std::vector<double> sum, square;                      // over paths   [column, parameter, rgb]
    std::vector<double> mean_of_samples, var_of_samples;  // of samples that belong to no path; var: of their mean
};

/// Derivative rows of consecutive paths of one graph, in the order in which the paths are walked.
class RowCursor {
  public:
    static constexpr std::size_t none = ~std::size_t{0};

    /// in:  path, edge  first path of the walk, and its first light edge
    RowCursor(const Derivative& derivative, std::size_t path, std::size_t edge);

    /// Returns the row of interior of a light edge, or none.
    /// needs:   edges in increasing order
    std::size_t interior(std::size_t edge) { return take(derivative_.interior.edge, edge, interior_); }
    /// Returns the first row of light_points of a light edge, and how many it has.
    /// needs:   edges in increasing order
    std::pair<std::size_t, std::size_t> light_points(std::size_t edge) {
        const Column<std::uint32_t>& keys = derivative_.light_points.edge;
        const std::size_t first = light_points_;
        while (light_points_ < keys.size() && keys[light_points_] == edge) ++light_points_;
        return {first, light_points_ - first};
    }
    /// Returns the row of seen of a path, or none.
    /// needs:   paths in increasing order
    std::size_t seen(std::size_t path) { return take(derivative_.seen.path, path, seen_); }

  private:
    static std::size_t take(const Column<std::uint32_t>& keys, std::size_t key, std::size_t& next) {
        return next < keys.size() && keys[next] == key ? next++ : none;
    }
    const Derivative& derivative_;
    std::size_t interior_, light_points_, seen_;
};

/// Boundary rows of the pixels of a chunk, sorted by path or sample.
class BoundaryRows {
  public:
    /// Collects the rows of neighbouring pixels.
    void set(const Derivative& derivative, std::size_t first_pixel, std::size_t n);
    /// Calls visit(row) for each row that belongs to a path.
    /// in:      pixel  offset in the chunk
    /// needs:   paths of a pixel in increasing order
    template <class Visit>
    void take_path(std::size_t pixel, std::uint64_t path, Visit&& visit) {
        Range& r = of_paths_[pixel];
        for (; r.begin < r.end && derivative_->boundary.sample[order_[r.begin]] == path; ++r.begin)
            visit(order_[r.begin]);
    }
    /// Returns the rows of a pixel and a family whose samples are no paths, sorted by sample.
    std::span<const std::size_t> of_samples(std::size_t pixel, BoundaryFamily family) const;

  private:
    struct Range {
        std::size_t begin = 0, end = 0;
    };
    const Derivative* derivative_ = nullptr;
    std::vector<std::size_t> order_;  // rows by pixel, then class (paths, primary, edge-light), then sample
    std::vector<Range> of_paths_, primary_, edge_light_;  // [pixel] into order_
};

/// Length of flight of a boundary row; negative: its light never arrives.
/// in:      camera_segment  whether the segment from the camera counts
inline double boundary_opl(const Derivative& derivative, std::size_t row, bool camera_segment) {
    const double opl = derivative.boundary.opl[row];
    if (opl < 0 || camera_segment) return opl;
    return std::max(opl - derivative.boundary.camera_opl[row], 0.0);
}

/// Derivatives of lengths from the first vertex, for a film on which the segment from the camera does not count.
class LengthsFromFirst {
  public:
    explicit LengthsFromFirst(std::size_t n_parameters) : none_(3 * n_parameters), relative_(n_parameters) {}

    /// Starts a path.
    /// in:      dopl  derivative of the segment from the camera, by parameter; null: it stays
    void start(const float* dopl) { camera_ = dopl; }
    bool camera_moves() const { return camera_ != nullptr; }
    /// Returns the derivative of a length without that of the camera's segment.
    /// in:      dopl  null: the length from the camera stays
    const float* operator()(const float* dopl) {
        if (!camera_) return dopl;
        for (std::size_t p = 0; p < relative_.size(); ++p) relative_[p] = (dopl ? dopl[p] : 0) - camera_[p];
        return relative_.data();
    }
    /// Derivatives of light that stays.  [parameter, rgb]
    const float* none() const { return none_.data(); }

  private:
    const float* camera_ = nullptr;
    std::vector<float> none_, relative_;
};

/// Sums derivatives of the current path or boundary sample over bins, for one thread.
class DerivativeBinner {
  public:
    DerivativeBinner(const TimeResponse& response, std::size_t n_parameters);

    std::size_t n_columns() const { return response_.n_bins + n_shares; }
    std::size_t width() const { return width_; }

    /// Adds a light of the path and its derivatives, and calls on_bin(k, S_e[k]) for the light itself.
    ///   d[k] += L' S_e[k] + L S_e[k]' opl'
    /// in:      dL     [parameter, rgb]
    ///          dopl   [parameter]
    ///          opl    infinite: light without an arrival time
    template <class OnBin>
    TimeResponse::Outside add_light(const Rgb<double>& L, double opl, const float* dL, const float* dopl,
                                    OnBin&& on_bin);
    /// Adds light that appears at a boundary; its length is fixed.
    /// in:      scale  factor on dL
    void add_boundary(double opl, const float* dL, double scale);

    /// Ends a path: adds its sums and their squares to the pixel.
    void end_path(DerivativeHistogram& pixel);
    /// Adds the boundary samples of one family that belong to no path to the pixel.
    ///   X_s = sum over rows of sample s,   mean = w sum X_s,   var = w^2 N / (N - 1) (sum X_s^2 - (sum X_s)^2 / N)
    /// in:      rows    sorted by sample
    ///          weight  w, share of the graph in all samples per pixel
    ///          camera_segment  whether the segment from the camera counts
    void add_samples(const Derivative& derivative, std::span<const std::size_t> rows, double n_samples, double weight,
                     bool camera_segment, DerivativeHistogram& pixel);
    /// Adds what temporal rows move over the borders of the bins to a pixel. Variances of both borders add up, which is
    /// too much where the same paths cross both.
    /// in:      first, step  border k of these bins is border first + k step of the rows
    void add_flux(const Derivative& derivative, std::size_t pixel, std::uint32_t first, std::uint32_t step,
                  double weight, DerivativeHistogram& to) const;

  private:
    double* column(std::uint32_t k) {
        if (!is_touched_[k]) is_touched_[k] = 1, touched_.push_back(k);
        return &sums_[k * width_];
    }
    double* column(Share share) { return column(response_.n_bins + std::uint32_t(share)); }
    /// Calls body(i) for the numbers of a column, in a loop of known length for up to three parameters.
    template <class Body>
    [[gnu::always_inline]] void each(Body&& body) const {
        const auto loop = [&](std::size_t n) __attribute__((always_inline)) {
            for (std::size_t i = 0; i < n; ++i) body(i);
        };
        switch (width_) {
            case 3:
                return loop(3);
            case 6:
                return loop(6);
            case 9:
                return loop(9);
            default:
                return loop(width_);
        }
    }
    void add(double* __restrict to, double weight) const {
        const double* __restrict dL = dL_.data();
        each([&](std::size_t i) __attribute__((always_inline)) { to[i] += dL[i] * weight; });
    }
    void add(double* __restrict to, double weight, double slope) const {
        const double* __restrict dL = dL_.data();
        const double* __restrict L_dopl = L_dopl_.data();
        each([&](std::size_t i) __attribute__((always_inline)) { to[i] += dL[i] * weight + L_dopl[i] * slope; });
    }
    /// Calls take(column index) for each touched column, and clears it.
    template <class Take>
    void drain(Take&& take);

    const TimeResponse& response_;
    std::size_t width_;
    std::vector<double> sums_;         // [column, parameter, rgb]
    std::vector<double> dL_, L_dopl_;  // [parameter, rgb] of the light in work
    std::vector<std::uint8_t> is_touched_;
    std::vector<std::uint32_t> touched_;
    std::vector<double> total_, square_;  // over samples of a family, allocated when first needed
    std::vector<std::uint32_t> total_touched_;
};

template <class OnBin>
TimeResponse::Outside DerivativeBinner::add_light(const Rgb<double>& L, double opl, const float* dL, const float* dopl,
                                                  OnBin&& on_bin) {
    bool moves = false;
    for (std::size_t p = 0, i = 0; i < width_; ++p) {
        moves = moves || dopl[p] != 0;
        for (int c = 0; c < 3; ++c, ++i) {
            dL_[i] = dL[i];
            L_dopl_[i] = L[c] * double(dopl[p]);
        }
    }
    add(column(Share::steady), 1);
    if (std::isinf(opl)) {
        add(column(Share::never), 1);
        return {};
    }
    if (!moves) {
        const auto outside = response_.spread(opl, [&](std::uint32_t k, double w) {
            on_bin(k, w);
            add(column(k), w);
        });
        if (outside.before != 0) add(column(Share::before), outside.before);
        if (outside.after != 0) add(column(Share::after), outside.after);
        return outside;
    }
    const auto outside = response_.spread_with_slopes(opl, [&](std::uint32_t k, double w, double slope) {
        if (w > 0) on_bin(k, w);
        add(column(k), w, slope);
    });
    if (outside.before != 0 || outside.before_slope != 0)
        add(column(Share::before), outside.before, outside.before_slope);
    if (outside.after != 0 || outside.after_slope != 0) add(column(Share::after), outside.after, outside.after_slope);
    return outside;
}

}  // namespace loom::transient
