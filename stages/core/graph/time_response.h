#pragma once
// The correlated importance S_e of a time-resolved sensor: the share of light that each bin records after a time of
// flight, given the pulse of the light and the gate of the bin.   [TR sections 4.1 and 4.2, figure 3]
//
// All times are optical path lengths (m). A bin k is open over [start + k width, start + k width + gate). With P(s) =
// the share of a pulse's energy that has arrived by s after its time of flight,
//   S_e[k](tof) = P(start + k width + gate - tof) - P(start + k width - tof)
// so that bins whose gates tile the time sum to 1, except for light that arrives outside of the window.

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <string>
#include <vector>

#include "stages/core/math/dual.h"
#include "stages/core/math/vector.h"

namespace loom {

/// Temporal profile of the light, with energy 1.
class Pulse {
  public:
    enum class Kind : std::uint8_t { delta, box, gaussian, exponential_gaussian, table };

    /// All energy at emission.
    static Pulse delta() { return {}; }
    /// Uniform over [0, length] after emission.
    static Pulse box(double length);
    /// Gaussian of standard deviation sigma, centred at emission.
    static Pulse gaussian(double sigma);
    /// A Gaussian of that sigma, delayed by exponentially distributed lengths of mean `tail`: a laser with a
    /// single-photon detector.
    static Pulse exponential_gaussian(double sigma, double tail);
    /// Piecewise linear between the points (at, power), 0 outside of them; power is scaled to energy 1.
    /// throws:  InputError unless `at` increases, power >= 0, and power is not 0 everywhere
    static Pulse table(std::vector<double> at, std::vector<double> power);

    Kind kind() const { return kind_; }
    bool is_delta() const { return kind_ == Kind::delta; }
    /// P(s), from 0 to 1.
    double arrived(double s) const {
        return kind_ == Kind::box ? std::clamp(s / length_, 0.0, 1.0) : arrived_of_other(s);
    }
    /// dP/ds, the power at s, where it jumps the mean of both sides; 0 for a delta pulse, whose derivative is no
    /// function.
    double power(double s) const {
        if (kind_ != Kind::box) return power_of_other(s);
        if (s < begin_ || s > end_) return 0;
        return (s == begin_ || s == end_ ? 0.5 : 1.0) / length_;
    }
    /// P is 0 up to `begin` and 1 from `end`, to double precision.
    double begin() const { return begin_; }
    double end() const { return end_; }

    template <int n>
    Dual<n, double> arrived(const Dual<n, double>& s) const {
        return s.chain(arrived(s.value), power(s.value));
    }

  private:
    double arrived_of_other(double s) const;
    double power_of_other(double s) const;

    Kind kind_ = Kind::delta;
    double length_ = 0, tail_ = 0;  // length or sigma
    double begin_ = 0, end_ = 0;
    std::vector<double> at_, power_, arrived_;  // table only
};

/// Light and sensor modulated with one period instead of pulses and gates. There are n bins; the sensor's modulation of
/// bin k is delayed by k / n of a period.
///   sine    both 1 + cos:               S_e = (1 + cos(2 pi (tof / period - k / n)) / 2) / n
///   square  both on for half a period:  S_e is a triangle over [0, 2 / n]
/// Bins sum to 1 for n >= 2 (sine) and for even n (square).
enum class Modulation : std::uint8_t { none, sine, square };

/// S_e of all bins.
struct TimeResponse {
    std::uint32_t n_bins = 1;
    double start = 0, width = 1;  // start of the first gate, and distance between gates
    double gate = 1;              // length of a gate
    Pulse pulse;
    Modulation modulation = Modulation::none;
    double period = 1;   // with modulation; width is then period / n_bins
    double widened = 0;  // m over which slopes are averaged; 0: exact slopes, of a delta pulse over a bin

    double end() const { return start + n_bins * width; }

    /// Returns S_e[k] for a time of flight. Derivatives with a Dual are exact, except for a delta pulse, where S_e
    /// jumps.
    template <class T>
    T weight(std::int64_t k, const T& tof) const;
    /// Returns dS_e[k] / dtof (1/m), where it jumps the mean of both sides. For a delta pulse, where S_e itself jumps,
    /// that of a box pulse as long as the distance between bins and centred at emission. With `widened`, the mean over
    /// an interval of this length around tof: (S_e[k](tof + widened/2) - S_e[k](tof - widened/2)) / widened.
    double slope(std::int64_t k, double tof) const;

    /// Shares that arrive before start and after end(), for light of a given time of flight.
    struct Outside {
        double before = 0, after = 0;
    };
    /// Calls visit(k, S_e[k]) for every bin with S_e > 0.
    template <class Visit>
    Outside spread(double tof, Visit&& visit) const;

    struct SlopedOutside : Outside {
        double before_slope = 0, after_slope = 0;
    };
    /// Calls visit(k, S_e[k], dS_e[k] / dtof) for every bin where one of them is not 0, with `widened` several times for
    /// some bins: sums count. Shares are those of spread(), to the bit. With gates that tile the time, all slopes sum to 0
    /// up to rounding.
    template <class Visit>
    SlopedOutside spread_with_slopes(double tof, Visit&& visit) const;

