#include "stages/fit/optimiser.h"

#include <algorithm>
#include <cmath>
#include <optional>
#include <span>

#include "stages/core/sampling/streams.h"

namespace loom::fit {
namespace {

using Numbers = std::vector<double>;

Numbers of(const Column<double>& column) {
    return {column.begin(), column.end()};
}
template <class T>
void append(Column<T>& column, const T& value) {
    std::vector<T> all(column.begin(), column.end());
    all.push_back(value);
    column = std::move(all);
}

/// Adds the Gaussian priors of the parameters.
void add_priors(Equations& eq, const Fit::Parameters& p) {
    const std::size_t n = eq.n_parameters();
    for (std::size_t i = 0; i < n; ++i) {
        if (p.prior_sigma[i] == 0) continue;
        const double weight = 1 / (p.prior_sigma[i] * p.prior_sigma[i]), off = p.prior_mean[i] - p.value[i];
        eq.loss += weight * off * off;
        eq.gradient[i] += weight * off;
        for (Matrix* matrix : {&eq.normal, &eq.curvature, &eq.measured_noise, &eq.noise, &eq.scatter})
            (*matrix)[i * n + i] += weight;
    }
}

/// Returns the step of a damped system. Parameters that would leave their bounds stay at them.
Numbers bounded_step(const Equations& eq, const Fit::Parameters& p, std::span<const double> from, double lambda) {
    const std::size_t n = eq.n_parameters();
    std::vector<std::uint8_t> fixed(n, 0);
    Numbers step(n, 0.0);
    for (std::size_t round = 0; round <= n; ++round) {
        // The system of the free parameters, with the others' steps given.
        std::vector<std::size_t> free;
        for (std::size_t i = 0; i < n; ++i)
            if (!fixed[i]) free.push_back(i);
        const std::size_t f = free.size();
        if (f == 0) break;
        const auto solved = [&](const Matrix& matrix) {
            Matrix a(f * f);
            Numbers b(f);
            for (std::size_t i = 0; i < f; ++i) {
                b[i] = eq.gradient[free[i]];
                for (std::size_t j = 0; j < n; ++j)
                    if (fixed[j]) b[i] -= matrix[free[i] * n + j] * step[j];
                for (std::size_t j = 0; j < f; ++j) a[i * f + j] = matrix[free[i] * n + free[j]];
                a[i * f + i] += lambda * eq.curvature[free[i] * n + free[i]];
            }
            return solve(a, b);
        };
        auto x = solved(eq.normal);
        if (!x) x = solved(eq.curvature);
        for (std::size_t i = 0; i < f; ++i) step[free[i]] = x ? (*x)[i] : 0.0;
        bool inside = true;
        for (const std::size_t i : free) {
            const double least = p.lower[i] - from[i], most = p.upper[i] - from[i];
            if (step[i] >= least && step[i] <= most) continue;
            step[i] = std::clamp(step[i], least, most);
            fixed[i] = 1;
            inside = false;
        }
        if (inside) break;
    }
    // No step is longer than the scales.
    double longest = 1;
    for (std::size_t i = 0; i < n; ++i)
        if (p.scale[i] > 0) longest = std::max(longest, std::abs(step[i]) / p.scale[i]);
    for (double& s : step) s /= longest;
    return step;
}

Equations equations_of(const Fit::Point& point) {
    Equations eq(point.gradient.size());
    eq.gradient = of(point.gradient), eq.normal = of(point.normal), eq.curvature = of(point.curvature);
    eq.normal_variance = of(point.normal_variance);
    eq.measured_noise = of(point.measured_noise), eq.noise = of(point.noise), eq.scatter = of(point.scatter);
    eq.loss = point.loss, eq.loss_variance = point.loss_variance;
    eq.expected_loss = point.expected_loss, eq.expected_variance = point.expected_variance;
    return eq;
}

Fit::Point point_of(const Equations& eq, Numbers value, std::uint32_t evaluations = 1) {
    Fit::Point point;
    point.evaluations = evaluations;
    point.value = std::move(value);
    point.gradient = eq.gradient, point.normal = eq.normal, point.curvature = eq.curvature;
    point.normal_variance = eq.normal_variance;
    point.measured_noise = eq.measured_noise, point.noise = eq.noise, point.scatter = eq.scatter;
    point.loss = eq.loss, point.loss_variance = eq.loss_variance;
    point.expected_loss = eq.expected_loss, point.expected_variance = eq.expected_variance;
    return point;
}

/// Returns the mean of a point and a further evaluation near it. Where the model is linear the minimum of their mean
/// equations is the mean of their minima.
Fit::Point mean_of(const Fit::Point& point, const Equations& here, std::span<const double> value) {
    const double n = double(point.evaluations), old = n / (n + 1), now = 1 / (n + 1);
    Equations eq = equations_of(point);
    const auto mean = [&](Numbers& of, std::span<const double> further) {
        for (std::size_t i = 0; i < of.size(); ++i) of[i] = old * of[i] + now * further[i];
    };
    Numbers at = of(point.value);
    mean(at, value);
    mean(eq.gradient, here.gradient), mean(eq.normal, here.normal), mean(eq.curvature, here.curvature);
    mean(eq.measured_noise, here.measured_noise), mean(eq.noise, here.noise), mean(eq.scatter, here.scatter);
    for (std::size_t i = 0; i < eq.normal_variance.size(); ++i)
        eq.normal_variance[i] = old * old * eq.normal_variance[i] + now * now * here.normal_variance[i];
    eq.loss = old * eq.loss + now * here.loss;
    eq.loss_variance = old * old * eq.loss_variance + now * now * here.loss_variance;
    eq.expected_loss = old * eq.expected_loss + now * here.expected_loss;
    eq.expected_variance = old * eq.expected_variance + now * here.expected_variance;
    return point_of(eq, std::move(at), point.evaluations + 1);
}

/// Returns the covariance of the mean gradient of so many evaluations, of which `one` is that of one: the noise of the
/// measurement is in all of them.
Matrix of_mean(const Equations& eq, const Matrix& one, std::uint32_t evaluations) {
    Matrix out = eq.measured_noise;
    for (std::size_t i = 0; i < out.size(); ++i) out[i] += (one[i] - eq.measured_noise[i]) / evaluations;
    return out;
}

/// Returns the inverse of `normal`, or where that is not positive definite of `curvature`, if it has one.
std::optional<Matrix> inverse_normal(const Equations& eq) {
    const auto inverted = inverse(eq.normal, eq.n_parameters());
    return inverted ? inverted : inverse(eq.curvature, eq.n_parameters());
}

/// Returns the mean of step^T normal step over noise, at the minimum.
double length2_of_noise(const Equations& eq, std::uint32_t evaluations) {
    const std::size_t n = eq.n_parameters();
    const auto inverted = inverse_normal(eq);
    if (!inverted) return double(n);
    const Matrix noise = of_mean(eq, eq.noise, evaluations);
    double trace = 0;
    for (std::size_t i = 0; i < n * n; ++i) trace += (*inverted)[i] * noise[i];
    return std::max(trace, 1e-300);
}

void move_to(Fit& fit, std::span<const double> from, std::span<const double> step) {
    Numbers value(from.begin(), from.end());
    for (std::size_t i = 0; i < value.size(); ++i)
        value[i] = std::clamp(value[i] + step[i], fit.parameters.lower[i], fit.parameters.upper[i]);
    fit.parameters.value = std::move(value);
}

bool is_finest(const Fit& fit) {
    return fit.state.level + 1 == fit.settings.merged_bins.size();
}

void start_level(Fit& fit, std::uint32_t level) {
    fit.state.level = level;
    fit.state.at_level = 0;
}

/// Keeps the best point if no run has ended in a lower one.
void keep_minimum(Fit& fit) {
    if (!fit.minimum.value.empty() && fit.minimum.loss <= fit.best.loss) return;
    fit.minimum = fit.best;
}

/// Ends the fit with error bars; lm at the lowest minimum, improved by one step without damping, others where they are.
void end(Fit& fit, const char* status, std::size_t n_pixels) {
    if (is_finest(fit) || fit.minimum.value.empty()) keep_minimum(fit);
    const Equations eq = equations_of(fit.minimum);
    const std::size_t n = fit.n_parameters();
    const auto inverted = inverse_normal(eq);
    // The scatter of few pixels is too uncertain.
    const Matrix of_gradient = of_mean(eq, n_pixels >= 10 * n ? eq.scatter : eq.noise, fit.minimum.evaluations);
    fit.parameters.covariance = inverted ? sandwich(*inverted, of_gradient, n) : Matrix(n * n, 0.0);
    Numbers sigma_error(n);
    for (std::size_t i = 0; i < n; ++i)
        sigma_error[i] = std::sqrt(eq.normal_variance[i]) / std::max(std::abs(eq.normal[i * n + i]), 1e-300);
    fit.parameters.sigma_error = std::move(sigma_error);
    fit.state.status = status;
    if (fit.settings.method != "lm") return;
    const Numbers from = of(fit.minimum.value);
    move_to(fit, from, bounded_step(eq, fit.parameters, from, 0));
}

/// Whether the best point is a minimum that does not explain the measurement.
bool is_misfit(const Fit& fit, const Rules& rules) {
    const Fit::Point& b = fit.best;
    const double excess = b.loss - b.expected_loss, sigma = std::sqrt(b.loss_variance + b.expected_variance);
    const auto& h = fit.history;
    double first = 0;
    for (std::size_t i = 0; i < h.loss.size() && first == 0; ++i)
        if (h.merged_bins[i] == *(fit.settings.merged_bins.end() - 1)) first = h.loss[i];
    first = std::max(first, h.loss[0]);
    return excess > rules.misfit * sigma && excess > rules.misfit_share * first;
}

/// Goes on from a random point: within the distance that the fit has moved so far, or the scales, around the start.
void restart(Fit& fit, const Rules& rules) {
    const Fit::Parameters& p = fit.parameters;
    const std::size_t n = fit.n_parameters();
    ++fit.state.restarts;
    Numbers step(n);
    for (std::size_t i = 0; i < n; ++i) {
        const double reach = p.scale[i] > 0 ? p.scale[i] : 2 * std::abs(fit.best.value[i] - p.start[i]);
        step[i] = reach * (2 * streams::selection(streams::numbered(rules.seed, fit.state.restarts), i) - 1);
    }
    move_to(fit, of(p.start), step);
    start_level(fit, 0);
    fit.state.lambda = 0;
}

void advance_lm(Fit& fit, const EquationsOf& evaluated, const Rules& rules, bool accepted, std::size_t n_pixels) {
    Fit::State& state = fit.state;
    const Equations best = equations_of(fit.best);
    const Numbers from = of(fit.best.value);
    // Whether no step at these bins is worth its noise.
    const Numbers newton = bounded_step(best, fit.parameters, from, 0);
    const double length2 = product(best.normal, newton, newton);
    constexpr double most_damped = 1e6;
    const bool arrived = accepted &&
                         length2 <= rules.tolerance * rules.tolerance * length2_of_noise(best, fit.best.evaluations) &&
                         (!is_finest(fit) || fit.best.evaluations >= rules.averaged),
               stuck = state.lambda > most_damped;
    if (!is_finest(fit) && (arrived || stuck || state.at_level >= rules.max_at_level)) {
        start_level(fit, state.level + 1);
        if (!accepted) {
            fit.parameters.value = from;  // there the finer bins are not known
            return;
        }
        Equations finer = evaluated(fit.settings.merged_bins[state.level]);
        add_priors(finer, fit.parameters);
        fit.best = point_of(finer, of(fit.parameters.value));
        state.at_level = 1;
        state.lambda = std::min(state.lambda, 1e-3);
        const Numbers here = of(fit.parameters.value);
        move_to(fit, here, bounded_step(finer, fit.parameters, here, state.lambda));
        return;
    }
    if (is_finest(fit) && (arrived || stuck)) {
        keep_minimum(fit);
        if (is_misfit(fit, rules) && state.restarts < rules.max_restarts) return restart(fit, rules);
        return end(fit, "converged", n_pixels);
    }
    move_to(fit, from, bounded_step(best, fit.parameters, from, state.lambda));
}

/// Sets scales that were not given to the step of each parameter alone.
void set_scales(Fit& fit, const Equations& eq) {
    Numbers scale = of(fit.parameters.scale);
    const std::size_t n = scale.size();
    for (std::size_t i = 0; i < n; ++i)
        if (scale[i] == 0 && eq.curvature[i * n + i] > 0) scale[i] = std::abs(eq.gradient[i]) / eq.curvature[i * n + i];
    fit.parameters.scale = std::move(scale);
}

void advance_adam(Fit& fit, const Equations& eq, const Rules& rules) {
    constexpr double beta_mean = 0.9, beta_square = 0.99;
    const std::size_t n = fit.n_parameters();
    const double t = double(fit.n_evaluations());
    Numbers mean = of(fit.state.adam_mean), square = of(fit.state.adam_square), step(n);
    const double rate = rules.rate * std::pow(0.1, t / double(rules.max_evaluations));
    for (std::size_t i = 0; i < n; ++i) {
        mean[i] = beta_mean * mean[i] + (1 - beta_mean) * eq.gradient[i];
        square[i] = beta_square * square[i] + (1 - beta_square) * eq.gradient[i] * eq.gradient[i];
        const double m = mean[i] / (1 - std::pow(beta_mean, t)), s = square[i] / (1 - std::pow(beta_square, t));
        step[i] = s > 0 ? rate * fit.parameters.scale[i] * m / std::sqrt(s) : 0.0;
    }
    fit.state.adam_mean = std::move(mean);
    fit.state.adam_square = std::move(square);
    move_to(fit, of(fit.parameters.value), step);
}

void advance_gradient(Fit& fit, const Equations& eq) {
    const std::size_t n = fit.n_parameters();
    Numbers step(n);
    double along = 0;
    for (std::size_t i = 0; i < n; ++i) {
        step[i] = eq.gradient[i] * fit.parameters.scale[i] * fit.parameters.scale[i];
        along += step[i] * eq.gradient[i];
    }
    const double curvature = product(eq.curvature, step, step);
    double longest = 1;
    for (std::size_t i = 0; i < n; ++i) {
        step[i] *= curvature > 0 ? along / curvature : 0.0;
        if (fit.parameters.scale[i] > 0) longest = std::max(longest, std::abs(step[i]) / fit.parameters.scale[i]);
    }
    for (double& s : step) s /= longest;
    move_to(fit, of(fit.parameters.value), step);
}

}  // namespace

void advance(Fit& fit, const EquationsOf& evaluated, const Rules& rules) {
    const std::uint32_t merged = fit.settings.merged_bins[fit.state.level];
    Equations here = evaluated(merged);
    add_priors(here, fit.parameters);
    const bool first_of_level = fit.state.at_level == 0, is_lm = fit.settings.method == "lm";
    if (fit.n_evaluations() == 0 && !is_lm) set_scales(fit, here);

    // Whether the fit goes on from here.
    bool accepted = true, near = false;
    const double lambda_before = fit.state.lambda;
    if (is_lm && !first_of_level) {
        const Fit::Point& best = fit.best;
        Numbers step = of(fit.parameters.value);
        double predicted = 0;
        for (std::size_t i = 0; i < step.size(); ++i)
            step[i] -= best.value[i], predicted += 2 * step[i] * best.gradient[i];
        predicted -= product(of(best.normal), step, step);
        const double decrease = best.loss - here.loss, sigma = std::sqrt(best.loss_variance + here.loss_variance);
        accepted = std::isfinite(here.loss) && decrease + 2 * sigma >= 0.1 * predicted;
        double& lambda = fit.state.lambda;
        if (!accepted)
            lambda = std::max(8 * lambda, 0.5);
        else if (decrease + sigma > 0.5 * predicted)
            lambda = lambda > 1e-4 ? lambda / 8 : 0;
        // Within noise: steps and losses.
        const Equations eq = equations_of(best);
        near = accepted && product(eq.normal, step, step) <= 9 * length2_of_noise(eq, 1) &&
               std::abs(decrease) <= 3 * sigma;
    }
    auto& h = fit.history;
    Numbers values = of(h.value);
    values.insert(values.end(), fit.parameters.value.begin(), fit.parameters.value.end());
    h.value = std::move(values);
    append(h.loss, here.loss);
    append(h.loss_sigma, std::sqrt(here.loss_variance));
    append(h.lambda, lambda_before);
    append(h.merged_bins, merged);
    append(h.accepted, std::uint8_t(accepted));
    ++fit.state.at_level;
    if (accepted)
        fit.best = near ? mean_of(fit.best, here, fit.parameters.value) : point_of(here, of(fit.parameters.value));

    if (is_lm) {
        advance_lm(fit, evaluated, rules, accepted, here.n_pixels);
    } else {
        if (fit.settings.method == "adam")
            advance_adam(fit, here, rules);
        else
            advance_gradient(fit, here);
        const std::uint32_t levels = std::uint32_t(fit.settings.merged_bins.size()),
                            each = std::max(rules.max_evaluations / levels, 1u);
        if (fit.state.at_level >= each && !is_finest(fit)) start_level(fit, fit.state.level + 1);
    }
    if (fit.is_running() && fit.n_evaluations() >= rules.max_evaluations) end(fit, "stopped", here.n_pixels);
}

}  // namespace loom::fit
