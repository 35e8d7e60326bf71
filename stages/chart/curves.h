#pragma once
// Curves of error against cost, their slopes and comparisons.

#include <string>
#include <vector>

#include "stages/core/stats/student.h"
#include "stages/core/table/table.h"

namespace loom::chart {

/// The replicates of one setting of a method.
struct Point {
    double cost = 0;                    // mean over the replicates
    double error = 0, se = 0;           // mean; its standard error from the replicates' spread, NaN for one replicate
    double low = 0, high = 0;           // smallest and largest replicate
    std::vector<double> costs, errors;  // by replicate
    bool on_front = false;              // no point of any curve of the scene has both less cost and less error
};

struct Curve {
    std::string scene, method;
    std::vector<Point> points;  // by cost
    Estimate slope;             // of log error over log cost; NaN with fewer than two points
};

/// Groups the rows of a table into curves, in the order of their first rows. Rows of one curve with equal `samples`
/// (without such a column: equal x) are replicates. Columns `scene` and `replicate` are optional.
/// in:      x, y   columns of cost and error
/// in:      by     column that distinguishes curves
/// throws:  InputError when a number is not above 0, because the axes are logarithmic
std::vector<Curve> curves_of(const Table& table, const std::string& x, const std::string& y, const std::string& by);

/// Fits a straight line through points in log-log and returns its slope.
///   b = sum (u - mean u)(v - mean v) / sum (u - mean u)^2,  u = log cost, v = log error
/// out:     standard error from the slopes of the replicates, each fitted alone, where all points have the same number
///          (at least 2); else from the residuals (at least 3 points); else NaN
Estimate fit_slope(const std::vector<Point>& points);

/// Comparison of a method with the first method of its scene at equal cost or equal error. The ratio is first over
/// method: above 1 where the method is better.
struct Match {
    std::string scene, first, method;
    double level = 0;                          // the equal cost or equal error
    double value_first = 0, value_method = 0;  // errors at that cost, or costs at that error
    double ratio = 0, low = 0, high = 0;       // with a 95 % interval; NaN where no standard errors are known
};

/// Compare at every measured cost (error) within the range of both curves. Points are interpolated linearly in log-log;
/// nothing is extrapolated.
std::vector<Match> equal_cost(const std::vector<Curve>& curves);
std::vector<Match> equal_error(const std::vector<Curve>& curves);

}  // namespace loom::chart
