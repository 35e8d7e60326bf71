#include "stages/core/stats/student.h"

#include <cmath>
#include <limits>

#include "stages/core/stats/moments.h"
#include "stages/core/stats/special_functions.h"

namespace loom {

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
