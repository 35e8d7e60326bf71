#include "formats/fit.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "formats/io/hdf5_format.h"

namespace loom {

std::string Fit::problem() const {
    const auto one_of = [](const std::string& text, std::initializer_list<const char*> allowed) {
        return std::find(allowed.begin(), allowed.end(), text) != allowed.end();
    };
    if (!one_of(settings.method, {"lm", "adam", "gradient"}))
        return fmt::format("settings/method: is {}, expected lm, adam or gradient", settings.method);
    if (!one_of(settings.loss, {"squares", "pyramid", "time-cdf"}))
        return fmt::format("settings/loss: is {}, expected squares, pyramid or time-cdf", settings.loss);
    if (!one_of(state.status, {"running", "converged", "stopped"}))
        return fmt::format("state/status: is {}, expected running, converged or stopped", state.status);
    if (n_parameters() == 0) return "parameters/name: is empty";
    if (settings.merged_bins.empty()) return "settings/merged_bins: is empty";
    if (std::find(settings.merged_bins.begin(), settings.merged_bins.end(), 0u) != settings.merged_bins.end())
        return "settings/merged_bins: a row is 0";
    if (state.level >= settings.merged_bins.size())
        return fmt::format("state/level: is {}, but settings/merged_bins has {} rows", state.level,
                           settings.merged_bins.size());
    const auto& p = parameters;
    for (std::size_t i = 0; i < n_parameters(); ++i) {
        if (!(p.lower[i] <= p.value[i] && p.value[i] <= p.upper[i]))
            return fmt::format("parameters/value: {} is {}, not in {} to {}", p.name[i], p.value[i], p.lower[i],
                               p.upper[i]);
        if (p.scale[i] < 0 || p.prior_sigma[i] < 0)
            return fmt::format("parameters/{}: of {} is negative", p.scale[i] < 0 ? "scale" : "prior_sigma", p.name[i]);
    }
    return {};
}

double Fit::sigma(std::size_t parameter) const {
    return std::sqrt(std::max(parameters.covariance[parameter * n_parameters() + parameter], 0.0));
}

void write_fit(const Fit& fit, const std::filesystem::path& path, Sync sync) {
    write_format(fit, path, sync);
}

Fit read_fit(const std::filesystem::path& path) {
    return read_format<Fit>(path);
}

}  // namespace loom
