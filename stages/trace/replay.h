#pragma once
#include <string>

#include "stages/core/scene/scene.h"
#include "stages/core/tracing/path_tracer.h"

namespace loom::trace {

/// Traces one path alone and describes it vertex by vertex.
/// in:     place   "x,y,sample"
/// throws: InputError when the place is not on the film
std::string replay(const Scene& scene, const PathOptions& options, const std::string& place);

}  // namespace loom::trace
