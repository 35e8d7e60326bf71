// loom-fit: what losses compare, the normal equations of noisy halves, and fits of a model with a closed form.
//
// Detected mutations: a residual with the Jacobian of its own half (gradient and `normal` off by 20 and more standard
// errors), the loss of one half, noise of the measurement left out of the covariance, that of an evaluation counted whole
// where several are averaged, that of the measurement once for each of them, three equal channels counted thrice, steps
// that are never taken back, bounds and priors ignored, no starts from elsewhere.

#include "stages/fit/fit.h"

#include <fmt/format.h>
#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "formats/fit.h"
#include "formats/io/content_hash.h"
#include "tests/traced_graph.h"

namespace loom::fit {
namespace {

using Numbers = std::vector<double>;

double dot(std::span<const double> a, std::span<const double> b) {
    double sum = 0;
    for (std::size_t i = 0; i < a.size(); ++i) sum += a[i] * b[i];
    return sum;
}

TEST(TimeTransform, ComparesWhatItSays) {
    const Numbers bins{1, 2, 4, 8, 16};
    const auto of = [&](Loss loss, std::uint32_t merged) {
        const TimeTransform transform(loss, bins.size(), merged);
        Numbers values(transform.n_values());
        transform.apply(bins, values);
        return values;
    };
    EXPECT_EQ(of(Loss::squares, 1), bins);
    EXPECT_EQ(of(Loss::squares, 2), (Numbers{3, 12, 16}));
    EXPECT_EQ(of(Loss::time_cdf, 1), (Numbers{1, 3, 7, 15, 31}));
    EXPECT_EQ(of(Loss::time_cdf, 2), (Numbers{3, 15, 31}));
    EXPECT_EQ(of(Loss::pyramid, 1), (Numbers{1, 2, 4, 8, 16, 3, 12, 16, 15, 16, 31}));
    EXPECT_EQ(of(Loss::pyramid, 5), (Numbers{31}));
}

TEST(TimeTransform, TransposedMapIsTransposed) {
    std::mt19937 random(1);
    std::normal_distribution<double> normal;
    for (const Loss loss : {Loss::squares, Loss::pyramid, Loss::time_cdf})
        for (const std::size_t n : {1, 2, 7, 16, 33})
            for (const std::uint32_t merged : {1u, 2u, 3u, 8u}) {
                const TimeTransform transform(loss, n, merged);
                Numbers x(n), tx(transform.n_values()), y(transform.n_values()), ty(n);
                for (double& v : x) v = normal(random);
                for (double& v : y) v = normal(random);
                transform.apply(x, tx);
                transform.adjoint(y, ty);
                EXPECT_NEAR(dot(tx, y), dot(x, ty), 1e-12 * (1 + std::sqrt(dot(tx, tx) * dot(y, y))));
            }
}

TEST(Symmetric, SolvesInAnyUnits) {
    std::mt19937 random(2);
    std::normal_distribution<double> normal;
    for (std::size_t n = 1; n < 8; ++n) {
        Matrix a(n * n, 0.0);
        for (std::size_t k = 0; k < 2 * n; ++k) {
            Numbers v(n);
            for (std::size_t i = 0; i < n; ++i) v[i] = normal(random) * std::pow(10.0, 6.0 * double(i) - 12);
            for (std::size_t i = 0; i < n; ++i)
                for (std::size_t j = 0; j < n; ++j) a[i * n + j] += v[i] * v[j];
        }
        Numbers x(n), b(n, 0.0);
        for (std::size_t i = 0; i < n; ++i) x[i] = std::pow(10.0, 12 - 6.0 * double(i));
        for (std::size_t i = 0; i < n; ++i)
            for (std::size_t j = 0; j < n; ++j) b[i] += a[i * n + j] * x[j];
        const auto solved = solve(a, b);
        ASSERT_TRUE(solved);
        for (std::size_t i = 0; i < n; ++i) EXPECT_NEAR((*solved)[i] / x[i], 1, 1e-7);
        a[n * n - 1] = -a[n * n - 1];
        EXPECT_FALSE(solve(a, b));
    }
    EXPECT_FALSE(solve(Matrix{1, 1, 1, 1}, Numbers{1, 1}));
}

/// A flash whose light reaches pixel i after t + slope i, spread by sigma, of strength s: parameters t, s. Noise as of paths.
struct Flash {
    std::size_t width = 24, n_bins = 64;
    double slope = 0.25, sigma = 1.0, noise = 0.02, measured_noise = 0.02;
    std::size_t n_channels = 3;  // 1: grey
    std::mt19937_64 random{3};

