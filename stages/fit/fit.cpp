#include "stages/fit/fit.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <utility>

#include "formats/chain.h"
#include "formats/io/cost.h"
#include "formats/io/error.h"
#include "stages/core/app/command.h"
#include "stages/fit/charts.h"

namespace loom::fit {
namespace {

constexpr double unbounded = std::numeric_limits<double>::max();

const std::vector<std::pair<std::string, Method>> methods{
    {"lm", Method::lm}, {"adam", Method::adam}, {"gradient", Method::gradient}};
const std::vector<std::pair<std::string, Loss>> losses{
    {"squares", Loss::squares}, {"pyramid", Loss::pyramid}, {"time-cdf", Loss::time_cdf}};

template <class Enum>
std::string name_of(const std::vector<std::pair<std::string, Enum>>& names, Enum value) {
    return std::find_if(names.begin(), names.end(), [&](const auto& n) { return n.second == value; })->first;
}
template <class Enum>
Enum by_name(const std::vector<std::pair<std::string, Enum>>& names, const std::string& name) {
    return std::find_if(names.begin(), names.end(), [&](const auto& n) { return n.first == name; })->second;
}

std::vector<std::uint32_t> merging_of(const std::string& list, std::size_t n_bins) {
    std::vector<std::uint32_t> out;
    for (std::size_t at = 0; at <= list.size();) {
        const std::size_t end = std::min(list.find(',', at), list.size());
        const auto number = app::parse_number<std::uint32_t>(std::string_view(list).substr(at, end - at));
        if (!number || *number == 0 || *number > n_bins)
            throw InputError(fmt::format("--merge {}: must be numbers of bins from 1 to {}, as 8,4,2,1", list, n_bins));
        out.push_back(*number);
        at = end + 1;
    }
    return out;
}

/// Splits NAME=NUMBER[:NUMBER] and returns the place of the parameter.
std::size_t place_of(const std::string& flag, const std::string& text, const Fit& fit, double& first, double* second) {
    const std::size_t equals = text.rfind('='), colon = second ? text.find(':', equals) : std::string::npos;
    const auto wrong = [&] {
        return InputError(fmt::format("{} {}: must be NAME=NUMBER{}", flag, text, second ? ":NUMBER" : ""));
    };
    if (equals == std::string::npos || (second && colon == std::string::npos)) throw wrong();
    const auto a = app::parse_number<double>(std::string_view(text).substr(equals + 1, colon - equals - 1));
    const auto b = second ? app::parse_number<double>(std::string_view(text).substr(colon + 1)) : a;
    if (!a || !b) throw wrong();
    first = *a;
    if (second) *second = *b;
    const auto& names = fit.parameters.name;
    const auto at = std::find(names.begin(), names.end(), text.substr(0, equals));
    if (at == names.end())
        throw InputError(
            fmt::format("{} {}: the cubes have derivatives by {} alone", flag, text, fmt::join(names, ", ")));
    return std::size_t(at - names.begin());
}

/// Sets what the command line says of parameters.
void set_parameters(Fit& fit, const Options& options) {
    const std::size_t n = fit.n_parameters();
    std::vector<double> lower(n, -unbounded), upper(n, unbounded), scale(n, 0.0), mean(n, 0.0), sigma(n, 0.0);
    double a = 0, b = 0;
    for (const std::string& text : options.lower) {
        const std::size_t i = place_of("--lower", text, fit, a, nullptr);
        lower[i] = a;
    }
    for (const std::string& text : options.upper) {
        const std::size_t i = place_of("--upper", text, fit, a, nullptr);
        upper[i] = a;
    }
    for (const std::string& text : options.scale) {
        const std::size_t i = place_of("--scale", text, fit, a, nullptr);
        if (!(a > 0)) throw InputError(fmt::format("--scale {}: must be above 0", text));
        scale[i] = a;
    }
    for (const std::string& text : options.prior) {
        const std::size_t i = place_of("--prior", text, fit, a, &b);
        if (!(b > 0)) throw InputError(fmt::format("--prior {}: the standard deviation must be above 0", text));
        mean[i] = a, sigma[i] = b;
    }
    for (std::size_t i = 0; i < n; ++i) {
        const double value = fit.parameters.value[i];
        if (value < lower[i] || value > upper[i])
            throw InputError(fmt::format("{} is {}, outside of its bounds", fit.parameters.name[i], value));
        if (scale[i] == 0 && fit.parameters.scale.size() == n) scale[i] = fit.parameters.scale[i];
    }
    auto& p = fit.parameters;
    p.lower = std::move(lower), p.upper = std::move(upper), p.scale = std::move(scale);
    p.prior_mean = std::move(mean), p.prior_sigma = std::move(sigma);
}

/// Begins a fit at the values of a cube.
Fit begun(const TransientCube& cube) {
    Fit fit;
    const std::size_t n = cube.n_parameters();
    auto& p = fit.parameters;
    p.name = cube.parameters.name, p.unit = cube.parameters.unit;
    p.value = p.start = cube.parameters.value;
    p.covariance = Matrix(n * n, 0.0), p.sigma_error = std::vector<double>(n, 0.0);
    fit.state.adam_mean = std::vector<double>(n, 0.0), fit.state.adam_square = std::vector<double>(n, 0.0);
    return fit;
}

/// Checks that a cube can be compared with the measured one, and holds an evaluation of the fit.
void check_cube(const TransientCube& cube, const std::string& file, const TransientCube& measured,
                const Options& options) {
    if (cube.film.width != measured.film.width || cube.film.height != measured.film.height)
        throw InputError(fmt::format("{}: is {} x {} pixels, but {} has {} x {}", file, cube.film.width,
                                     cube.film.height, options.measured, measured.film.width, measured.film.height));
    if (const std::string other = difference_in_words(cube, measured, 1e-6); !other.empty())
        throw InputError(fmt::format("{}: {}, unlike {}", file, other, options.measured));
    if (cube.n_parameters() == 0)
        throw InputError(
            fmt::format("{}: has no derivatives; run: loom-transient GRAPH --derivative DERIVATIVE", file));
    for (std::size_t i = 0; i < cube.n_parameters(); ++i)
        if (const std::string& name = cube.parameters.name[i]; name.find_first_of(":/=\n\r") != std::string::npos)
            throw InputError(fmt::format(
                "{}: {} has no value that a scene could be given; fit a $parameter of the scene", file, name));
}

void check_values(const TransientCube& cube, const std::string& file, const Fit& fit, const std::string& state) {
    if (cube.parameters.name != fit.parameters.name)
        throw InputError(fmt::format("{}: has derivatives by {}, but {} fits {}", file,
                                     fmt::join(cube.parameters.name, ", "), state,
                                     fmt::join(fit.parameters.name, ", ")));
    for (std::size_t i = 0; i < fit.n_parameters(); ++i) {
        const double is = cube.parameters.value[i], wanted = fit.parameters.value[i];
        if (std::abs(is - wanted) > 1e-9 * std::max(std::abs(wanted), 1e-300))
            throw InputError(
                fmt::format("{}: is of {}={}, but {} needs {}", file, fit.parameters.name[i], is, state, wanted));
    }
}

int draw(const Options& options, app::Report& report) {
    if (options.state.empty()) throw InputError("--charts: needs --state");
    const std::filesystem::path name(options.charts);
    if (name.filename() != "loss.svg")
        throw InputError(fmt::format("--charts {}: must be named loss.svg", options.charts));
    check_output_path(name);
    const Fit fit = read_fit(options.state);
    std::vector<std::optional<double>> truth(fit.n_parameters());
    double value = 0;
    for (const std::string& text : options.truth) {
        const std::size_t i = place_of("--truth", text, fit, value, nullptr);
        truth[i] = value;
    }
    draw_charts(fit, truth, name.parent_path());
    for (std::size_t i = 0; i < fit.n_parameters(); ++i) {
        const double sigma = fit.sigma(i), error = truth[i] ? fit.parameters.value[i] - *truth[i] : 0;
        if (truth[i] && sigma > 0)
            report.info("{}: off by {:.3g}, {:.2g} error bars", fit.parameters.name[i], error, std::abs(error) / sigma);
    }
    report.done("{}: {} evaluations", name.native(), fit.n_evaluations());
    return app::exit_done;
}

/// Returns the cost of the whole fit: of this step, of the fit before, and of all that its cubes are made of. The cubes
/// have the same names in every evaluation, so that a chain of parents would count the last ones alone.
Cost cost_of_fit(const Options& options, Cost cost) {
    std::vector<std::filesystem::path> counted;
    for (const std::string& cube : options.cubes) {
        if (!std::filesystem::exists(cost_path(cube))) continue;
        for (const ChainFile& part : read_chain(cube)) {
            if (std::find(counted.begin(), counted.end(), part.file) != counted.end()) continue;
            counted.push_back(part.file);
            add(cost, part.cost);
        }
    }
    if (!options.state.empty() && std::filesystem::exists(cost_path(options.state)))
        add(cost, read_cost(options.state));
    return cost;
}

/// Whether a fit goes on: one that the limit of evaluations has stopped does so below a larger limit.
bool goes_on(const Fit& fit, const Rules& rules) {
    return fit.is_running() || (fit.state.status == "stopped" && fit.n_evaluations() < rules.max_evaluations);
}

/// Returns values with their error bars.
std::string in_words(const Fit& fit) {
    std::string out;
    for (std::size_t i = 0; i < fit.n_parameters(); ++i) {
        const double sigma = fit.sigma(i);
        out += fmt::format("{}{} = {:.6g}", i > 0 ? ", " : "", fit.parameters.name[i], fit.parameters.value[i]);
        if (sigma > 0) out += fmt::format(" +- {:.2g}", sigma);
    }
    return out;
}

}  // namespace

std::vector<std::uint32_t> default_merging(std::size_t n_bins) {
    std::vector<std::uint32_t> out;
    for (std::uint32_t merged = 32; merged > 1; merged /= 2)
        if (n_bins / merged >= 8) out.push_back(merged);
    out.push_back(1);
    return out;
}

std::size_t add_evaluation(Fit& fit, const TransientCube& measured, std::span<const TransientCube, 2> evaluated,
                           const Rules& rules) {
    const Loss loss = by_name(losses, fit.settings.loss);
    std::vector<std::uint64_t> paths(fit.history.paths.begin(), fit.history.paths.end());
    std::uint64_t n = 0;
    for (const TransientCube& cube : evaluated) n += cube.n_pixels() * cube.film.samples_per_pixel;
    paths.push_back(n);
    std::size_t n_ignored = 0;
    advance(
        fit,
        [&](std::uint32_t merged) {
            Equations eq = normal_equations(measured, evaluated, TimeTransform(loss, measured.time.n_bins, merged));
            n_ignored = eq.n_ignored;
            const std::size_t n_parameters = eq.n_parameters();
            for (std::size_t i = 0; i < n_parameters; ++i)
                if (!(eq.curvature[i * n_parameters + i] > 0))
                    throw InputError(fmt::format("no bin depends on {} at {}: start elsewhere, or leave it out",
                                                 fit.parameters.name[i], fit.parameters.value[i]));
            return eq;
        },
        rules);
    fit.history.paths = std::move(paths);
    return n_ignored;
}

void declare(app::Command& command, Options& options) {
    command.file("measured", options.measured,
                 "measured transient cube (.h5): of loom-transient, or any HDF5 file with mean and var_mean");
    command.files("--cube", options.cubes,
                  "two cubes of the scene at the values that the fit needs, of independent paths, with derivatives by "
                  "$parameters; without --state their values are the start");
    command.file("--state", options.state, "fit so far (.h5)");
    command.output("-o,--output", options.output, "fit with this evaluation (.h5)");
    command.output("--values", options.values, "text file of NAME=VALUE lines: where to evaluate the scene next");
    command.choice("--method", options.method,
                   "lm: Levenberg-Marquardt on the derivatives of all bins; adam; gradient: steepest descent", methods);
    command.choice(
        "--loss", options.loss,
        "what is compared: squares of the bins; pyramid: also of 2, 4, 8 ... bins together; time-cdf: of the "
        "running sums over the bins",
        losses);
    command.option("--merge", options.merge,
                   "bins that are merged into one, coarse to fine (default: 32,16,8,4,2,1, as far as 8 bins are left)");
    command.option("--lower", options.lower, "NAME=NUMBER: smallest value of a parameter; may be repeated");
    command.option("--upper", options.upper, "NAME=NUMBER: largest value");
    command.option("--scale", options.scale,
                   "NAME=NUMBER: longest step, and reach of starts from elsewhere (default: not limited)");
    command.option("--prior", options.prior, "NAME=MEAN:SIGMA: Gaussian prior of a parameter");
    Rules& rules = options.rules;
    command.option("--max-evaluations", rules.max_evaluations, "evaluations after which the fit ends",
                   app::Range<std::uint32_t>{1, 100000});
    command.option("--tolerance", rules.tolerance, "lm ends at a step shorter than so many error bars",
                   app::Range<double>{1e-3, 10});
    command.option("--averaged", rules.averaged,
                   "evaluations near the minimum, at the finest bins, whose mean the result of lm is",
                   app::Range<std::uint32_t>{1, 10000});
    command.option("--restarts", rules.max_restarts,
                   "starts from elsewhere, where lm ends in a minimum that does not explain the measurement",
                   app::Range<std::uint32_t>{0, 100});
    command.option("--rate", rules.rate, "first step of adam, in scales", app::Range<double>{1e-6, 10});
    command.option("--seed", rules.seed, "seed of starts from elsewhere");
    command.output(
        "--charts", options.charts,
        "draw the fit of --state: loss.svg with this name, and beside it parameters.svg, both as PNG too, and fit.tsv");
    command.option("--truth", options.truth, "NAME=NUMBER: value to compare with, in charts and messages");
    command.flag("--done", options.done, "exit 1 if the fit of --state goes on, within --max-evaluations, else 0");
    command.example("loom-fit measured.h5 --cube a.h5 b.h5 -o fit-1.h5 --values values.txt");
    command.example("loom-fit measured.h5 --cube a.h5 b.h5 --state fit-1.h5 -o fit-2.h5 --values values.txt");
}

int run(const Options& options, app::Report& report) {
    if (options.done) {
        if (options.state.empty()) throw InputError("--done: needs --state");
        return goes_on(read_fit(options.state), options.rules) ? app::exit_no : app::exit_done;
    }
    if (!options.charts.empty()) return draw(options, report);
    if (options.measured.empty()) throw InputError("measured: missing (a transient cube)");
    if (options.output.empty()) throw InputError("--output: missing (a .h5 file)");
    check_output_path(options.output);
    if (options.cubes.size() != 2)
        throw InputError(fmt::format("--cube: {} files; a fit needs two of independent paths", options.cubes.size()));

    // Read the inputs, and check that they belong together.
    const bool ours = is_transient_cube(options.measured);
    const TransientCube measured = ours ? read_transient_cube(options.measured) : read_any_cube(options.measured);
    const std::array<TransientCube, 2> cubes{read_transient_cube(options.cubes[0]),
                                             read_transient_cube(options.cubes[1])};
    for (std::size_t i = 0; i < 2; ++i) check_cube(cubes[i], options.cubes[i], measured, options);
    const InputId measured_id = identify(options.measured);
    std::vector<InputId> ids{measured_id, identify(options.cubes[0]), identify(options.cubes[1])};
    if (ids[1].hash == ids[2].hash)
        throw InputError(fmt::format("--cube: {} and {} are the same; their noise must be independent",
                                     options.cubes[0], options.cubes[1]));
    Fit fit = options.state.empty() ? begun(cubes[0]) : read_fit(options.state);
    const std::string state = options.state.empty() ? options.cubes[0] : options.state;
    for (std::size_t i = 0; i < 2; ++i) check_values(cubes[i], options.cubes[i], fit, state);
    if (!options.state.empty()) {
        ids.push_back(identify(options.state));
        if (fit.measured != measured_id.hash)
            throw InputError(
                fmt::format("{}: is a fit to another measurement than {}", options.state, options.measured));
        if (!goes_on(fit, options.rules))
            throw InputError(fmt::format("{}: has ended ({})", options.state, fit.state.status));
        fit.state.status = "running";
    }
    fit.measured = measured_id.hash;
    fit.settings.method = name_of(methods, options.method);
    fit.settings.loss = name_of(losses, options.loss);
    std::vector<std::uint32_t> merging =
        options.merge.empty() ? default_merging(measured.time.n_bins) : merging_of(options.merge, measured.time.n_bins);
    fit.state.level = std::min(fit.state.level, std::uint32_t(merging.size() - 1));
    fit.settings.merged_bins = std::move(merging);
    set_parameters(fit, options);

    // Step, and write.
    const std::string plan = fmt::format(
        "on: {} by {}, {} bins merged, two halves; off: {}", fit.settings.loss, fit.settings.method,
        fit.settings.merged_bins[fit.state.level],
        fit.state.level + 1 == fit.settings.merged_bins.size() ? "coarser bins (done)" : "finer bins (later)");
    report.info("plan: {}", plan);
    const std::size_t n_ignored = add_evaluation(fit, measured, cubes, options.rules);
    if (n_ignored > 0)
        report.warn("{} values are NaN or infinite in one of the cubes; the fit leaves them out", n_ignored);
    fit.provenance = report.provenance(options.rules.seed, ids, plan);
    const std::size_t last = fit.n_evaluations() - 1;
    report.info("evaluation {}: loss {:.4g} +- {:.2g} (true values: {:.4g}), {}", last + 1, fit.history.loss[last],
                fit.history.loss_sigma[last], fit.best.expected_loss,
                fit.history.accepted[last] ? "taken" : "step taken back");
    if (!options.values.empty()) {
        std::string text;
        for (std::size_t i = 0; i < fit.n_parameters(); ++i)
            text += fmt::format("{}={}\n", fit.parameters.name[i], app::number_text(fit.parameters.value[i]));
        write_text_file(options.values, text);
    }
    write_fit(fit, options.output);
    write_cost_of(options.output, cost_of_fit(options, report.cost(plan)), {});
    constexpr double large = 0.3;
    for (std::size_t i = 0; i < fit.n_parameters() && !fit.is_running(); ++i)
        if (const double error = fit.parameters.sigma_error[i]; error > large)
            report.warn(
                "{}: its error bar is uncertain by {:.0f} % for the noise of the derivatives: more samples, or a "
                "larger --effort of loom-derive",
                fit.parameters.name[i], 100 * error);
    report.done("{}{}", fit.is_running() ? "next: " : fit.state.status + ": ", in_words(fit));
    return app::exit_done;
}

}  // namespace loom::fit
