#include "stages/core/stats/student.h"

#include <cmath>
#include <limits>

#include "stages/core/stats/moments.h"

namespace loom {
namespace {

/// Continued fraction of the incomplete beta function by the modified method of Lentz.
double beta_fraction(double a, double b, double x) {
    constexpr double tiny = 1e-300;
    double c = 1, d = 1 - (a + b) * x / (a + 1);
    d = 1 / (std::abs(d) < tiny ? tiny : d);
    double h = d;
    for (int m = 1; m < 1000; ++m) {
        const auto step = [&](double coefficient) {
            d = 1 + coefficient * d;
            d = 1 / (std::abs(d) < tiny ? tiny : d);
            c = 1 + coefficient / c;
            if (std::abs(c) < tiny) c = tiny;
            h *= d * c;
            return d * c;
        };
        step(m * (b - m) * x / ((a + 2 * m - 1) * (a + 2 * m)));
        if (std::abs(step(-(a + m) * (a + b + m) * x / ((a + 2 * m) * (a + 2 * m + 1))) - 1) < 1e-15) break;
    }
    return h;
}

}  // namespace

double incomplete_beta(double a, double b, double x) {
    if (x <= 0) return 0;
    if (x >= 1) return 1;
    const double front =
        std::exp(std::lgamma(a + b) - std::lgamma(a) - std::lgamma(b) + a * std::log(x) + b * std::log1p(-x));
    // The fraction converges fast on one side of the mean only.
    if (x < (a + 1) / (a + b + 2)) return front * beta_fraction(a, b, x) / a;
    return 1 - front * beta_fraction(b, a, 1 - x) / b;
}

double student_p_value(double t, double dof) {
    if (std::isnan(t)) return 0;
    if (!std::isfinite(dof)) return std::erfc(std::abs(t) / std::sqrt(2.0));
    return incomplete_beta(0.5 * dof, 0.5, dof / (dof + t * t));
}

double student_critical(double alpha, double dof) {
    double low = 0, high = 1;
    while (student_p_value(high, dof) > alpha) high *= 2;
    for (int i = 0; i < 200; ++i) {
        const double mid = 0.5 * (low + high);
        (student_p_value(mid, dof) > alpha ? low : high) = mid;
    }
    return high;
}

Estimate estimate_of(std::span<const double> replicates) {
    Moments m;
    for (double x : replicates) m.add(x);
    return {m.mean, std::sqrt(m.var_mean()), double(m.n - 1)};
}

double welch_p_value(const Estimate& a, const Estimate& b) {
    const double va = a.se * a.se, vb = b.se * b.se, v = va + vb;
    if (v == 0) return a.mean == b.mean ? 1 : 0;
    const double inverse_dof = va * va / (v * v * a.dof) + vb * vb / (v * v * b.dof);
    const double dof = inverse_dof > 0 ? 1 / inverse_dof : std::numeric_limits<double>::infinity();
    return student_p_value((a.mean - b.mean) / std::sqrt(v), dof);
}

}  // namespace loom
