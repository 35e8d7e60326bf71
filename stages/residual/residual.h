#pragma once
// loom-residual: renders an edited scene as the sum of the old image and the difference made by the edit.
//   I_new = I_old + integral over paths of (f_new - f_old)                                     [RP] Eq. (3) to (6)

#include <optional>
#include <string>
#include <vector>

#include "formats/image.h"
#include "stages/core/edit/edit.h"
#include "stages/residual/control/coverage.h"
#include "stages/residual/dynamic_estimator.h"
#include "stages/residual/estimators.h"

namespace loom::app {
class Command;
class Report;
}  // namespace loom::app

namespace loom::residual {

struct Options {
    std::string old_scene, new_scene;  // Mitsuba XML; empty new_scene: the old file with other values
    std::vector<std::string> defines, old_defines, new_defines;  // name=value; `defines` go before those of each scene
    std::string frames;                  // table of frames: the old scene is the static one, each row a new one
    std::string only;                    // FIRST:END: frames with these numbers alone
    std::uint64_t n_graphs = 1;          // of a plan of frames: graphs that they take in turn
    std::string absent;                  // value of a parameter whose shapes a frame lacks
    std::string cache;                   // radiance cache of the static scene: the camera of frames may move
    std::optional<double> correct;       // with cache: share of the paths that are traced on behind it, unbiased
    std::string sensor;                  // of both scenes: id or index, from 0; empty: the first
    std::string old_picture;             // image of the old scene, with VarMean
    std::vector<std::string> old_graph;  // passes over the old scene: only paths that the edit touches are traced
    std::string residual;                // an existing residual: nothing is traced
    std::string output, new_picture;     // the residual, and the sum
    std::string png, residual_png;       // previews of the sum, and of the residual in false colours
    Method method = Method::automatic;
    bool no_mapping = false;  // auto, dynamic: no path mappings
    bool no_map = false;      // auto: spread camera paths evenly
    Mask mask = Mask::coverage;
    double extra = 0;         // adaptive pairs per pixel on top of old_graph, or without it in place of spp; 0: none
    std::uint64_t frame = 0;  // number of the frame, with frames
    bool parts = false;       // correlated, old_graph: layers Plus and Minus in the residual
    std::string technique;    // dynamic: an image of this family's paths alone; list: its names
    bool as_printed = false;  // dynamic: weights and Jacobian limit of [RP] as printed, biased
    bool raw = false;         // with technique: divide each path by the density of its own technique alone
    std::uint64_t spp = 4;    // pairs of paths per pixel, or samples of equal cost
    std::uint64_t first_sample = 0;
    std::uint64_t seed = 0;
    std::optional<int> max_depth;  // unset: that of the scene files
    int threads = 0;               // 0: all
    bool plan = false;             // print the edit and stop
};

void declare(app::Command& command, Options& options);

/// throws:  InputError
void run(const Options& options, app::Report& report);

/// Describes in one line which features of a method an edit turns on or off, and why.
std::string plan_of(Method method, const Edit& edit);

/// Returns old + residual.
///   L = L_old + delta_L,  var_mean = var_mean_old + var_mean_delta: their samples are independent (streams::edit)
/// out:     image  R, G, B, VarMean; Albedo, N, Depth of the residual, which has those of the new scene; samples: of
///          both;
///                 ledger: links of the old image and of the residual, whose scene the sum shows
/// needs:   VarMean in both, equal sizes, and the residual's link
Image add_residual(const Image& old_picture, const Image& residual);
/// Completes a new image whose control variate is the old one: sets its ledger. The links of the old image have the
/// remaining share of their variances, the edit's link that of its own samples.
Image take_controlled(const Image& old_picture, const Image& residual, ControlledPicture controlled);

}  // namespace loom::residual
