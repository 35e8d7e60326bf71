#pragma once
#include <string>

#include "formats/image.h"
#include "formats/path_graph.h"

namespace loom::app {
class Command;
class Report;
}  // namespace loom::app

namespace loom::gather {

struct Options {
    std::string graph;      // path graph
    std::string output;     // image with layers (.exr)
    std::string png;        // preview for the eye
    double exposure_ev = 0; // of the preview
    int threads = 0;        // 0: all
};

void declare(app::Command& command, Options& options);

/// Adds up the radiance of every stored path:
///   L = Le + sum_j beta_j sum_(light edges of j) w f cos Li / pdf,   beta_(j+1) = beta_j f cos / pdf_w
/// The BSDFs are evaluated again from what the vertices hold; the image equals that of `loom-trace -o x.exr` to
/// rounding.
Image path_traced_image(const PathGraph& graph, int threads);

/// throws: InputError
void run(const Options& options, app::Report& report);

}  // namespace loom::gather
