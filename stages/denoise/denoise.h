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
    std::string oidn;   // libOpenImageDenoise.so.2 or its folder
    int threads = 0;    // 0: all
    bool plan = false;  // print the plan and stop
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

}  // namespace loom::denoise
