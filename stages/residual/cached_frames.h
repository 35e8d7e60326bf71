#pragma once
// Frames of an animation whose static scene comes from a radiance cache, so that the camera may move.

#include "stages/residual/residual.h"

namespace loom::residual {

/// Renders each frame of options.frames, or those of options.only, with options.cache. A frame has the same bytes alone
/// and among others.
/// throws:  InputError
void render_cached_frames(const Options& options, app::Report& report);

}  // namespace loom::residual
