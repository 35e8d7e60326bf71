#include "stages/core/scene/materials.h"

#include <fmt/format.h>

#include <algorithm>

#include "stages/core/description/ior.h"

namespace loom {
namespace {

BsdfKind kind_of(const Object& bsdf) {
    static const std::map<std::string, BsdfKind> kinds = {
        {"diffuse", BsdfKind::diffuse},
        {"roughdiffuse", BsdfKind::rough_diffuse},
        {"conductor", BsdfKind::conductor},
        {"roughconductor", BsdfKind::rough_conductor},
        {"dielectric", BsdfKind::dielectric},
        {"thindielectric", BsdfKind::thin_dielectric},
        {"roughdielectric", BsdfKind::rough_dielectric},
        {"plastic", BsdfKind::plastic},
        {"roughplastic", BsdfKind::rough_plastic},
        {"phong", BsdfKind::phong},
        {"ward", BsdfKind::ward},
        {"null", BsdfKind::null},
    };
    const auto found = kinds.find(bsdf.plugin);
    if (found == kinds.end()) bsdf.fail("", "the BSDF '" + bsdf.plugin + "' is not supported yet");
    return found->second;
}

WardVariant ward_variant(const std::string& name) {
    return name == "ward" ? WardVariant::ward : name == "ward-duer" ? WardVariant::duer : WardVariant::balanced;
}

bool transmits(BsdfKind kind) {
    return kind == BsdfKind::dielectric || kind == BsdfKind::thin_dielectric || kind == BsdfKind::rough_dielectric ||
           kind == BsdfKind::null;
}

}  // namespace

std::uint32_t MaterialBuilder::index(const ObjectPtr& bsdf) {
    if (const auto found = materials_.find(bsdf.get()); found != materials_.end()) return found->second;
    Sides sides;
    if (bsdf) {
        sides = build(*bsdf);
        sides.front.id = bsdf->id;
        if (sides.back) sides.back->id = bsdf->id + ".back";
    } else {
        sides.front.id = "default";
    }
    derive(sides.front);
    if (sides.back) {
        derive(*sides.back);
        sides.front.back_idx = int(scene_.materials.size());
        scene_.materials.push_back(*sides.back);
    }
    const auto index = std::uint32_t(scene_.materials.size());
    scene_.materials.push_back(sides.front);
    return materials_[bsdf.get()] = index;
}

void MaterialBuilder::decode_images(const ObjectPtr& bsdf) {
    if (!bsdf) return;
    auto visit = [&](const ObjectPtr& o) {
        if (o->category == Category::texture) make_texture(*o, cache_);
        if (o->category == Category::bsdf) decode_images(o);
    };
    for (const Property& p : bsdf->properties)
        if (const auto* o = std::get_if<ObjectPtr>(&p.value)) visit(*o);
    for (const auto& [o, at] : bsdf->nested) visit(o);
}

MaterialBuilder::Sides MaterialBuilder::build(const Object& o) {
    const auto inner = o.children(Category::bsdf);
    const bool wrapper =
        o.plugin == "mask" || o.plugin == "twosided" || o.plugin == "bumpmap" || o.plugin == "normalmap";
    if (!wrapper) return {build_plain(o), std::nullopt};
    const std::size_t most = o.plugin == "twosided" ? 2 : 1;
    if (inner.empty() || inner.size() > most)
        o.fail("", "'" + o.plugin + "' needs " + (most == 2 ? "one or two nested BSDFs" : "one nested BSDF"));
    Sides sides = build(*inner[0]);
    auto each = [&](auto&& change) {
        change(sides.front);
        if (sides.back) change(*sides.back);
    };
    if (o.plugin == "twosided") {
        if (sides.back) o.fail("", "'twosided' inside 'twosided'");
        if (inner.size() == 2) sides.back = build(*inner[1]).front;
        each([&](Material& m) {
            if (transmits(m.model.kind) || m.opacity_idx >= 0 || m.model.opacity < 1)
                o.fail("", "'twosided' cannot hold a BSDF that transmits");
            m.model.two_sided = true;
        });
    } else if (o.plugin == "mask") {
        const auto opacity = o.get_texture_or_float("opacity", 0.5f);
        const auto* map = std::get_if<ObjectPtr>(&opacity);
        const int index = map ? scalar_texture(*map) : -1;
        const float constant = map ? 1.0f : clamp(std::get<float>(opacity), 0.0f, 1.0f);
        each([&](Material& m) {
            if (m.opacity_idx >= 0 || m.model.opacity < 1) o.fail("", "'mask' inside 'mask' is not supported yet");
            m.opacity_idx = index;
            m.model.opacity = constant;
        });
    } else {
        ObjectPtr map;
        for (const Property& p : o.properties)
            if (const auto* t = std::get_if<ObjectPtr>(&p.value); t && (*t)->category == Category::texture)
                map = o.get_object(p.name);
        if (!map) map = o.child(Category::texture);
        if (!map) o.fail("", "'" + o.plugin + "' needs a texture");
        const int index = texture(map);
        const float scale = o.get_float("scale", 1.0f);
        const bool flips = o.get_bool("flip_invalid_normals", true),
                   shadows = o.get_bool("use_shadowing_function", true);
        each([&](Material& m) {
            if (m.perturbed()) o.fail("", "a bump or normal map inside another is not supported yet");
            (o.plugin == "normalmap" ? m.normal_map_idx : m.bump_map_idx) = index;
            m.bump_scale = scale;
            m.flips_invalid_normals = flips;
            m.model.bump_shadowing = shadows;
        });
    }
    return sides;
}

Material MaterialBuilder::build_plain(const Object& o) {
    Material m;
    BsdfModel& model = m.model;
    model.kind = kind_of(o);
    switch (model.kind) {
        case BsdfKind::diffuse:
            m.diffuse_idx = base_colour(o, model.diffuse);
            break;
        case BsdfKind::rough_diffuse:
            m.diffuse_idx = base_colour(o, model.diffuse);
            model.alpha_u = model.alpha_v = 0.2f;
            m.alpha_u_idx = m.alpha_v_idx = roughness(o, "alpha", model.alpha_u);
            model.alpha_v = model.alpha_u;
            break;
        case BsdfKind::conductor:
        case BsdfKind::rough_conductor:
            set_conductor(o, m);
            m.specular_idx = colour(o, "specular_reflectance", model.specular);
            break;
        case BsdfKind::dielectric:
        case BsdfKind::thin_dielectric:
        case BsdfKind::rough_dielectric:
            model.int_ior = o.get_ior("int_ior", "bk7");
            model.ext_ior = o.get_ior("ext_ior", "air");
            if (model.kind == BsdfKind::rough_dielectric && model.int_ior == model.ext_ior)
                o.fail(
                    "int_ior",
                    fmt::format("int_ior and ext_ior are both {:.6g}: a rough dielectric needs two different indices",
                                model.int_ior));
            m.specular_idx = colour(o, "specular_reflectance", model.specular);
            m.transmittance_idx = colour(o, "specular_transmittance", model.transmittance);
            break;
        case BsdfKind::plastic:
        case BsdfKind::rough_plastic:
            model.int_ior = o.get_ior("int_ior", "polypropylene");
            model.ext_ior = o.get_ior("ext_ior", "air");
            model.nonlinear = o.get_bool("nonlinear", false);
            m.diffuse_idx = colour(o, "diffuse_reflectance", model.diffuse);
            m.specular_idx = colour(o, "specular_reflectance", model.specular);
            break;
        case BsdfKind::phong:
            m.exponent_idx = number(o, "exponent", model.exponent);
            model.specular = Spectrum(0.2f);
            m.diffuse_idx = colour(o, "diffuse_reflectance", model.diffuse);
            m.specular_idx = colour(o, "specular_reflectance", model.specular);
            break;
        case BsdfKind::ward:
            model.variant = ward_variant(o.get_string("variant", "balanced"));
            model.specular = Spectrum(0.2f);
            m.diffuse_idx = colour(o, "diffuse_reflectance", model.diffuse);
            m.specular_idx = colour(o, "specular_reflectance", model.specular);
            break;
        case BsdfKind::null:
            break;
    }
    const bool microfacet = model.kind == BsdfKind::rough_conductor || model.kind == BsdfKind::rough_dielectric ||
                            model.kind == BsdfKind::rough_plastic;
    if (microfacet || model.kind == BsdfKind::ward) {
        m.alpha_u_idx = m.alpha_v_idx = roughness(o, "alpha", model.alpha_u);
        model.alpha_v = model.alpha_u;
        if (o.has("alpha_u")) m.alpha_u_idx = roughness(o, "alpha_u", model.alpha_u);
        if (o.has("alpha_v")) m.alpha_v_idx = roughness(o, "alpha_v", model.alpha_v);
    }
    if (microfacet) {
        const std::string distribution = o.get_string("distribution", "beckmann");
        if (distribution == "ggx") model.distribution = Microfacet::ggx;
        if (distribution == "phong" || distribution == "as")
            scene_.notes.push_back("the '" + distribution +
                                   "' microfacet distribution is rendered as Beckmann of the same roughness");
        model.sample_visible = o.get_bool("sample_visible", true);
    }
    return m;
}

void MaterialBuilder::set_conductor(const Object& o, Material& material) {
    BsdfModel& m = material.model;
    const std::string name = o.get_string("material", o.has("eta") || o.has("k") ? "" : "none");
    if (!name.empty()) {
        const auto ior = conductor_ior(name);
        if (!ior) o.fail("material", "unknown conductor '" + name + "'");
        m.eta_c = ior->eta;
        m.k_c = ior->k;
    }
    material.eta_c_idx = colour(o, "eta", m.eta_c);
    material.k_c_idx = colour(o, "k", m.k_c);
    if (o.has("ext_eta")) {
        const float outside = o.get_ior("ext_eta", "air");
        m.eta_c = m.eta_c / outside;
        m.k_c = m.k_c / outside;
        material.index_scale = 1 / outside;
    }
}

int MaterialBuilder::texture(const ObjectPtr& description) {
    if (const auto found = textures_.find(description.get()); found != textures_.end()) return found->second;
    scene_.textures.push_back(make_texture(*description, cache_));
    return textures_[description.get()] = int(scene_.textures.size()) - 1;
}

int MaterialBuilder::scalar_texture(const ObjectPtr& description) {
    const int index = texture(description);
    const Texture& t = scene_.textures[std::size_t(index)];
    if (t.kind == TextureKind::checkerboard && t.swaps_numbers && t.color0 != t.color1)
        scene_.notes.push_back("texture '" + t.id +
                               "' (checkerboard): read as a number it has the value of color1 where its colour is "
                               "color0, as in Mitsuba 3");
    return index;
}

int MaterialBuilder::colour(const Object& o, const char* name, Spectrum& value) {
    const auto got = o.get_texture_or_rgb(name, value);
    if (const auto* map = std::get_if<ObjectPtr>(&got)) return texture(*map);
    value = std::get<Spectrum>(got);
    return -1;
}

int MaterialBuilder::base_colour(const Object& o, Spectrum& value) {
    return colour(o, o.has("diffuse_reflectance") && !o.has("reflectance") ? "diffuse_reflectance" : "reflectance",
                  value);
}

int MaterialBuilder::number(const Object& o, const char* name, float& value) {
    const auto got = o.get_texture_or_float(name, value);
    if (const auto* map = std::get_if<ObjectPtr>(&got)) return scalar_texture(*map);
    value = std::get<float>(got);
    return -1;
}

int MaterialBuilder::roughness(const Object& o, const char* name, float& value) {
    const int map = number(o, name, value);
    value = std::max(value, smallest_alpha);
    return map;
}

void MaterialBuilder::derive(Material& m) {
    BsdfModel& model = m.model;
    const bool two_lobes = model.kind == BsdfKind::phong || model.kind == BsdfKind::ward;
    if (two_lobes && (m.diffuse_idx >= 0 || m.specular_idx >= 0)) {
        // Uses the largest values of the textures, as Mitsuba 0.6; a constant lobe is scaled with them.
        const auto most = [&](int texture, const Spectrum& constant) {
            return texture >= 0 ? scene_.textures[texture].maximum() : constant;
        };
        const BsdfModel before = model;
        model.diffuse = most(m.diffuse_idx, model.diffuse);
        model.specular = most(m.specular_idx, model.specular);
        m.reflectance_scale = conserve_energy(model);
        if (m.diffuse_idx >= 0) model.diffuse = before.diffuse;
        if (m.specular_idx >= 0) model.specular = before.specular;
    } else if (model.kind == BsdfKind::rough_plastic && m.alpha_u_idx >= 0) {
        const auto [least, most] = scene_.textures[m.alpha_u_idx].float_range();
        prepare_coats(model, std::max(least, smallest_alpha), std::max(most, smallest_alpha));
    } else {
        prepare(model);
    }
}

EnvironmentMap load_environment(const Object& o, TextureCache& cache, std::vector<std::string>& notes) {
    const auto image = image_of(o, decode_of(o), cache);
    const float scale = o.get_float("scale", 1.0f);
    EnvironmentMap map;
    map.width = image->width;
    map.height = image->height;
    if (map.width < 2 || map.height < 2) o.fail("filename", "an environment map needs at least 2 x 2 pixels");
    map.texels.reserve(std::size_t(map.width) * map.height);
    std::size_t n_negative = 0;
    float lowest = 0;
    for (int y = 0; y < map.height; ++y)
        for (int x = 0; x < map.width; ++x) {
            Spectrum texel = image->texel(x, y) * scale;
            if (!all_finite(texel))
                o.fail("scale", fmt::format("pixel ({}, {}) of the map times the scale is not finite", x, y));
            const float low = std::min({texel.r, texel.g, texel.b});
            if (low < 0) {
                ++n_negative;
                lowest = std::min(lowest, low);
                texel = {std::max(texel.r, 0.0f), std::max(texel.g, 0.0f), std::max(texel.b, 0.0f)};
            }
            map.texels.push_back(texel);
        }
    if (n_negative > 0)
        notes.push_back(
            fmt::format("warning: {}: {} of {} pixels have negative values (lowest {:.3g}), which are read as 0",
                        o.get_path("filename").filename().string(), n_negative, map.texels.size(), lowest));
    return map;
}

}  // namespace loom
