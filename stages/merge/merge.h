#pragma once
// loom-merge: joins images of the same picture, or transient cubes, with different samples, with exact moments.

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
    std::vector<std::string> parts;  // images or transient cubes, in the order in which they are summed
    std::vector<std::string> minus;  // of the scene before an edit, one for each part and of the same random numbers
    std::string output;              // the joined image or cube
    bool zip = false;                // compress the output
    std::string direct;              // emission and direct light by themselves, to be blended in
    bool no_blend = false;           // leave the parts' own picture as it is
    std::uint64_t unbiased = 0;      // so many parts correct all of them by what their paths alone say; 0: none
    bool plan_direct = false;        // say how many samples of direct light pay, and stop
};

/// Binds the options to the command line; `options` must outlive `command`.
void declare(app::Command& command, Options& options);

/// throws:  InputError when a part is no image, has no samples or variance, or does not fit the others
void run(const Options& options, app::Report& report);

/// What a part says of an array of numbers, channel of an image or row of a cube.
struct PartOf {
    std::uint64_t samples;  // at least 1
    std::span<const float> mean, var_mean;
};
/// The mean over all samples of the parts together, and its variance.
///   N = sum n_i,   mean = sum n_i m_i / N
///   s^2 = sum [(n_i - 1) s_i^2 + n_i (m_i - mean)^2] / (N - 1),   var_mean = s^2 / N,   s_i^2 = n_i var_mean_i
std::vector<double> pooled_mean(std::span<const PartOf> parts);
std::vector<double> pooled_var_mean(std::span<const PartOf> parts);

/// The image of all samples of the parts together (pooled_mean, pooled_var_mean).
/// in:      parts   with equal sizes and channels; every `samples` at least 1
/// out:     image   layers other than R, G, B and VarMean are means weighted by samples
/// throws:  InputError naming the part (by `names`) that does not fit
/// differs: exact for pixels whose samples weigh alike; pixel filters that weigh them make it approximate
Image merge_images(std::span<const Image> parts, std::span<const std::string> names);

/// What an edit changes, by two pictures of the same random numbers, before and after.
///   after - before, of R, G, B and all layers of estimates; Albedo, N, Depth of `after`
/// out:     no VarMean: the noise of one is partly that of the other, and how far no pair knows. The spread over pairs
///          with their own random numbers does (average_images).
/// throws:  InputError (by the names) when the two do not fit
Image difference_of(const Image& after, const Image& before, const std::string& after_name,
                    const std::string& before_name);

/// The same of transient cubes, row by row: neither parts nor result are ever held.
/// throws:  InputError naming the part of another size, window or response
void run_cubes(const Options& options, app::Report& report);

}  // namespace loom::merge
