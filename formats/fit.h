#pragma once
// fit: state of a fit of scene parameters to a measured transient cube, after one more evaluation of the scene.
//
// A fit is a chain of such files: each names the values at which the scene is to be evaluated next, and holds the whole
// history, so that any of them can be continued.

#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "formats/io/field.h"
#include "formats/io/mapped_file.h"
#include "formats/io/output_file.h"
#include "formats/io/provenance.h"

namespace loom {

struct Fit {
    static constexpr FormatId format{"fit", 1, 0};

    std::string measured;  // content hash of the measured cube, as in Provenance::inputs

    struct Settings {
        std::string method = "lm";     // or "adam", "gradient"
        std::string loss = "pyramid";  // or "squares", "time-cdf"
        Column<std::uint32_t> merged_bins;
    } settings;

    struct Parameters {
        std::vector<std::string> name, unit;
        CopiedColumn<double> value, start, lower, upper, scale, prior_mean, prior_sigma, covariance, sigma_error;
    } parameters;

    /// A point with its equations, both means over near evaluations.
    struct Point {
        std::uint32_t evaluations = 0;
        double loss = 0, loss_variance = 0, expected_loss = 0, expected_variance = 0;
        CopiedColumn<double> value, gradient, normal, normal_variance, curvature, measured_noise, noise, scatter;
    };
    Point best;     // of the present run, at its present bins
    Point minimum;  // the lowest in which a run has ended, at the finest bins; empty: none

    struct State {
        std::string status = "running";  // or "converged", "stopped"
        std::uint32_t level = 0, at_level = 0, restarts = 0;
        double lambda = 0;
        Column<double> adam_mean, adam_square;
    } state;

    struct History {
        Column<double> value, loss, loss_sigma, lambda;
        Column<std::uint32_t> merged_bins;
        Column<std::uint64_t> paths;
        Column<std::uint8_t> accepted;
    } history;

    Provenance provenance;
    std::shared_ptr<const MappedFile> storage;

    std::size_t n_parameters() const { return parameters.name.size(); }
    std::size_t n_evaluations() const { return history.loss.size(); }
    bool is_running() const { return state.status == "running"; }
    /// Returns the error bar of a parameter; 0: not known.
    double sigma(std::size_t parameter) const;

    /// Returns the first violated invariant beyond types, lengths and finite floats; empty: none.
    std::string problem() const;

