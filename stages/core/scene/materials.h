#pragma once
#include <map>
#include <optional>

#include "stages/core/description/description.h"
#include "stages/core/scene/scene.h"

namespace loom {

/// Turns BSDF descriptions into materials of a scene, each shared description once. Wrappers (mask,
/// twosided, bumpmap, normalmap) become members of the material that they wrap.
class MaterialBuilder {
  public:
    MaterialBuilder(Scene& scene, TextureCache& cache) : scene_(scene), cache_(cache) {}

    /// Index of the material; a null description is Mitsuba's default, a grey diffuse.
    std::uint32_t index(const ObjectPtr& bsdf);

    /// Decodes the images that a BSDF refers to into the cache, ahead of index(). Touches nothing else.
    void decode_images(const ObjectPtr& bsdf);

  private:
    struct Sides {
        Material front;
        std::optional<Material> back;
    };
    Sides build(const Object& bsdf);
    Material build_plain(const Object& bsdf);
    int texture(const ObjectPtr& description);
    /// A texture whose numbers count, not its colours.
    int scalar_texture(const ObjectPtr& description);
    /// A reflectance-like parameter: a constant into `value`, or the index of a texture.
    int colour(const Object& bsdf, const char* name, Spectrum& value);
    /// Of diffuse and roughdiffuse, which Mitsuba 0.6 knows by two names.
    int base_colour(const Object& bsdf, Spectrum& value);
    int number(const Object& bsdf, const char* name, float& value);
    int roughness(const Object& bsdf, const char* name, float& value);
    void set_conductor(const Object& bsdf, Material& material);
    /// What follows from the parameters, be they constants or textures.
    void derive(Material& material);

    Scene& scene_;
    TextureCache& cache_;
    std::map<const Object*, std::uint32_t> materials_;
    std::map<const Object*, int> textures_;
};

/// The map of an `envmap` emitter with its `scale`; negative values are set to 0.
/// out:    notes   how many values were negative
EnvironmentMap load_environment(const Object& emitter, TextureCache& cache, std::vector<std::string>& notes);

}  // namespace loom
