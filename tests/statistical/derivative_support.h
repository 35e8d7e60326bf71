#pragma once
// Shared code of the statistical tests of derivatives: replicates of a derivative in bins, split by estimator.

#include <array>
#include <filesystem>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "formats/derivative.h"
#include "stages/core/graph/time_of_flight.h"
#include "stages/core/graph/time_response.h"
#include "stages/core/stats/student.h"
#include "stages/derive/derive.h"
#include "tests/traced_graph.h"

namespace loom {

/// A scene with what its parameters change.
struct DerivableScene {
    std::unique_ptr<Scene> scene;
    derive::SceneTangents tangents;

    /// in:      wrt  parameters, as in `loom-derive --wrt`
    DerivableScene(const std::filesystem::path& file, const std::vector<std::string>& wrt, const Defines& defines = {});

  private:
    DerivableScene(std::unique_ptr<Scene> built, const SceneDescription& description, const std::filesystem::path& file,
                   const std::vector<std::string>& wrt, const Defines& defines);
};

/// Traces a graph with all columns that derivatives require.
PathGraph trace_derivable(const Scene& scene, std::uint64_t spp, std::uint64_t seed);

/// Differentiates a graph as loom-derive does.
/// in:      off  parts to leave out
Derivative differentiate(const PathGraph& graph, const DerivableScene& scene, std::uint64_t seed,
                         const std::vector<std::string>& off = {},
                         derive::Attachment attachment = derive::Attachment::automatic);

/// A set of boundary families, one bit for each.
using BoundarySet = unsigned;
inline constexpr BoundarySet primary_edges = 1, direct_edges = 2 + 4 + 16, indirect_edges = 8, all_edges = 31;
/// Returns its name, for messages.
const char* name_of(BoundarySet boundaries);

/// Values and derivatives of one graph by one parameter, in bins and then the sum over all times.
struct DerivedBins {
    std::size_t n_pixels = 0, n_bins = 0;
    std::vector<double> value, derivative, var_mean;                // [pixel, bin, rgb]; var_mean of derivative
    std::vector<double> steady_value, steady;                       // [pixel, rgb]
    std::array<std::vector<double>, n_boundary_families> boundary;  // shares of `derivative`
    std::array<std::vector<double>, n_boundary_families> steady_boundary;

    /// Returns the sum over all times without some boundaries, see BoundarySet.
    std::vector<double> steady_without(BoundarySet boundaries) const;
};

/// in:      derivative  null: values alone
DerivedBins bins_of(const PathGraph& graph, const Derivative* derivative, const TimeResponse& response,
                    std::size_t parameter = 0, const Timing& timing = {});

using Samples = std::vector<std::vector<double>>;  // [replicate][number]

/// Chi-square of Welch's t of some numbers.
struct Agreement {
    double chi2 = 0, p = 1, worst = 0;
    int n = 0;  // numbers that vary
    std::size_t worst_number = 0;
    Estimate worst_a, worst_b;
};
/// in:      a     replicates at places in order, see place_in()
///          keep  which numbers
Agreement compare_numbers(
    const Samples& a, const Samples& b,
    const std::function<bool(std::size_t)>& keep = [](std::size_t) { return true; });

/// Returns place i of n, one in each of n equal parts of [-1, 1]. A central difference of any step is the mean of the
/// derivative over the interval, so that the mean over these places has no bias of a step.
double place_in(int i, int n);

/// Response of a delta pulse in the bins of a scene's film.
TimeResponse film_response(const Scene& scene);

}  // namespace loom
