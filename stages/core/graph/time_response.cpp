#include "stages/core/graph/time_response.h"

#include <algorithm>

#include "formats/io/error.h"

namespace loom {
namespace {

/// Number of standard deviations beyond which a normal distribution's mass is below double precision.
constexpr double far_sigmas = 8.3;
/// Number of means beyond which an exponential distribution's mass is.
constexpr double far_tails = 37;

double normal_density(double x) {
    return std::exp(-0.5 * x * x) / std::sqrt(2 * pi_double);
}
double normal_cdf(double x) {
    return 0.5 * std::erfc(-x / std::sqrt(2.0));
}

/// normal_cdf(-a) / normal_density(a), where both vanish: Laplace's continued fraction.
double mills_ratio(double a) {
    double f = a;
    for (int k = 60; k >= 1; --k) f = a + k / f;
    return 1 / f;
}

/// exp(v^2 / 2 - u v) normal_cdf(u - v): the exponential term of an exponential Gaussian at u sigmas, v = sigma / tail.
double late_part(double u, double v) {
    const double x = u - v;
    if (x > -6) return std::exp(0.5 * v * v - u * v) * normal_cdf(x);
    return normal_density(u) * mills_ratio(-x);
}

}  // namespace

Pulse Pulse::box(double length) {
    Pulse p;
    p.kind_ = Kind::box;
    p.length_ = p.end_ = length;
    return p;
}

Pulse Pulse::gaussian(double sigma) {
    Pulse p;
    p.kind_ = Kind::gaussian;
    p.length_ = sigma;
    p.begin_ = -far_sigmas * sigma;
    p.end_ = far_sigmas * sigma;
    return p;
}

Pulse Pulse::exponential_gaussian(double sigma, double tail) {
    Pulse p = gaussian(sigma);
    p.kind_ = Kind::exponential_gaussian;
    p.tail_ = tail;
    p.end_ += far_tails * tail;
    return p;
}

Pulse Pulse::table(std::vector<double> at, std::vector<double> power) {
    if (at.size() < 2 || at.size() != power.size()) throw InputError("a pulse needs two points or more");
    Pulse p;
    p.kind_ = Kind::table;
    p.arrived_.assign(1, 0.0);
    for (std::size_t i = 0; i < at.size(); ++i) {
        if (!(power[i] >= 0) || !std::isfinite(power[i]))
            throw InputError("a pulse must have power >= 0 at all of its points");
        if (i == 0) continue;
        if (!(at[i] > at[i - 1])) throw InputError("the points of a pulse must lie one after the other");
        p.arrived_.push_back(p.arrived_.back() + 0.5 * (power[i] + power[i - 1]) * (at[i] - at[i - 1]));
    }
    const double energy = p.arrived_.back();
    if (!(energy > 0)) throw InputError("a pulse must have some power");
    for (double& e : p.arrived_) e /= energy;
    for (double& e : power) e /= energy;
    p.begin_ = at.front();
    p.end_ = at.back();
    p.at_ = std::move(at);
    p.power_ = std::move(power);
    return p;
}

double Pulse::arrived_of_other(double s) const {
    if (kind_ == Kind::delta) return s >= 0 ? 1 : 0;
    if (s <= begin_) return 0;
    if (s >= end_) return 1;
    if (kind_ == Kind::table) {
        const std::size_t i = std::size_t(std::upper_bound(at_.begin(), at_.end(), s) - at_.begin()) - 1;
        const double d = s - at_[i];
        return arrived_[i] + d * (power_[i] + 0.5 * d * (power_[i + 1] - power_[i]) / (at_[i + 1] - at_[i]));
    }
    const double u = s / length_;
    if (kind_ == Kind::gaussian) return normal_cdf(u);
    return std::clamp(normal_cdf(u) - late_part(u, length_ / tail_), 0.0, 1.0);
}

double Pulse::power_of_other(double s) const {
    if (kind_ == Kind::delta || s < begin_ || s > end_) return 0;
    switch (kind_) {
        case Kind::delta:
        case Kind::box:
            break;
        case Kind::gaussian:
            return normal_density(s / length_) / length_;
        case Kind::exponential_gaussian:
            return late_part(s / length_, length_ / tail_) / tail_;
        case Kind::table: {
            if (s == begin_) return 0.5 * power_.front();
            if (s == end_) return 0.5 * power_.back();
            const std::size_t i = std::size_t(std::upper_bound(at_.begin(), at_.end(), s) - at_.begin()) - 1;
            return power_[i] + (s - at_[i]) * (power_[i + 1] - power_[i]) / (at_[i + 1] - at_[i]);
        }
    }
    return 0;
}

double TimeResponse::slope(std::int64_t k, double tof) const {
    if (modulation == Modulation::none && widened > 0)
        return (weight(k, tof + 0.5 * widened) - weight(k, tof - 0.5 * widened)) / widened;
    if (modulation == Modulation::none) {
        const double open = start + double(k) * width;
        const double close = gate == width ? start + double(k + 1) * width : open + gate;
        return power(open - tof) - power(close - tof);
    }
    if (modulation == Modulation::sine)
        return -pi_double * std::sin(2 * pi_double * (tof / period - double(k) / n_bins)) / (n_bins * period);
    // In bins, whose fractional part is common to all of them: kinks of opposite bins cancel exactly.
    const double x = tof / period * n_bins, whole = std::floor(x), n = n_bins;
    const double part = x - whole, ahead = whole - double(k) - n * std::floor((whole - double(k)) / n);
    const double to_middle = 0.5 * n - ahead;
    if ((ahead == 0 && part == 0) || part == to_middle) return 0;
    return (part < to_middle ? -4 : 4) / (n * period);
}

}  // namespace loom
