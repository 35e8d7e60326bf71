#pragma once
#include <string>

namespace loom::report {

struct Options;

/// Makes the page of an animation: its frames under a slider, a strip, charts, a table by frame and the lineage.
/// in:      options  animation, by_frame, movie, fps, charts, title, made_by, longest_side
/// The page depends on these files and their cost files only: it needs no network and opens from disk.
/// throws:  InputError for frames of different sizes, and for a table of other frames
std::string animation_page(const Options& options);

}  // namespace loom::report
