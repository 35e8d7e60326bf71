#pragma once
// loom-compare: errors of images or transient cubes against a reference, their significance, and their cost.

#include <span>
#include <string>
#include <vector>

#include "stages/compare/chain.h"
#include "stages/compare/metrics.h"
#include "stages/compare/pools.h"
#include "stages/compare/significance.h"

namespace loom::app {
class Command;
class Report;
}  // namespace loom::app

namespace loom::compare {

struct Options {
    std::vector<std::string> inputs;  // [LABEL=]FILE; inputs with equal label and samples are replicates
    std::string reference;            // empty: the second of two inputs
    std::string reference_variance;   // RGB: variance of the reference's pixels; empty: its VarMean layer
    std::string scene;                // name of the image in the tables
    double exposure_ev = 0;           // exposure for psnr and ssim
    bool cost = false;                // sum the costs along the chain of parents
    bool json = false, tsv = false;   // instead of text
    bool sequence = false;            // inputs and reference are the frames of animations
    bool spectrum = false;            // of their errors in time
    bool by_frame = false;            // inputs are frames of animations: cost and expected error of each
    std::string difference;           // difference image (.exr), false colours beside it (.png)
    double reach = 0;                 // range of the false colours; 0: the 99th percentile
    std::string parameter;            // cubes: compare the derivatives by this parameter; empty: the radiance
    double pool_error = 0.05;         // cubes: relative standard error at which a pool of bins is complete
    std::vector<std::string> fail_above, fail_below;  // METRIC=VALUE
};

/// Figures of one input; NaN where unknown. Figures of a group of replicates are equal in all of them.
struct Measured {
    std::string method, file;
    std::uint64_t samples = 0;  // per pixel; 0: not stored in the file
    std::uint64_t replicate = 0;
    double mse, rmse, relmse, relmse_trimmed, relmse_net, mse_net, mape, psnr, ssim;
    double corr_right, corr_down, corr_near;
    double bias2, variance, reference_noise, p_image, p_tiles;  // of the group
    double p_pixels, p_bins, z_rms;                             // of the group, of cubes
    double cpu_s, wall_s, render_s, rays, peak_memory_bytes;    // with --cost
};

/// A number of Measured by its name in tables, --fail-above and loom-chart.
struct Column {
    const char* name;
    double Measured::*value;
    bool of_group;  // the same in all replicates
};
std::span<const Column> columns();

/// Replicates: inputs with the same label and samples per pixel.
struct Group {
    std::vector<Measured> replicates;
    Significance significance;
    std::vector<PoolTests> pools;     // of cubes
    std::vector<double> tile_errors;  // [tile] sum of the squared relative errors, mean over the replicates

    std::string method() const { return replicates[0].method; }
    std::uint64_t samples() const { return replicates[0].samples; }
    /// Returns the mean over the replicates, and the standard error from their spread (NaN for one).
    Estimate estimate(double Measured::*value) const;
};

/// Improvement of a group over the first group, as a ratio of relMSE.
struct Gain {
    Ratio error;           // relMSE of the first group over relMSE of this group
    double equal_cpu = 0;  // that ratio at equal CPU time, if relMSE falls as 1/time; NaN without costs
};
Gain gain_of(const Group& first, const Group& group);

struct Comparison {
    std::string scene, reference;
    std::size_t width = 0, height = 0, n_bins = 0;  // n_bins: 0 for images
    std::vector<Group> groups;                      // in the order of their first input
};

/// Formats a comparison as a table.
std::string text_of(const Comparison& comparison);
std::string json_of(const Comparison& comparison);
std::string tsv_of(const Comparison& comparison);

/// Costs of one input by stage.
struct InputCost {
    std::string scene, method, file;
    std::uint64_t samples = 0, replicate = 0;
    std::vector<StageCost> stages;
};
std::string text_of(std::span<const InputCost> costs);
std::string json_of(std::span<const InputCost> costs);
std::string tsv_of(std::span<const InputCost> costs);

/// Binds the options to the command line; `options` must outlive `command`.
void declare(app::Command& command, Options& options);

/// out:     exit code: 1 when a limit of fail_above or fail_below is exceeded or cannot be judged, else 0
/// throws:  InputError when an input is no image, does not fit the reference, or occurs twice; when costs are missing
int run(const Options& options, app::Report& report);

}  // namespace loom::compare