  private:
    /// Power of the pulse, or of the box that replaces a delta pulse.
    double power(double s) const {
        if (!pulse.is_delta()) return pulse.power(s);
        const double edge = 0.5 * width, distance = std::abs(s);
        return distance < edge ? 1 / width : distance == edge ? 0.5 / width : 0;
    }
};

template <class T>
T TimeResponse::weight(std::int64_t k, const T& tof) const {
    using std::cos, std::floor;
    if (modulation != Modulation::none) {
        const T phase = tof / period - double(k) / n_bins;
        if (modulation == Modulation::sine) return (1.0 + 0.5 * cos(2 * pi_double * phase)) / double(n_bins);
        double whole;
        if constexpr (std::is_same_v<T, double>)
            whole = floor(phase);
        else
            whole = floor(phase.value);
        const T part = phase - whole;
        return select(part < 0.5, 1.0 - 2.0 * part, 2.0 * part - 1.0) * (2.0 / n_bins);
    }
    const double open = start + double(k) * width;
    if (pulse.is_delta()) {
        // The same rule for bins and for Outside, so that a length on a border counts once.
        double x;
        if constexpr (std::is_same_v<T, double>)
            x = (tof - start) / width;
        else
            x = (tof.value - start) / width;
        return T(double(k) <= floor(x) && double(k) > floor(x - gate / width) ? 1.0 : 0.0);
    }
    return pulse.arrived(open + gate - tof) - pulse.arrived(open - tof);
}

template <class Visit>
TimeResponse::Outside TimeResponse::spread(double tof, Visit&& visit) const {
    if (modulation != Modulation::none) {
        for (std::uint32_t k = 0; k < n_bins; ++k) visit(k, weight(k, tof));
        return {};
    }
    const double x = (tof - start) / width, g = gate / width;
    // The first bin whose gate closes after the pulse begins, and the last whose gate opens before the pulse ends.
    const double first = std::max(std::floor(x + pulse.begin() / width - g) + 1, 0.0);
    const double last = std::min(std::floor(x + pulse.end() / width), double(n_bins) - 1);
    if (pulse.is_delta()) {
        for (double k = first; k <= last; ++k) visit(std::uint32_t(k), 1.0);
        return {x < 0 ? 1.0 : 0.0, std::floor(x) >= n_bins ? 1.0 : 0.0};
    }
    if (gate == width) {
        if (first <= last) {
            double below = pulse.arrived(start + first * width - tof);
            for (double k = first; k <= last; ++k) {
                const double above = pulse.arrived(start + (k + 1) * width - tof);
                if (above > below) visit(std::uint32_t(k), above - below);
                below = above;
            }
        }
    } else {
        for (double k = first; k <= last; ++k)
            if (const double w = weight(std::int64_t(k), tof); w > 0) visit(std::uint32_t(k), w);
    }
    return {pulse.arrived(start - tof), 1 - pulse.arrived(end() - tof)};
}

template <class Visit>
TimeResponse::SlopedOutside TimeResponse::spread_with_slopes(double tof, Visit&& visit) const {
    if (modulation != Modulation::none) {
        for (std::uint32_t k = 0; k < n_bins; ++k) visit(k, weight(k, tof), slope(k, tof));
        return {};
    }
    if (widened > 0) {
        const Outside at = spread(tof, [&](std::uint32_t k, double w) { visit(k, w, 0.0); });
        const Outside later =
            spread(tof + 0.5 * widened, [&](std::uint32_t k, double w) { visit(k, 0.0, w / widened); });
        const Outside earlier =
            spread(tof - 0.5 * widened, [&](std::uint32_t k, double w) { visit(k, 0.0, -w / widened); });
        return {at, (later.before - earlier.before) / widened, (later.after - earlier.after) / widened};
    }
    const double x = (tof - start) / width, g = gate / width, last_bin = double(n_bins) - 1;
    // Bins with a weight, as in spread().
    const double first = std::max(std::floor(x + pulse.begin() / width - g) + 1, 0.0);
    const double last = std::min(std::floor(x + pulse.end() / width), last_bin);
    // Bins with a slope: also those whose gate touches an end of the pulse.
    const bool is_delta = pulse.is_delta();
    const double begin = is_delta ? -0.5 * width : pulse.begin(), end_of_pulse = is_delta ? 0.5 * width : pulse.end();
    const double from = std::max(std::floor(x + begin / width - g), 0.0);
    const double to = std::min(std::floor(x + end_of_pulse / width) + 1, last_bin);

    const bool tiles = gate == width;
    const auto arrived = [&](double s) { return is_delta ? 0.0 : pulse.arrived(s); };
    double below = tiles && first <= last ? arrived(start + first * width - tof) : 0;
    double rise = tiles && from <= to ? power(start + from * width - tof) : 0;
    for (double k = from; k <= to; ++k) {
        const double open = start + k * width - tof;
        // One value for the border of two bins, so that their slopes cancel exactly.
        const double close = tiles ? start + (k + 1) * width - tof : start + k * width + gate - tof;
        if (!tiles) rise = power(open);
        const double fall = power(close);
        double w = 0;
        if (k >= first && k <= last) {
            if (is_delta) {
                w = 1;
            } else {
                if (!tiles) below = arrived(open);
                const double above = arrived(close);
                w = std::max(above - below, 0.0);
                below = above;
            }
        }
        if (w > 0 || rise != fall) visit(std::uint32_t(k), w, rise - fall);
        rise = fall;
    }
    const double before_slope = -power(start - tof), after_slope = power(end() - tof);
    if (is_delta) return {{x < 0 ? 1.0 : 0.0, std::floor(x) >= n_bins ? 1.0 : 0.0}, before_slope, after_slope};
    return {{pulse.arrived(start - tof), 1 - pulse.arrived(end() - tof)}, before_slope, after_slope};
}

}  // namespace loom