    template <class Self, class Visitor>
    static void fields(Self& f, Visitor& v);
};

/// needs:   columns that share an axis have the same length
void write_fit(const Fit& fit, const std::filesystem::path& path, Sync sync = Sync::yes);
/// Reads, maps and checks the whole file.
/// throws:  InputError naming the file and the dataset
Fit read_fit(const std::filesystem::path& path);

template <class Self, class Visitor>
void Fit::fields(Self& f, Visitor& v) {
    v.value("measured/hash", f.measured, "", "1", "content hash (XXH64, 16 hexadecimal digits) of the measured cube");

    auto& s = f.settings;
    v.value("settings/method", s.method, "", "1", "lm, adam or gradient");
    v.value("settings/loss", s.loss, "", "1", "squares, pyramid or time-cdf");
    v.field("settings/merged_bins", s.merged_bins, 1, "level", "1", "bins that are merged into one, coarse to fine");

    auto& p = f.parameters;
    v.names("parameters/name", p.name, "parameter", "$parameter of the scene");
    v.names("parameters/unit", p.unit, "parameter", "unit of one step of the parameter");
    const std::size_t n = p.name.size();
    constexpr std::string_view unit = "parameters/unit";
    v.field("parameters/value", p.value, 1, "parameter", unit,
            "where the scene is to be evaluated next; of an ended fit: the result");
    v.field("parameters/start", p.start, 1, "parameter", unit, "values of the first evaluation");
    v.field("parameters/lower", p.lower, 1, "parameter", unit, "smallest value allowed; -1.8e308: none");
    v.field("parameters/upper", p.upper, 1, "parameter", unit, "largest value allowed; 1.8e308: none");
    v.field("parameters/scale", p.scale, 1, "parameter", unit, "size of a large step; 0: not given");
    v.field("parameters/prior_mean", p.prior_mean, 1, "parameter", unit, "mean of the Gaussian prior");
    v.field("parameters/prior_sigma", p.prior_sigma, 1, "parameter", unit, "its standard deviation; 0: no prior");
    v.grid("parameters/covariance", p.covariance, {n}, "parameter,parameter", "product of parameters/unit",
           "covariance of the result by the noise of the measurement and of the last evaluations; 0: not known");
    v.field("parameters/sigma_error", p.sigma_error, 1, "parameter", "1",
            "relative standard error of its standard deviation by the noise of the derivatives, at most");

    const auto point = [&](const char* name, auto& b, Presence presence, const std::string& of) {
        const auto member = [&](const char* what) { return std::string(name) + "/" + what; };
        constexpr std::string_view squared = "1 / product of parameters/unit";
        v.value(member("evaluations"), b.evaluations, "", "1", of + "evaluations whose mean it is");
        v.value(member("loss"), b.loss, "", "1", "sum of weighted squares, the noise of the evaluation taken off");
        v.value(member("loss_variance"), b.loss_variance, "", "1", "its variance by the noise of the evaluation");
        v.value(member("expected_loss"), b.expected_loss, "", "1", "loss of the true values: noise of the measurement");
        v.value(member("expected_variance"), b.expected_variance, "", "1", "variance of the loss of the true values");
        const auto numbers = [&](const char* what, auto& column, std::vector<std::size_t> row, std::string_view axes,
                                 std::string_view units, std::string_view text) {
            if (presence == Presence::required)
                v.grid(member(what), column, std::move(row), axes, units, text);
            else
                v.optional_grid(member(what), column, std::move(row), axes, units, text);
        };
        numbers("value", b.value, {}, "parameter", unit, "where it is");
        numbers("gradient", b.gradient, {}, "parameter", "1 / parameters/unit", "half the descent of the loss");
        numbers("normal", b.normal, {n}, "parameter,parameter", squared, "J^T W J without the noise of J");
        numbers("normal_variance", b.normal_variance, {}, "parameter", squared,
                "variance of the diagonal of normal, at most");
        numbers("curvature", b.curvature, {n}, "parameter,parameter", squared,
                "J^T W J of the mean J: positive definite, too large by its noise");
        numbers("measured_noise", b.measured_noise, {n}, "parameter,parameter", squared,
                "covariance of gradient by the noise of the measurement");
        numbers("noise", b.noise, {n}, "parameter,parameter", squared, "and by the noise of one evaluation");
        numbers("scatter", b.scatter, {n}, "parameter,parameter", squared,
                "sum over pixels of squares of their gradients: at a minimum its covariance of one evaluation, noise "
                "of J and "
                "misfit included");
    };
    point("best", f.best, Presence::required, "best evaluation of the present run, at its present bins: ");
    point("minimum", f.minimum, Presence::optional, "lowest end of a run at the finest bins, 0 without one: ");

    auto& t = f.state;
    v.value("state/status", t.status, "", "1", "running, converged, or stopped: by the limit of evaluations");
    v.value("state/level", t.level, "", "1", "row of settings/merged_bins");
    v.value("state/at_level", t.at_level, "", "1", "evaluations at this level");
    v.value("state/restarts", t.restarts, "", "1", "starts from elsewhere so far");
    v.value("state/lambda", t.lambda, "", "1", "damping of lm");
    v.field("adam/mean", t.adam_mean, 1, "parameter", "1 / parameters/unit", "running mean of the gradient");
    v.field("adam/square", t.adam_square, 1, "parameter", "1 / parameters/unit^2", "running mean of its square");

    auto& h = f.history;
    v.grid("history/value", h.value, {n}, "evaluation,parameter", unit, "where the scene was evaluated");
    v.field("history/loss", h.loss, 1, "evaluation", "1", "as best/loss; of one level comparable");
    v.field("history/loss_sigma", h.loss_sigma, 1, "evaluation", "1", "its standard deviation");
    v.field("history/lambda", h.lambda, 1, "evaluation", "1", "damping of the step that led there");
    v.field("history/merged_bins", h.merged_bins, 1, "evaluation", "1", "of its level");
    v.field("history/accepted", h.accepted, 1, "evaluation", "1", "1: the fit went on from there");
    v.field("history/paths", h.paths, 1, "evaluation", "1", "paths of its cubes");
}

}  // namespace loom
