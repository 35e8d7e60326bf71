#pragma once
// loom-merge: merges images of one scene, or transient cubes, with different samples, with exact moments.

#include <span>
#include <string>
#include <vector>

#include "formats/image.h"

namespace loom::app {
class Command;
class Report;
}  // namespace loom::app

namespace loom::merge {

struct Options {
    std::vector<std::string> parts;  // images or transient cubes, in the order of summation
    std::vector<std::string> minus;  // images before an edit, one per part and with the same random streams
    std::string quotient;            // NAME=LOW:HIGH: of cubes, write the difference quotient by this parameter
    std::string output;              // the merged image or cube
    bool zip = false;                // compress the output
    std::string direct;              // image of emission and direct light alone, to be blended in
    bool no_blend = false;           // keep the parts' own images unblended
    std::uint64_t unbiased = 0;      // number of parts whose paths alone correct the bias of all; 0: none
    bool plan_direct = false;        // print how many direct-light samples pay, and stop
};

/// Binds the options to the command line; `options` must outlive `command`.
void declare(app::Command& command, Options& options);

/// throws:  InputError when a part is no image, has no samples or variance, or does not fit the others
void run(const Options& options, app::Report& report);

/// One part's samples, mean and variance of an array: a channel of an image or a row of a cube.
struct PartOf {
    std::uint64_t samples;  // at least 1
    std::span<const float> mean, var_mean;
};
/// Mean over all samples of the parts together, and its variance.
///   N = sum n_i,   mean = sum n_i m_i / N
///   s^2 = sum [(n_i - 1) s_i^2 + n_i (m_i - mean)^2] / (N - 1),   var_mean = s^2 / N,   s_i^2 = n_i var_mean_i
std::vector<double> pooled_mean(std::span<const PartOf> parts);
std::vector<double> pooled_var_mean(std::span<const PartOf> parts);

/// Merges the samples of all parts (pooled_mean, pooled_var_mean).
/// in:      parts   with equal sizes and channels; every `samples` at least 1
/// out:     image   layers other than R, G, B and VarMean are means weighted by samples
/// throws:  InputError naming the part (by `names`) that does not fit
/// differs: exact for pixels with equal sample weights; approximate with pixel filters that weigh samples
Image merge_images(std::span<const Image> parts, std::span<const std::string> names);

/// Returns the change of an edit from two images with the same random streams, before and after.
///   after - before, of R, G, B and all layers of estimates; Albedo, N, Depth of `after`
/// out:     no VarMean: the noise of both is correlated, to a degree that one pair does not determine. The spread over
///          pairs with their own random streams does (average_images).
/// throws:  InputError (by the names) when the two do not fit
Image difference_of(const Image& after, const Image& before, const std::string& after_name,
                    const std::string& before_name);

/// Merges transient cubes row by row; neither parts nor result are held in memory.
/// throws:  InputError naming the part with another size, window or response
void run_cubes(const Options& options, app::Report& report);

/// Writes a cube with the derivative by one parameter as the difference quotient of cubes with two of its values.
///   derivative = mean over pairs of (part - minus) / (HIGH - LOW);   value: mean of both
/// out:     variance of the derivative from the spread between pairs; of one pair, an upper bound
/// throws:  InputError naming the cube that does not fit the first, or has another seed than its partner
void run_quotient(const Options& options, app::Report& report);

}  // namespace loom::merge