    double bin(std::size_t pixel, std::size_t k, double t, double s) const {
        const double off = (double(k) + 0.5 - t - slope * double(pixel)) / sigma;
        return s * std::exp(-off * off / 2);
    }
    TransientCube cube(std::size_t n_parameters) const {
        TransientCube cube;
        cube.film.width = std::uint32_t(width), cube.film.height = 1;
        cube.film.samples_per_pixel = 16;
        cube.time.n_bins = std::uint32_t(n_bins);
        cube.time.bin_width_opl = cube.time.gate_opl = 1;
        if (n_parameters > 0) cube.parameters.name = {"t", "s"}, cube.parameters.unit = {"m", "1"};
        return cube;
    }
    double gauss(double deviation) { return deviation * std::normal_distribution<double>()(random); }

    TransientCube measured(double t, double s) {
        TransientCube out = cube(0);
        std::vector<float> radiance, variance;
        for (std::size_t i = 0; i < width; ++i)
            for (std::size_t k = 0; k < n_bins; ++k) {
                float value = 0;
                for (std::size_t c = 0; c < 3; ++c) {
                    if (c < n_channels) value = float(bin(i, k, t, s) + gauss(measured_noise));
                    radiance.push_back(value);
                    variance.push_back(float(measured_noise * measured_noise));
                }
            }
        out.radiance = std::move(radiance), out.var_mean = std::move(variance);
        return out;
    }
    /// Noise of a bin and of its derivatives have the same paths, and so have neighbouring bins.
    TransientCube evaluated(double t, double s) {
        TransientCube out = cube(2);
        out.parameters.value = CopiedColumn<double>(std::vector<double>{t, s});
        const std::size_t n = width * n_bins * 3;
        std::vector<float> radiance(n), variance(n, float(2 * noise * noise)), derivative(2 * n);
        for (std::size_t i = 0; i < width; ++i)
            for (std::size_t c = 0; c < 3; ++c) {
                double before = gauss(noise);
                for (std::size_t k = 0; k < n_bins; ++k) {
                    const double here = gauss(noise), path = here + before;
                    before = here;
                    const double off = double(k) + 0.5 - t - slope * double(i), value = bin(i, k, t, s);
                    const std::size_t at = (i * n_bins + k) * 3 + c;
                    if (c > 0 && n_channels == 1) {
                        radiance[at] = radiance[at - c];
                        derivative[at] = derivative[at - c], derivative[n + at] = derivative[n + at - c];
                        continue;
                    }
                    radiance[at] = float(value + path);
                    derivative[at] = float(value * off / (sigma * sigma) + path);
                    derivative[n + at] = float(value / s + path / 2);
                }
            }
        out.radiance = std::move(radiance), out.var_mean = std::move(variance);
        out.derivative.bins = std::move(derivative);
        return out;
    }
    std::array<TransientCube, 2> halves(double t, double s) { return {evaluated(t, s), evaluated(t, s)}; }
};

/// Mean, standard error and variance of numbers that are added one by one.
struct Statistic {
    double n = 0, sum = 0, squares = 0;
    void add(double x) { n += 1, sum += x, squares += x * x; }
    double mean() const { return sum / n; }
    double variance() const { return (squares - sum * sum / n) / (n - 1); }
    double error() const { return std::sqrt(variance() / n); }
};

// Means over noise are those of equations without noise; the stated covariance is that over noise.
TEST(Equations, HaveTheMeansWithoutNoise) {
    for (const Loss loss : {Loss::squares, Loss::time_cdf})
        for (const std::size_t channels : {1, 3}) {
            SCOPED_TRACE(fmt::format("loss {}, {} channels", int(loss), channels));
            Flash flash;
            flash.n_channels = channels;
            const double t = 20.3, s = 1;
            const TimeTransform transform(loss, flash.n_bins, 2);
            // Without noise, but with the same weights.
            const auto exact = [&](double off) {
                Numbers g(2, 0.0), normal(4, 0.0);
                double l = 0;
                const double var_m = 0.02 * 0.02, var_h = 2 * 0.02 * 0.02 / 2;
                for (std::size_t i = 0; i < flash.width; ++i) {
                    Numbers r(flash.n_bins), j[2]{Numbers(flash.n_bins), Numbers(flash.n_bins)},
                        v(flash.n_bins, var_m + var_h);
                    for (std::size_t k = 0; k < flash.n_bins; ++k) {
                        const double value = flash.bin(i, k, t, s);
                        r[k] = flash.bin(i, k, t + off, s) - value;
                        j[0][k] = value * (double(k) + 0.5 - t - flash.slope * double(i));
                        j[1][k] = value;
                    }
                    const auto mapped = [&](const Numbers& x) {
                        Numbers y(transform.n_values());
                        transform.apply(x, y);
                        return y;
                    };
                    const Numbers y = mapped(r), a[2]{mapped(j[0]), mapped(j[1])}, w = mapped(v);
                    // Weights are smoothed over three values.
                    for (std::size_t k = 0; k < y.size(); ++k) {
                        double sum = 0, n = 0;
                        for (std::size_t q = k > 0 ? k - 1 : 0; q < std::min(k + 2, y.size()); ++q) sum += w[q], n += 1;
                        const double weight = double(channels) * n / sum;
                        l += weight * y[k] * y[k];
                        for (int p = 0; p < 2; ++p) {
                            g[std::size_t(p)] += weight * a[p][k] * y[k];
                            for (int q = 0; q < 2; ++q) normal[std::size_t(2 * p + q)] += weight * a[p][k] * a[q][k];
                        }
                    }
                }
                return std::tuple{l, g, normal};
            };
            const auto [at_truth, g0, n0] = exact(0);
            const auto [off_loss, off_g, off_normal] = exact(0.1);
            Statistic normal_variance, l, g[2], normal[4], g_at_truth[2], expected, stated[2], smaller[2];
            for (int replicate = 0; replicate < 600; ++replicate) {
                const Equations eq = normal_equations(flash.measured(t + 0.1, s), flash.halves(t, s), transform);
                l.add(eq.loss - eq.expected_loss);
                for (std::size_t p = 0; p < 2; ++p) g[p].add(eq.gradient[p]);
                for (std::size_t p = 0; p < 4; ++p) normal[p].add(eq.normal[p]);
                normal_variance.add(eq.normal_variance[0]);
                const Equations truth = normal_equations(flash.measured(t, s), flash.halves(t, s), transform);
                expected.add(truth.loss - truth.expected_loss);
                for (std::size_t p = 0; p < 2; ++p) {
                    g_at_truth[p].add(truth.gradient[p]);
                    stated[p].add(truth.scatter[3 * p]);
                    smaller[p].add(truth.noise[3 * p]);
                }
            }
            EXPECT_NEAR(expected.mean(), 0, 4 * expected.error());
            EXPECT_NEAR(l.mean(), off_loss, 4 * l.error());
            EXPECT_LT(l.error(), (loss == Loss::squares ? 0.1 : 1) * off_loss);
            for (std::size_t p = 0; p < 2; ++p) {
                EXPECT_NEAR(g[p].mean(), off_g[p], 4 * g[p].error()) << p;
                EXPECT_NEAR(g_at_truth[p].mean(), 0, 4 * g_at_truth[p].error()) << p;
                // A variance of 600 values has a standard error of 6 %. `noise` leaves that of the Jacobians out.
                EXPECT_NEAR(g_at_truth[p].variance() / stated[p].mean(), 1, 0.24) << p;
                EXPECT_GT(smaller[p].mean(), (loss == Loss::squares ? 0.5 : 0.1) * g_at_truth[p].variance()) << p;
                EXPECT_LT(smaller[p].mean(), g_at_truth[p].variance() * 1.24) << p;
            }
            for (std::size_t p = 0; p < 4; ++p)
                EXPECT_NEAR(normal[p].mean(), off_normal[p], 4 * normal[p].error()) << p;
            EXPECT_GT(normal_variance.mean(), 0.75 * normal[0].variance());
            EXPECT_LT(std::sqrt(normal_variance.mean()), (loss == Loss::squares ? 0.1 : 0.3) * off_normal[0]);
            EXPECT_LT(normal[0].error(), (loss == Loss::squares ? 0.01 : 0.2) * off_normal[0]);
        }
}

Fit begun(double t, double s, std::vector<std::uint32_t> merged, const std::string& method = "lm") {
    Fit fit;
    constexpr double unbounded = std::numeric_limits<double>::max();
    fit.settings.method = method;
    fit.settings.loss = "squares";
    fit.settings.merged_bins = std::move(merged);
    auto& p = fit.parameters;
    p.name = {"t", "s"}, p.unit = {"m", "1"};
    p.value = {t, s}, p.start = {t, s};
    p.lower = {-unbounded, -unbounded}, p.upper = {unbounded, unbounded};
    p.scale = {0, 0}, p.prior_mean = {0, 0}, p.prior_sigma = {0, 0};
    p.covariance = Numbers(4, 0.0), p.sigma_error = Numbers(2, 0.0);
    fit.state.adam_mean = {0, 0}, fit.state.adam_square = {0, 0};
    return fit;
}

TEST(Equations, IgnoreWhatIsNotFinite) {
    Flash flash;
    TransientCube measured = flash.measured(20, 1);
    std::vector<float> values(measured.radiance.begin(), measured.radiance.end());
    values[5] = std::numeric_limits<float>::quiet_NaN();
    measured.radiance = std::move(values);
    const Equations eq = normal_equations(measured, flash.halves(20, 1), TimeTransform(Loss::squares, flash.n_bins, 1));
    EXPECT_EQ(eq.n_ignored, 1u);
    EXPECT_EQ(eq.n_values, flash.width * flash.n_bins * 3 - 1);
    EXPECT_TRUE(std::isfinite(eq.loss + eq.gradient[0] + eq.gradient[1] + eq.noise[0]));
    Fit fit = begun(20, 1, {1});
    EXPECT_EQ(add_evaluation(fit, measured, flash.halves(20, 1), {}), 1u);
}

void run_to_end(Fit& fit, Flash& flash, const TransientCube& measured, const Rules& rules) {
    while (fit.is_running())
        add_evaluation(fit, measured, flash.halves(fit.parameters.value[0], fit.parameters.value[1]), rules);
}

const std::vector<std::uint32_t> coarse_to_fine{8, 4, 2, 1};

// From starts up to eight widths of the flash away; the error bars are those of the results.
TEST(Fit, ConvergesCoarseToFineWithHonestErrorBars) {
    Flash flash;
    Statistic z2[2], evaluations;
    int converged = 0, fine_only = 0;
    constexpr int n = 60;
    for (int i = 0; i < n; ++i) {
        const double t = 30 + 8 * (2.0 * i / (n - 1) - 1), s = 1 + 0.5 * std::sin(i);
        const TransientCube measured = flash.measured(30, 1);
        Rules rules;
        rules.max_restarts = 0;
        Fit fit = begun(t, s, coarse_to_fine);
        run_to_end(fit, flash, measured, rules);
        const double off = fit.parameters.value[0] - 30;
        if (std::abs(off) < 0.1) {
            ++converged;
            for (std::size_t p = 0; p < 2; ++p) {
                const double error = fit.parameters.value[p] - (p == 0 ? 30 : 1);
                z2[p].add(error * error / fit.parameters.covariance[3 * p]);
            }
        }
        evaluations.add(double(fit.n_evaluations()));
        Fit fine = begun(t, s, {1});
        run_to_end(fine, flash, measured, rules);
        fine_only += std::abs(fine.parameters.value[0] - 30) < 0.1;
    }
    EXPECT_GE(converged, n * 9 / 10);
    EXPECT_LT(fine_only, n * 7 / 10);
    EXPECT_LT(evaluations.mean(), 25);
    // Mean squares of errors over error bars are 1, with a standard deviation of sqrt(2 / n).
    for (const Statistic& z : z2) {
        EXPECT_GT(z.mean(), 1 - 3 * std::sqrt(2.0 / n));
        EXPECT_LT(z.mean(), 1 + 4 * std::sqrt(2.0 / n));
    }
    RecordProperty("converged", converged);
    RecordProperty("fine_only", fine_only);
}

TEST(Fit, KeepsToBoundsAndPriors) {
    Flash flash;
    const TransientCube measured = flash.measured(30, 1);
    Fit fit = begun(27, 1.2, coarse_to_fine);
    fit.parameters.upper = {29.5, 10};
    run_to_end(fit, flash, measured, {});
    EXPECT_EQ(fit.parameters.value[0], 29.5);
    EXPECT_EQ(fit.problem(), "");
    for (std::size_t i = 0; i < fit.n_evaluations(); ++i) EXPECT_LE(fit.history.value[2 * i], 29.5);

    Fit prior = begun(29, 1.2, coarse_to_fine);
    prior.parameters.prior_mean = {0, 1.5}, prior.parameters.prior_sigma = {0, 1e-5};
    run_to_end(prior, flash, measured, {});
    EXPECT_NEAR(prior.parameters.value[1], 1.5, 1e-3);
    EXPECT_NEAR(prior.parameters.value[0], 30, 0.1);
    EXPECT_NEAR(std::sqrt(prior.parameters.covariance[3]), 1e-5, 2e-6);
}

// Beside a weaker flash that the model lacks, a fit ends in a minimum that explains little.
TEST(Fit, StartsFromElsewhere) {
    int found[2]{};
    for (const std::uint32_t restarts : {0u, 20u})
        for (int i = 0; i < 6; ++i) {
            Flash flash;
            TransientCube measured = flash.measured(30, 1);
            const TransientCube weaker = flash.measured(12, 0.4);
            std::vector<float> both(measured.radiance.begin(), measured.radiance.end());
            for (std::size_t k = 0; k < both.size(); ++k) both[k] += weaker.radiance[k];
            measured.radiance = std::move(both);
            Rules rules;
            rules.max_evaluations = 400;
            rules.max_restarts = restarts;
            rules.seed = std::uint64_t(i);
            Fit fit = begun(11.5, 0.5, {2, 1});
            fit.parameters.lower = {0, 0.1}, fit.parameters.upper = {60, 3};
            fit.parameters.scale = {25, 0.5};
            run_to_end(fit, flash, measured, rules);
            found[restarts > 0] += std::abs(fit.parameters.value[0] - 30) < 0.2;
            EXPECT_LE(fit.state.restarts, restarts);
        }
    EXPECT_EQ(found[0], 0);
    EXPECT_GE(found[1], 5);
}

TEST(Fit, FollowsGradientsToo) {
    for (const char* method : {"adam", "gradient"}) {
        SCOPED_TRACE(method);
        Flash flash;
        const TransientCube measured = flash.measured(30, 1);
        Fit fit = begun(28.5, 1.3, {4, 1}, method);
        fit.parameters.scale = {1, 0.3};
        Rules rules;
        rules.max_evaluations = 80;
        run_to_end(fit, flash, measured, rules);
        EXPECT_EQ(fit.n_evaluations(), 80u);
        EXPECT_EQ(fit.state.status, "stopped");
        EXPECT_NEAR(fit.parameters.value[0], 30, 0.05);
        EXPECT_NEAR(fit.parameters.value[1], 1, 0.05);
    }
}

// Of two evaluations the second has the larger loss: the next one lies between them.
TEST(Fit, TakesStepsBackThatMakeItWorse) {
    for (const bool worse : {true, false}) {
        Fit fit = begun(0, 0, {1});
        double loss = 100;
        const auto equations = [&](std::uint32_t) {
            Equations eq(2);
            eq.loss = loss, eq.loss_variance = 1;
            eq.gradient = {10, 0};
            eq.normal = eq.curvature = {1, 0, 0, 1};
            eq.noise = eq.scatter = {1e-6, 0, 0, 1e-6};
            return eq;
        };
        advance(fit, equations, {});
        EXPECT_EQ(fit.parameters.value[0], 10);
        loss = worse ? 120 : 10;
        advance(fit, equations, {});
        EXPECT_EQ(fit.history.accepted[1], worse ? 0 : 1);
        EXPECT_EQ(fit.best.value[0], worse ? 0 : 10);
        EXPECT_GT(fit.parameters.value[0], worse ? 1 : 19);
        EXPECT_LT(fit.parameters.value[0], worse ? 9 : 21);
    }
}

// Each step from a file gives the same bytes as steps in memory.
TEST(Fit, GoesOnFromItsFile) {
    Flash flash, same;
    const TransientCube measured = flash.measured(30, 1);
    (void)same.measured(30, 1);
    const auto a = testing::scratch_file(".h5"), b = testing::scratch_file(".h5");
    Fit in_memory = begun(27, 1.2, coarse_to_fine), by_file = begun(27, 1.2, coarse_to_fine);
    for (int i = 0; i < 6; ++i) {
        add_evaluation(in_memory, measured, flash.halves(in_memory.parameters.value[0], in_memory.parameters.value[1]),
                       {});
        add_evaluation(by_file, measured, same.halves(by_file.parameters.value[0], by_file.parameters.value[1]), {});
        write_fit(by_file, a, Sync::no);
        by_file = read_fit(a);
    }
    write_fit(in_memory, b, Sync::no);
    EXPECT_EQ(file_content_hash(a), file_content_hash(b));
    EXPECT_EQ(by_file.n_evaluations(), 6u);
    for (const auto& file : {a, b}) std::filesystem::remove(file);
}

TEST(Fit, MergesBinsAsFarAsEightAreLeft) {
    EXPECT_EQ(default_merging(300), (std::vector<std::uint32_t>{32, 16, 8, 4, 2, 1}));
    EXPECT_EQ(default_merging(40), (std::vector<std::uint32_t>{4, 2, 1}));
    EXPECT_EQ(default_merging(3), (std::vector<std::uint32_t>{1}));
}

}  // namespace
}  // namespace loom::fit
