#pragma once
// Charts of a fit: its loss and its parameters by evaluation.

#include <filesystem>
#include <optional>
#include <vector>

#include "formats/fit.h"

namespace loom::fit {

/// Writes loss.svg and parameters.svg, each with a .png, and fit.tsv and fit.gp that they are made of.
/// in:      truth   [parameter] values to compare with; none: not known
/// throws:  as plot::make_pictures()
void draw_charts(const Fit& fit, const std::vector<std::optional<double>>& truth, const std::filesystem::path& folder);

}  // namespace loom::fit
