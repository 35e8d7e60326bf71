#include "stages/core/stats/chi_square.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>
#include <vector>

namespace loom {
namespace {

constexpr double tiny = std::numeric_limits<double>::min();
constexpr double precision = 1e-15;

/// P(a, x) by its power series; converges fast for x < a + 1.
double gamma_p_series(double a, double x) {
    double term = 1 / a, sum = term;
    for (double k = a + 1; std::abs(term) > precision * std::abs(sum); ++k) {
        term *= x / k;
        sum += term;
    }
    return sum * std::exp(a * std::log(x) - x - std::lgamma(a));
}

/// Q(a, x) by its continued fraction (modified Lentz); converges fast for x > a + 1.
double gamma_q_fraction(double a, double x) {
    double b = x + 1 - a;
    double c = 1 / tiny;
    double d = 1 / b;
    double product = d;
    for (int i = 1;; ++i) {
        const double an = -i * (i - a);
        b += 2;
        d = an * d + b;
        if (std::abs(d) < tiny) d = tiny;
        c = b + an / c;
        if (std::abs(c) < tiny) c = tiny;
        d = 1 / d;
        product *= d * c;
        if (std::abs(d * c - 1) < precision) break;
    }
    return product * std::exp(a * std::log(x) - x - std::lgamma(a));
}

}  // namespace

double regularized_gamma_q(double a, double x) {
    if (x <= 0) return 1;
    return x < a + 1 ? 1 - gamma_p_series(a, x) : gamma_q_fraction(a, x);
}

double chi_square_tail(double statistic, int dof) {
    return regularized_gamma_q(0.5 * dof, 0.5 * statistic);
}

double sidak_alpha(int n_comparisons, double confidence) {
    return -std::expm1(std::log(confidence) / n_comparisons);
}

ChiSquareResult chi_square_test(std::span<const double> observed, std::span<const double> expected,
                                double min_expected) {
    std::vector<std::size_t> order(expected.size());
    std::iota(order.begin(), order.end(), std::size_t{0});
    std::stable_sort(order.begin(), order.end(),
                     [&](std::size_t i, std::size_t j) { return expected[i] < expected[j]; });

    ChiSquareResult result;
    double pool_observed = 0, pool_expected = 0;
    double left_expected = std::accumulate(expected.begin(), expected.end(), 0.0);
    int n_pools = 0;
    for (const std::size_t i : order) {
        left_expected -= expected[i];
        if (expected[i] < 1e-9) {
            result.stray += observed[i];
            continue;
        }
        pool_observed += observed[i];
        pool_expected += expected[i];
        // The last pool keeps what would be too little for one of its own.
        const bool last = i == order.back();
        if ((pool_expected >= min_expected && left_expected >= min_expected) || last) {
            const double difference = pool_observed - pool_expected;
            result.statistic += difference * difference / pool_expected;
            ++n_pools;
            pool_observed = pool_expected = 0;
        }
    }
    result.dof = n_pools - 1;
    result.p_value = result.dof > 0 ? chi_square_tail(result.statistic, result.dof) : 1.0;
    return result;
}

}  // namespace loom
