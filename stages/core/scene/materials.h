#pragma once
#include <map>
#include <optional>

#include "stages/core/description/description.h"
#include "stages/core/scene/scene.h"

namespace loom {

/// Builds the materials of a scene from BSDF descriptions, each shared description once. Wrappers (mask, twosided,
/// bumpmap, normalmap) become members of the material that they wrap.
class MaterialBuilder {
  public:
    MaterialBuilder(Scene& scene, TextureCache& cache) : scene_(scene), cache_(cache) {}

    /// Returns the index of the material; a null description is Mitsuba's default, a grey diffuse BSDF.
    std::uint32_t index(const ObjectPtr& bsdf);

    /// Decodes the images of a BSDF into the cache, before index(). Changes nothing else.
    void decode_images(const ObjectPtr& bsdf);

  private:
    struct Sides {
        Material front;
        std::optional<Material> back;
    };
    Sides build(const Object& bsdf);
    Material build_plain(const Object& bsdf);
    int texture(const ObjectPtr& description);
    /// Adds a texture whose values are read as plain numbers, not as colours.
    int scalar_texture(const ObjectPtr& description);
    /// Reads a reflectance-like parameter: a constant into `value`, or the index of a texture.
    int colour(const Object& bsdf, const char* name, Spectrum& value);
    /// Reads the reflectance of diffuse and roughdiffuse, which has two names in Mitsuba 0.6.
    int base_colour(const Object& bsdf, Spectrum& value);
    int number(const Object& bsdf, const char* name, float& value);
    int roughness(const Object& bsdf, const char* name, float& value);
    void set_conductor(const Object& bsdf, Material& material);
    /// Computes what depends on the parameters, constant or textured.
    void derive(Material& material);

    Scene& scene_;
    TextureCache& cache_;
    std::map<const Object*, std::uint32_t> materials_;
    std::map<const Object*, int> textures_;
};

/// Loads the map of an `envmap` emitter with its `scale`; negative values are set to 0.
/// out:     notes  how many values were negative
EnvironmentMap load_environment(const Object& emitter, TextureCache& cache, std::vector<std::string>& notes);

}  // namespace loom
