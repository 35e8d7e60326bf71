#pragma once
#include <filesystem>

#include "stages/core/description/description.h"
#include "stages/core/scene/scene.h"

namespace loom {

/// Reads a scene file and all it refers to, and builds the acceleration structure. Meshes and textures
/// are loaded in parallel.
/// throws: InputError with the place in the file
std::unique_ptr<Scene> load_scene(const std::filesystem::path& file, const Defines& defines = {},
                                  const std::string& sensor = {});

/// The same from a description that has been read.
std::unique_ptr<Scene> build_scene(SceneDescription description);

/// What a scene says of its picture and not of what is in it.
struct View {
    Sensor sensor;
    TransientFilm transient;
    int max_depth = -1, rr_depth = 5;
    bool hides_emitters = false;
};
/// From the root of a description; opens no file.
/// throws: InputError with the place in the file
View read_view(const Object& root);

/// From texts NAME=VALUE, as a command line has them.
/// throws: InputError
Defines parse_defines(const std::vector<std::string>& texts);

}  // namespace loom
