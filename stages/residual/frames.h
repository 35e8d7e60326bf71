#pragma once
// Frames of an animation as edits of the static scene that they share: scene, image and graph of it are read once.

#include "stages/residual/residual.h"

namespace loom::residual {

/// Renders each frame of options.frames, or those of options.only. A frame has the same bytes alone and among others.
/// throws:  InputError
void render_frames(const Options& options, app::Report& report);

}  // namespace loom::residual
