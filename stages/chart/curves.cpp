#include "stages/chart/curves.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <map>
#include <optional>

#include "formats/io/error.h"

namespace loom::chart {
namespace {

constexpr double unknown = std::numeric_limits<double>::quiet_NaN();
constexpr double infinite = std::numeric_limits<double>::infinity();

double mean_of(const std::vector<double>& x) {
    double sum = 0;
    for (double value : x) sum += value;
    return sum / double(x.size());
}

void finish(Point& point) {
    point.cost = mean_of(point.costs);
    point.error = mean_of(point.errors);
    point.se = point.errors.size() > 1 ? estimate_of(point.errors).se : unknown;
    const auto [low, high] = std::minmax_element(point.errors.begin(), point.errors.end());
    point.low = *low;
    point.high = *high;
}

struct Line {
    double slope = 0, se = 0;
};

Line line_through(const std::vector<double>& u, const std::vector<double>& v) {
    const double mu = mean_of(u), mv = mean_of(v), n = double(u.size());
    double uu = 0, uv = 0, rest = 0;
    for (std::size_t i = 0; i < u.size(); ++i) uu += (u[i] - mu) * (u[i] - mu), uv += (u[i] - mu) * (v[i] - mv);
    const double slope = uv / uu;
    for (std::size_t i = 0; i < u.size(); ++i) rest += std::pow(v[i] - mv - slope * (u[i] - mu), 2);
    return {slope, n > 2 ? std::sqrt(rest / (n - 2) / uu) : unknown};
}

std::vector<double> logs(const std::vector<Point>& points, auto&& value) {
    std::vector<double> out;
    for (const Point& point : points) out.push_back(std::log(value(point)));
    return out;
}

/// One point of a curve v(u) in logs, with the relative standard error of v.
struct Sample {
    double log_value, se_log, dof;
};

/// Interpolates v at u between two neighbouring points; nothing outside of the curve.
template <class U, class V>
std::optional<Sample> at(const Curve& curve, double log_u, U&& u_of, V&& v_of, double slope_of_se) {
    std::vector<Point> points = curve.points;
    std::sort(points.begin(), points.end(), [&](const Point& a, const Point& b) { return u_of(a) < u_of(b); });
    for (std::size_t i = 0; i < points.size(); ++i) {
        const Point &a = points[i], &b = points[std::min(i + 1, points.size() - 1)];
        const double ua = std::log(u_of(a)), ub = std::log(u_of(b));
        // The end points themselves count, even if their logs round outside.
        if (log_u < ua - 1e-12 || log_u > ub + 1e-12) continue;
        const double f = ub > ua ? std::clamp((log_u - ua) / (ub - ua), 0.0, 1.0) : 0;
        const double sa = a.se / a.error, sb = b.se / b.error;
        const double se = f == 0 ? sa : f == 1 ? sb : std::hypot((1 - f) * sa, f * sb);
        const double dof = double(std::min(a.errors.size(), b.errors.size())) - 1;
        return Sample{(1 - f) * std::log(v_of(a)) + f * std::log(v_of(b)), se * slope_of_se, dof};
    }
    return std::nullopt;
}

/// in:  u_of  the quantity that is equal, v_of the quantity that is compared
template <class U, class V>
std::vector<Match> matches(const std::vector<Curve>& curves, U&& u_of, V&& v_of, bool of_costs) {
    std::vector<Match> found;
    std::map<std::string, const Curve*> first_of;
    for (const Curve& curve : curves) {
        const Curve& first = *first_of.try_emplace(curve.scene, &curve).first->second;
        if (&first == &curve) continue;
        std::vector<double> levels;
        for (const Curve* one : {&first, &curve})
            for (const Point& point : one->points) levels.push_back(u_of(point));
        std::sort(levels.begin(), levels.end());
        levels.erase(std::unique(levels.begin(), levels.end()), levels.end());
        // Convert an error of the error to one of the cost by the curve's own slope.
        const auto scale = [&](const Curve& one) { return of_costs ? std::abs(1 / one.slope.mean) : 1; };
        for (double level : levels) {
            const auto a = at(first, std::log(level), u_of, v_of, scale(first));
            const auto b = at(curve, std::log(level), u_of, v_of, scale(curve));
            if (!a || !b) continue;
            const double log_ratio = a->log_value - b->log_value, se = std::hypot(a->se_log, b->se_log);
            double reach = unknown;
            if (!std::isnan(se)) {
                const double wa = a->se_log * a->se_log, wb = b->se_log * b->se_log;
                const double inverse = se > 0 ? (wa * wa / a->dof + wb * wb / b->dof) / std::pow(se, 4) : 0;
                reach = se * student_critical(0.05, inverse > 0 ? 1 / inverse : infinite);
            }
            found.push_back({curve.scene, first.method, curve.method, level, std::exp(a->log_value),
                             std::exp(b->log_value), std::exp(log_ratio), std::exp(log_ratio - reach),
                             std::exp(log_ratio + reach)});
        }
    }
    return found;
}

double cost_of(const Point& point) {
    return point.cost;
}
double error_of(const Point& point) {
    return point.error;
}

void mark_front(std::vector<Curve>& curves) {
    for (Curve& curve : curves) {
        for (Point& point : curve.points) {
            point.on_front = true;
            for (const Curve& other : curves) {
                if (other.scene != curve.scene) continue;
                for (const Point& rival : other.points) {
                    const bool as_good = rival.cost <= point.cost && rival.error <= point.error;
                    if (as_good && (rival.cost < point.cost || rival.error < point.error)) point.on_front = false;
                }
            }
        }
    }
}

}  // namespace

Estimate fit_slope(const std::vector<Point>& points) {
    if (points.size() < 2) return {unknown, unknown, 0};
    const Line line = line_through(logs(points, cost_of), logs(points, error_of));
    const std::size_t n = points[0].errors.size();
    const bool equal = std::all_of(points.begin(), points.end(), [&](const Point& p) { return p.errors.size() == n; });
    if (n < 2 || !equal) return {line.slope, line.se, double(points.size()) - 2};
    std::vector<double> slopes;
    for (std::size_t r = 0; r < n; ++r) {
        slopes.push_back(line_through(logs(points, [&](const Point& p) { return p.costs[r]; }),
                                      logs(points, [&](const Point& p) { return p.errors[r]; }))
                             .slope);
    }
    const Estimate spread = estimate_of(slopes);
    return {line.slope, spread.se, spread.dof};
}

std::vector<Curve> curves_of(const Table& table, const std::string& x, const std::string& y, const std::string& by) {
    const std::size_t cx = table.column(x), cy = table.column(y), cby = table.column(by);
    const std::size_t setting = table.has("samples") ? table.column("samples") : cx;
    std::vector<Curve> curves;
    std::map<std::pair<std::size_t, std::string>, std::size_t> point_by_key;
    for (std::size_t row = 0; row < table.rows.size(); ++row) {
        const std::string scene = table.has("scene") ? table.rows[row][table.column("scene")] : "";
        const std::string& method = table.rows[row][cby];
        auto curve = std::find_if(curves.begin(), curves.end(),
                                  [&](const Curve& c) { return c.scene == scene && c.method == method; });
        if (curve == curves.end()) curve = curves.insert(curves.end(), {scene, method, {}, {}});
        const auto key = std::pair{std::size_t(curve - curves.begin()), table.rows[row][setting]};
        const auto [at, is_new] = point_by_key.try_emplace(key, curve->points.size());
        if (is_new) curve->points.emplace_back();
        Point& point = curve->points[at->second];
        for (const auto& [column, values] : {std::pair{cx, &point.costs}, std::pair{cy, &point.errors}}) {
            const double value = table.number(row, column);
            if (!(value > 0) || !std::isfinite(value)) {
                throw InputError(fmt::format("{}: row {}, {}: {} must be above 0 on a log axis", table.file, row + 1,
                                             table.names[column], table.rows[row][column]));
            }
            values->push_back(value);
        }
    }
    for (Curve& curve : curves) {
        for (Point& point : curve.points) finish(point);
        std::stable_sort(curve.points.begin(), curve.points.end(),
                         [](const Point& a, const Point& b) { return a.cost < b.cost; });
        curve.slope = fit_slope(curve.points);
    }
    mark_front(curves);
    return curves;
}

std::vector<Match> equal_cost(const std::vector<Curve>& curves) {
    return matches(curves, cost_of, error_of, false);
}

std::vector<Match> equal_error(const std::vector<Curve>& curves) {
    return matches(curves, error_of, cost_of, true);
}

}  // namespace loom::chart
