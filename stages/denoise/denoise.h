#pragma once
// loom-denoise: denoises an image, with Open Image Denoise where it is found, else with the built-in filter.

#include <string>
#include <vector>

#include "formats/image.h"
#include "stages/denoise/layers.h"

namespace loom::app {
class Command;
class Report;
}  // namespace loom::app

namespace loom::denoise {

enum class Method { automatic, oidn, filter };

struct Options {
    std::string image;       // image with layers (.exr)
    std::string output;      // the denoised image
    std::string png;         // 8-bit preview
    double exposure_ev = 0;  // of the preview
    Method method = Method::automatic;
    std::string base;           // old image of which the image is a weighted part, denoised apart from the difference
    std::string denoised_base;  // of it, if it exists already
    std::string oidn;           // libOpenImageDenoise.so.2 or its folder
    int threads = 0;            // 0: all
    bool plan = false;          // print the plan and stop
};

void declare(app::Command& command, Options& options);

/// throws:  InputError when the image has no finite pixel, or when --method oidn finds no library
void run(const Options& options, app::Report& report);

/// Layers of an image in the form that the denoisers take; all values are finite.
struct Prepared {
    Layers layers;  // spans into `storage`
    std::vector<std::vector<float>> storage;
    std::uint64_t n_bad_pixels = 0;  // pixels whose colour was NaN or infinite
    std::uint64_t n_bad_values = 0;  // NaN or infinite values of all other layers
};

/// Collects the layers of an image. NaN and infinities are replaced by the mean of the finite values in the smallest
/// square around the pixel that has any: (2 r + 1)^2 pixels with r = 1, 2, 4, … The variance layer of an image with one
/// sample per pixel carries no information and is dropped; negative variances count as 0.
/// throws:  InputError when a channel of the colour has no finite value
Prepared prepare(const Image& image);

/// The old image in a new one of loom-residual:  new = weight * old + difference. The noise of a difference to which few
/// paths contribute has no like in the image: apart, the old image keeps its details, and zeros beside the difference do
/// not hide that it is smooth. Where the difference is as noisy as paths of its own, it has the structure of both scenes,
/// and the image as a whole is denoised better (docs/animation.md).
struct OldPart {
    Image base;
    std::vector<float> weight[3], denoised[3];  // denoised: of the base; empty: not yet
    /// By pixel: share of the image denoised as a whole, the greatest of 1 - weight, twice its mean over the filter's window,
    /// and the variance of the difference over that of as many old paths, both means over the window. At the border of where
    /// the old image has no weight, half of the window shows what it does not know: there the difference has an edge that
    /// no feature explains, and a light that moved away would leave its outline.
    std::vector<float> share_of_sum;
    double mean_share = 0;

    // One filter does where one part is nearly all.
    bool needs_sum() const { return mean_share > 0.05; }
    bool needs_difference() const { return mean_share < 0.6; }
    std::string plan() const;
};

/// in:      image  with Weight (else 1) and a ledger
/// needs:   equal sizes, VarMean in both
OldPart old_part_of(const Image& image, Image base);
/// Returns new - weight * old, with the variance that is left of the image's, and the image's features.
Image difference_of(const Image& image, const OldPart& part);

}  // namespace loom::denoise
