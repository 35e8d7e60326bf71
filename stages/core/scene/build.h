#pragma once
#include <filesystem>

#include "stages/core/description/description.h"
#include "stages/core/scene/scene.h"

namespace loom {

/// Reads a scene file and all files that it refers to, and builds the acceleration structure. Meshes and textures are
/// loaded in parallel.
/// throws:  InputError with the location in the file
std::unique_ptr<Scene> load_scene(const std::filesystem::path& file, const Defines& defines = {},
                                  const std::string& sensor = {});

/// Builds a scene from a parsed description.
std::unique_ptr<Scene> build_scene(SceneDescription description);

/// Image parameters of a scene, without its contents.
struct View {
    Sensor sensor;
    TransientFilm transient;
    int max_depth = -1, rr_depth = 5;
    bool hides_emitters = false;
};
/// Reads the view from the root of a description; opens no file.
/// throws:  InputError with the location in the file
View read_view(const Object& root);

/// Parses texts NAME=VALUE, as given on a command line.
/// throws:  InputError
Defines parse_defines(const std::vector<std::string>& texts);

}  // namespace loom
