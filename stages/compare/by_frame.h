#pragma once
// Cost and expected error of each frame of an animation, from the images and their cost files; no reference is needed.

#include <cstdint>
#include <limits>
#include <map>
#include <string>
#include <vector>

namespace loom::compare {

/// A frame by itself; NaN: unknown.
struct FrameFacts {
    static constexpr double unknown = std::numeric_limits<double>::quiet_NaN();

    std::uint64_t number = 0;
    double cpu_s = unknown, render_s = unknown;  // of what it alone is made of; without reading the scene
    double shared_s = unknown;  // of the other files that frames are made of, all together; the same in all frames
    double touched = unknown;   // share of the graph's paths that were traced again; of frames from a graph
    double expected_relmse = unknown;  // mean VarMean / (L^2 + 0.01), pixels and channels
    double static_share = unknown;     // share of the variance that is that of the static image
};

/// in:      files  by the numbers of the frames
/// throws:  InputError for a file that is no image, and for a damaged cost file
std::vector<FrameFacts> facts_of_frames(const std::map<std::uint64_t, std::string>& files);

struct Options;

/// Returns the answer of --by-frame: a TSV table with a row per input and frame.
/// throws:  InputError
std::string table_by_frame(const Options& options);

}  // namespace loom::compare
