#pragma once
#include <filesystem>

#include "stages/core/scene/description.h"
#include "stages/core/scene/scene.h"

namespace loom {

/// Reads a scene file and all it refers to, and builds the acceleration structure. Meshes and textures
/// are loaded in parallel.
/// throws: InputError with the place in the file
std::unique_ptr<Scene> load_scene(const std::filesystem::path& file, const Defines& defines = {});

/// From texts NAME=VALUE, as a command line has them.
/// throws: InputError
Defines parse_defines(const std::vector<std::string>& texts);

}  // namespace loom
