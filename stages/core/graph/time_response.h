#pragma once
// The correlated importance S_e of a time-resolved sensor: the share of light that each bin records after a time of
// flight, given the pulse of the light and the gate of the bin.   [TR sections 4.1 and 4.2, figure 3]
//
// All times are optical path lengths (m). A bin k is open over [start + k width, start + k width + gate). With P(s) =
// the share of a pulse's energy that has arrived by s after its time of flight,
//   S_e[k](tof) = P(start + k width + gate - tof) - P(start + k width - tof)
// so that bins whose gates tile the time sum to 1, except for light that arrives outside of the window.

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
    double arrived(double s) const;
    /// dP/ds, the power at s; 0 for a delta pulse, whose derivative is no function.
    double power(double s) const;
    /// P is 0 up to `begin` and 1 from `end`, to double precision.
    double begin() const { return begin_; }
    double end() const { return end_; }

    template <int n>
    Dual<n, double> arrived(const Dual<n, double>& s) const {
        return s.chain(arrived(s.value), power(s.value));
    }

  private:
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
    double period = 1;  // with modulation; width is then period / n_bins

    double end() const { return start + n_bins * width; }

    /// Returns S_e[k] for a time of flight. Derivatives with a Dual are exact, except for a delta pulse, where S_e
    /// jumps.
    template <class T>
    T weight(std::int64_t k, const T& tof) const;

    /// Shares that arrive before start and after end(), for light of a given time of flight.
    struct Outside {
        double before = 0, after = 0;
    };
    /// Calls visit(k, S_e[k]) for every bin with S_e > 0.
    template <class Visit>
    Outside spread(double tof, Visit&& visit) const;
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

}  // namespace loom
