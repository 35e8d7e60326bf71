#pragma once
#include <filesystem>

#include "stages/core/description/description.h"
#include "stages/core/scene/scene.h"

namespace loom {

class TextureCache;  // core/assets/texture.h

/// Reads a scene file and all files that it refers to, and builds the acceleration structure. Meshes and textures are
/// loaded in parallel.
/// throws:  InputError with the location in the file
std::unique_ptr<Scene> load_scene(const std::filesystem::path& file, const Defines& defines = {},
                                  const std::string& sensor = {});

/// What a description has in common with a scene that exists. Shapes of equal geometry are neither read again nor put into
/// another acceleration structure.
struct KnownParts {
    static constexpr std::uint32_t none = ~0u;
    std::shared_ptr<const Scene> scene;  // null: nothing is known
    std::vector<std::uint32_t>
        shape_idx;  // [shape of the description] of the scene, each of which is there once; or none
    std::shared_ptr<TextureCache> images = {};  // of scenes built with it; null: its own
};

/// Builds a scene from a parsed description.
std::unique_ptr<Scene> build_scene(SceneDescription description, const KnownParts& known = {});

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

/// Points the camera of a scene as a description has it; the rest of the scene stays as it is. No other thread may use it.
/// throws:  InputError with the location in the file
void set_camera(Scene& scene, const Object& root);

/// Parses texts NAME=VALUE, as given on a command line.
/// throws:  InputError
Defines parse_defines(const std::vector<std::string>& texts);

}  // namespace loom
