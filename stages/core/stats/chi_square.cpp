#include "stages/core/stats/chi_square.h"

#include <algorithm>
#include <cmath>
#include <numeric>
#include <vector>

#include "stages/core/stats/special_functions.h"

namespace loom {

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
        // The last pool includes a rest that is too small for a pool of its own.
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
