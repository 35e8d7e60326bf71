#pragma once
// How many samples the image of the static scene should have, and from how many frames on it pays.

#include <cstdint>
#include <memory>
#include <vector>

#include "stages/core/edit/animation.h"
#include "stages/core/tracing/path_tracer.h"

namespace loom::residual {

/// Variances of one path, sum over channels, mean over pixels; costs in those of a path that is traced.
struct FramePilot {
    double still = 0, fresh = 0;  // variance of alpha f_old in the static scene, and of paths of frames
    double difference = 0;        // of f_new - alpha f_old, alpha as graph_control() has it
    double touched = 0;           // share of the paths that a frame traces again
    double again = 2;             // cost of one of them; they are longer than most. Dimmed lights alone: no ray

    /// Cost of a stored path in a frame: to read it, and to trace some again. Measured for 1.8 to 13 % touched paths: 0.09 to
    /// 0.5 (docs/residual.md), the more the simpler the scene; lights that move or turn: 1.0 to 1.9; that are dimmed: .6.
    double cost() const { return again * touched + 0.1; }
};

/// A frame has the variance of the static image and of its difference,
///   V = V_s / n_s + V_d / n,
/// F frames cost n_s + G n g (the graphs) + F n c, path tracing of the same variance F V_fresh / V. For a given n variance
/// times cost is least at n_s = n sqrt((G g + F c) V_s / V_d); more than the F n of path tracing is
/// never taken: beyond, the static image alone would cost more than all frames of as many samples as are asked for.
struct FramePlan {
    static constexpr double graph = 1.6;  // g: cost of a path that is traced and stored; measured: 1.45 to 1.75
    /// Predicted gain below which frames are path traced: costs of small frames differ by as much from those counted here.
    static constexpr double least_gain = 1.2;

    std::uint64_t still_spp = 1;   // of the static image
    double gain = 0;               // cost of path tracing of equal error over that of the frames
    std::uint64_t break_even = 0;  // number of frames from which on the gain is 1; 0: none below a million

    /// in:      spp  of each graph;  n_graphs  G, of which each frame takes one
    FramePlan(const FramePilot& pilot, std::uint64_t spp, std::uint64_t n_frames, std::uint64_t n_graphs = 1);
};

/// Looks at some paths of a few frames, at most a 25th of the paths that path tracing of all frames would take.
/// in:      path  options of the pilot, its seed included
/// throws:  InputError for a frame that is no scene
FramePilot look_at_frames(const Animation& animation, const std::shared_ptr<const Scene>& still,
                          const std::vector<Frames::Frame>& frames, const PathOptions& path, std::uint64_t spp);

}  // namespace loom::residual
