#pragma once
// Curves of error against cost, what they have in common and what they differ in.

#include <string>
#include <vector>

#include "stages/core/stats/student.h"
#include "stages/core/table/table.h"

namespace loom::chart {

/// The replicates of one setting of a method.
struct Point {
    double cost = 0;                    // mean over the replicates
    double error = 0, se = 0;           // mean; its standard error from their spread, NaN for one
    double low = 0, high = 0;           // smallest and largest replicate
    std::vector<double> costs, errors;  // by replicate
    bool on_front = false;              // no point of any curve of the scene has less cost and less error
};

struct Curve {
    std::string scene, method;
    std::vector<Point> points;  // by cost
    Estimate slope;             // of log error over log cost; NaN with fewer than two points
};

/// The curves of a table in the order of their first rows; rows of one curve with equal `samples` (or, where there
/// is no such column, equal x) are replicates. Columns `scene` and `replicate` may be missing.
/// in:      x, y   columns of cost and error
/// in:      by     the column that tells curves apart
/// throws:  InputError when a number is not above 0: it has no place on a log axis
std::vector<Curve> curves_of(const Table& table, const std::string& x, const std::string& y, const std::string& by);

/// Straight line through points in log-log: its slope.
///   b = sum (u - mean u)(v - mean v) / sum (u - mean u)^2,  u = log cost, v = log error
/// out:     standard error from the slopes of the replicates, each fitted alone, where all points have as many (at
///          least 2); else from the residuals (at least 3 points), else NaN
Estimate fit_slope(const std::vector<Point>& points);

/// What a method costs or errs beside the first one of its scene. The quotient is first over method: above 1 where
/// the method is better.
struct Match {
    std::string scene, first, method;
    double level = 0;                          // the cost, or the error, that is equal
    double value_first = 0, value_method = 0;  // errors at that cost, or costs at that error
    double ratio = 0, low = 0, high = 0;       // with a 95 % interval; NaN where no standard errors are known
};

/// At every measured cost (error) that lies within both curves; between two points a straight line in log-log.
/// Nothing is extrapolated.
std::vector<Match> equal_cost(const std::vector<Curve>& curves);
std::vector<Match> equal_error(const std::vector<Curve>& curves);

}  // namespace loom::chart
