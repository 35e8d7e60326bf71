// S_e against quadrature, its derivatives against differences, its energy.
#include "stages/core/graph/time_response.h"

#include <fmt/format.h>
#include <gtest/gtest.h>

#include <cmath>

#include "formats/io/error.h"

namespace loom {
namespace {

struct NamedPulse {
    const char* name;
    Pulse pulse;
};

std::vector<NamedPulse> smooth_pulses() {
    return {{"box", Pulse::box(0.7)},
            {"gaussian", Pulse::gaussian(0.3)},
            {"expgauss", Pulse::exponential_gaussian(0.2, 0.5)},
            {"expgauss, long tail", Pulse::exponential_gaussian(0.02, 2)},
            {"expgauss, short tail", Pulse::exponential_gaussian(0.5, 0.01)},
            {"table", Pulse::table({-0.5, 0.1, 0.4, 2}, {0, 3, 1, 0.5})}};
}

/// Composite Simpson rule over n even intervals; the integrands jump or bend at multiples of the pieces only.
template <class F>
double integral(F f, double a, double b, int n = 20000) {
    const double h = (b - a) / n;
    double sum = f(a) + f(b);
    for (int i = 1; i < n; ++i) sum += f(a + i * h) * (i % 2 == 1 ? 4 : 2);
    return sum * h / 3;
}

// Detected mutation: exp(v^2 - u v) instead of exp(v^2 / 2 - u v) in the tail's part.
TEST(TimeResponse, ArrivedIsTheIntegralOfPower) {
    for (const auto& [name, pulse] : smooth_pulses()) {
        SCOPED_TRACE(name);
        for (const double s : {-0.4, -0.01, 0.05, 0.3, 0.69, 1.5, 3.0}) {
            double sum = 0;  // in pieces, so that no discontinuity or kink lies inside
            double from = pulse.begin();
            for (const double to : {-0.5, 0.0, 0.1, 0.4, 0.7, 2.0, s})
                if (to > from && to <= s && to <= pulse.end()) {
                    const double inset = 1e-12;
                    sum += integral([&](double x) { return pulse.power(x); }, from + inset, to - inset);
                    from = to;
                }
            if (s > from && from < pulse.end())
                sum += integral([&](double x) { return pulse.power(x); }, from, std::min(s, pulse.end()));
            EXPECT_NEAR(pulse.arrived(s), sum, 2e-8) << s;
        }
        EXPECT_EQ(pulse.arrived(pulse.begin() - 1e-9), 0);
        EXPECT_EQ(pulse.arrived(pulse.end() + 1e-9), 1);
        EXPECT_NEAR(pulse.arrived(pulse.begin() + 1e-12), 0, 1e-11);
        EXPECT_NEAR(pulse.arrived(pulse.end() - 1e-12), 1, 1e-11);
    }
}

// Far out on the rising side both factors of the exponential Gaussian leave the range of a double; their product does
// not.
TEST(TimeResponse, ExponentialGaussianIsTameWhereItsFactorsAreNot) {
    const Pulse pulse = Pulse::exponential_gaussian(1, 0.01);  // exp(v^2 / 2) = exp(5000)
    const Pulse gaussian = Pulse::gaussian(1);
    for (double s = -8; s < 8; s += 0.25) {
        ASSERT_TRUE(std::isfinite(pulse.power(s)));
        EXPECT_NEAR(pulse.power(s), gaussian.power(s - 0.01), 1e-4) << s;  // the tail is a delay of 0.01
        EXPECT_NEAR(pulse.arrived(s), gaussian.arrived(s - 0.01), 1e-4) << s;
    }
}

/// f(k, tof) for each response.
std::vector<std::pair<std::string, TimeResponse>> responses() {
    std::vector<std::pair<std::string, TimeResponse>> all;
    for (const auto& [name, pulse] : smooth_pulses()) {
        all.push_back({name, {24, 1.5, 0.25, 0.25, pulse, {}, 1}});
        all.push_back({std::string(name) + ", long gate", {24, 1.5, 0.25, 0.6, pulse, {}, 1}});
    }
    all.push_back({"sine", {6, 0, 0.5, 0.5, Pulse::delta(), Modulation::sine, 3}});
    all.push_back({"square", {6, 0, 0.5, 0.5, Pulse::delta(), Modulation::square, 3}});
    return all;
}

TEST(TimeResponse, WeightIsPulseTimesGateByQuadrature) {
    for (const auto& [name, r] : responses()) {
        if (r.modulation != Modulation::none) continue;
        SCOPED_TRACE(name);
        // S_e[k] = integral over the gate of the power that arrives then.
        for (const double tof : {1.31, 1.93, 2.777, 4.2})
            for (const std::uint32_t k : {0u, 1u, 4u, 11u}) {
                const double open = r.start + k * r.width;
                std::vector<double> cuts{open, open + r.gate};
                for (const double bend : {-0.5, 0.0, 0.1, 0.4, 0.7, 2.0})
                    if (tof + bend > open && tof + bend < open + r.gate) cuts.push_back(tof + bend);
                std::sort(cuts.begin(), cuts.end());
                double sum = 0;
                for (std::size_t i = 0; i + 1 < cuts.size(); ++i)
                    sum += integral([&](double t) { return r.pulse.power(t - tof); }, cuts[i] + 1e-13,
                                    cuts[i + 1] - 1e-13);
                EXPECT_NEAR(r.weight(k, tof), sum, 1e-8) << tof << " " << k;
            }
    }
}

// Light and sensor modulated over a period: their product, by quadrature.
TEST(TimeResponse, ModulationIsTheProductOfLightAndSensor) {
    const double period = 3;
    for (const Modulation modulation : {Modulation::sine, Modulation::square}) {
        const TimeResponse r{6, 0, 0.5, 0.5, Pulse::delta(), modulation, period};
        // Energy of the light in a period is 1; the sensor's mean over the bins is 1 / n.
        const auto wave = [&](double t) {
            const double x = t / period - std::floor(t / period);
            return modulation == Modulation::sine ? 1 + std::cos(2 * pi_double * x) : x < 0.5 ? 2.0 : 0.0;
        };
        for (const double tof : {0.3, 1.1, 2.9, 7.4})
            for (std::uint32_t k = 0; k < r.n_bins; ++k) {
                const int n = 600000;
                double sum = 0;
                for (int i = 0; i < n; ++i) {
                    const double t = (i + 0.5) * period / n;
                    sum += wave(t - tof) * wave(t - k * period / r.n_bins);
                }
                sum /= n;
                EXPECT_NEAR(r.weight(k, tof), sum / r.n_bins, 1e-5) << tof << " " << k;
            }
    }
}

// Detected mutation: S_e derived by start instead of tof (sign).
TEST(TimeResponse, DerivativesAgreeWithDifferences) {
    using D = Dual<1, double>;
    const double h = 1e-6;
    for (const auto& [name, r] : responses()) {
        SCOPED_TRACE(name);
        for (const double tof : {1.613, 1.937, 2.771, 4.211})
            for (std::uint32_t k = 0; k < r.n_bins; ++k) {
                const D w = r.weight(k, D::variable(tof, 0));
                EXPECT_EQ(w.value, r.weight(k, tof));
                EXPECT_NEAR(w.d[0], (r.weight(k, tof + h) - r.weight(k, tof - h)) / (2 * h), 2e-5) << tof << " " << k;
            }
    }
}

// Detected mutations: sign of the slope; closing border by open + gate where gates tile the time; half a jump lost.
TEST(TimeResponse, SlopesAreThoseOfTheDual) {
    using D = Dual<1, double>;
    for (const auto& [name, r] : responses()) {
        SCOPED_TRACE(name);
        for (const double tof : {0.2, 1.613, 1.937, 2.771, 4.211, 7.4999, 9.1})
            for (std::uint32_t k = 0; k < r.n_bins; ++k)
                EXPECT_NEAR(r.slope(k, tof), r.weight(k, D::variable(tof, 0)).d[0], 1e-13) << tof << " " << k;
    }
}

/// All responses, and those of gates shorter than the pulse, longer, and shorter than the distance between bins.
std::vector<std::pair<std::string, TimeResponse>> gated_responses() {
    auto all = responses();
    std::vector<NamedPulse> pulses = smooth_pulses();
    pulses.push_back({"delta", Pulse::delta()});
    pulses.push_back({"short box", Pulse::box(0.05)});
    for (const auto& [name, pulse] : pulses)
        for (const double gate : {0.25, 0.01, 0.1, 3.0})
            for (const double widened : {0.0, 0.17, 0.25})
                all.push_back({fmt::format("{}, gate {}, widened {}", name, gate, widened),
                               {24, 1.5, 0.25, gate, pulse, {}, 1, widened}});
    return all;
}

/// Times of flight all over a window, on its borders, and one rounding beside them.
std::vector<double> times_of_flight(const TimeResponse& r) {
    std::vector<double> all;
    for (double tof = -1; tof < r.end() + 3; tof += 0.0713) all.push_back(tof);
    for (const double border : {r.start, r.start + r.width, r.start + 7 * r.width, r.end()})
        for (const double end : {0.0, r.pulse.begin(), r.pulse.end(), 0.5 * r.width, -0.5 * r.width, r.gate}) {
            const double tof = border - end;
            for (const double near : {tof, std::nextafter(tof, -1e9), std::nextafter(tof, 1e9)}) all.push_back(near);
        }
    return all;
}

// Visits every bin with a weight or a slope, weights as spread() to the bit.
// Detected mutations: range of bins not widened, so that a bin whose gate touches the end of a box is lost.
TEST(TimeResponse, SpreadWithSlopesVisitsEveryWeightAndSlope) {
    for (const auto& [name, r] : gated_responses()) {
        SCOPED_TRACE(name);
        for (const double tof : times_of_flight(r)) {
            std::vector<double> w(r.n_bins, 0.0), both_w(r.n_bins, 0.0), slope(r.n_bins, 0.0);
            const auto one = r.spread(tof, [&](std::uint32_t k, double x) { w[k] += x; });
            const auto both = r.spread_with_slopes(tof, [&](std::uint32_t k, double x, double s) {
                both_w[k] += x;
                slope[k] += s;
            });
            ASSERT_EQ(w, both_w) << tof;
            ASSERT_EQ(one.before, both.before);
            ASSERT_EQ(one.after, both.after);
            for (std::uint32_t k = 0; k < r.n_bins; ++k)
                ASSERT_NEAR(slope[k], r.slope(k, tof), 1e-13) << tof << " " << k;
        }
    }
}

// Where gates tile the time, moving light neither makes nor loses any: slopes of bins, before and after sum to 0, at
// borders and one rounding beside them, and wherever the window starts.
TEST(TimeResponse, SlopesSumToZero) {
    for (const auto& [name, at_start] : gated_responses()) {
        if (at_start.gate != at_start.width) continue;
        SCOPED_TRACE(name);
        for (const double shift : {0.0, 0.1, 0.0371, 0.25 / 3}) {
            TimeResponse r = at_start;
            if (r.modulation == Modulation::none) r.start += shift;
            for (const double tof : times_of_flight(r)) {
                double sum = 0, size = 0;
                const auto outside = r.spread_with_slopes(tof, [&](std::uint32_t, double, double slope) {
                    sum += slope;
                    size += std::abs(slope);
                });
                sum += outside.before_slope + outside.after_slope;
                size += std::abs(outside.before_slope) + std::abs(outside.after_slope);
                ASSERT_LE(std::abs(sum), 1e-14 * (1 + size)) << tof;
            }
        }
    }
}

// At a jump the mean of both sides: an arrival on the border of a box as long as a bin.
TEST(TimeResponse, SlopesAtJumpsAreMeansOfBothSides) {
    const TimeResponse r{8, 2, 0.5, 0.5, Pulse::box(0.5), {}, 1};
    // The tent of bin 2, over [2.5, 3.5], turns at 3.
    EXPECT_EQ(r.slope(2, std::nextafter(3.0, 0.0)), 2);
    EXPECT_EQ(r.slope(2, std::nextafter(3.0, 9.0)), -2);
    EXPECT_EQ(r.slope(2, 3.0), 0);
    EXPECT_EQ(r.slope(2, 2.5), 1);
    EXPECT_EQ(r.slope(2, 3.5), -1);
}

// A delta pulse is differentiated as a box of one bin, centred: the value of that box's tent, moved by half a bin.
TEST(TimeResponse, ADeltaPulseIsWidenedByABin) {
    const TimeResponse delta{8, 2, 0.5, 0.5, Pulse::delta(), {}, 1};
    TimeResponse box = delta;
    box.pulse = Pulse::box(0.5);
    for (double tof = 1.1; tof < 7; tof += 0.0371)
        for (int k = 0; k < 8; ++k) EXPECT_EQ(delta.slope(k, tof), box.slope(k, tof - 0.25)) << tof << " " << k;
}

// Widened by a length, the slope is the mean of exact slopes over it.
TEST(TimeResponse, WidenedSlopesAreMeans) {
    TimeResponse r{8, 2, 0.5, 0.5, Pulse::gaussian(0.2), {}, 1, 0.3};
    TimeResponse exact = r;
    exact.widened = 0;
    for (double tof = 1.1; tof < 7; tof += 0.0371)
        for (int k = 0; k < 8; ++k) {
            constexpr int n = 200;
            double mean = 0;
            for (int i = 0; i < n; ++i) mean += exact.slope(k, tof + 0.3 * ((i + 0.5) / n - 0.5)) / n;
            EXPECT_NEAR(r.slope(k, tof), mean, 1e-4);
        }
    // A delta pulse by a bin: as without.
    TimeResponse delta{8, 2, 0.5, 0.5, Pulse::delta(), {}, 1}, by_a_bin = delta;
    by_a_bin.widened = 0.5;
    for (double tof = 1.1; tof < 7; tof += 0.0371)
        for (int k = 0; k < 8; ++k) EXPECT_NEAR(by_a_bin.slope(k, tof), delta.slope(k, tof), 1e-12) << tof << " " << k;
}

// Bins, before and after sum to all of the light.
TEST(TimeResponse, EnergyIsKept) {
    for (const auto& [name, r] : responses()) {
        if (r.gate != r.width) continue;
        SCOPED_TRACE(name);
        for (double tof = 0; tof < 9; tof += 0.0371) {
            double sum = 0;
            const auto outside = r.spread(tof, [&](std::uint32_t k, double w) {
                ASSERT_LT(k, r.n_bins);
                EXPECT_NEAR(w, r.weight(k, tof), 1e-14);
                sum += w;
            });
            EXPECT_NEAR(sum + outside.before + outside.after, 1, 1e-13) << tof;
            EXPECT_GE(outside.before, 0);
            EXPECT_GE(outside.after, 0);
        }
    }
}

// Overlapping gates: spread() visits exactly the bins that record something.
TEST(TimeResponse, SpreadOfLongGatesIsEveryWeight) {
    for (const auto& [name, r] : responses()) {
        SCOPED_TRACE(name);
        for (double tof = 0; tof < 9; tof += 0.173) {
            std::vector<double> visited(r.n_bins, 0.0);
            r.spread(tof, [&](std::uint32_t k, double w) { visited[k] += w; });
            for (std::uint32_t k = 0; k < r.n_bins; ++k)
                EXPECT_NEAR(visited[k], r.weight(k, tof), 1e-14) << tof << " " << k;
        }
    }
}

// METHODS 4.4, window edges: an arrival on a border belongs to the bin that opens there, one rounding below to the one
// that closes; none of the window's neighbours gets anything.
TEST(TimeResponse, BordersOfTheWindow) {
    const TimeResponse r{8, 2, 0.5, 0.5, Pulse::delta(), {}, 1};
    const auto bin_of = [&](double tof, TimeResponse::Outside& outside) {
        std::int64_t bin = -1;
        outside = r.spread(tof, [&](std::uint32_t k, double w) {
            EXPECT_EQ(w, 1);
            EXPECT_EQ(bin, -1);
            bin = k;
        });
        return bin;
    };
    TimeResponse::Outside outside;
    for (int k = 0; k < 8; ++k) {
        const double border = 2 + 0.5 * k;
        EXPECT_EQ(bin_of(border, outside), k);
        EXPECT_EQ(bin_of(std::nextafter(border, 9.0), outside), k);
        EXPECT_EQ(outside.before + outside.after, 0);
        EXPECT_EQ(bin_of(std::nextafter(border, 0.0), outside), k - 1);
        EXPECT_EQ(outside.before, k == 0 ? 1 : 0);
    }
    EXPECT_EQ(bin_of(6.0, outside), -1);
    EXPECT_EQ(outside.after, 1);
    EXPECT_EQ(bin_of(std::nextafter(6.0, 0.0), outside), 7);
    EXPECT_EQ(outside.after, 0);
}

// METHODS 4.2, 3.3: a pulse as long as the gate gives frame k the part 1 - f and frame k + 1 the part f.
TEST(TimeResponse, BoxByBoxIsTheTent) {
    const TimeResponse r{10, 1, 0.2, 0.2, Pulse::box(0.2), {}, 1};
    for (double tof = 1.0; tof < 2.6; tof += 0.037) {
        const double x = (tof - 1) / 0.2, f = x - std::floor(x);
        const auto k = std::int64_t(std::floor(x));
        EXPECT_NEAR(r.weight(k, tof), 1 - f, 1e-12);
        EXPECT_NEAR(r.weight(k + 1, tof), f, 1e-12);
        EXPECT_NEAR(r.weight(k + 2, tof), 0, 1e-12);
    }
    // Longer than the gate: a trapezoid that peaks at gate / length.
    const TimeResponse wide{10, 0, 0.2, 0.2, Pulse::box(0.5), {}, 1};
    EXPECT_NEAR(wide.weight(5, 0.7), 0.4, 1e-12);
}

TEST(TimeResponse, BadTablesAreRefused) {
    EXPECT_THROW(Pulse::table({0}, {1}), InputError);
    EXPECT_THROW(Pulse::table({0, 0}, {1, 1}), InputError);
    EXPECT_THROW(Pulse::table({0, 1}, {1, -1}), InputError);
    EXPECT_THROW(Pulse::table({0, 1}, {0, 0}), InputError);
}

}  // namespace
}  // namespace loom
