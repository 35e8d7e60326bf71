#include "stages/core/description/schema.h"

#include <fmt/format.h>

#include <algorithm>
#include <cctype>

namespace loom {
namespace {

bool upper(char c) {
    return std::isupper(static_cast<unsigned char>(c)) != 0;
}
char to_lower(char c) {
    return char(std::tolower(static_cast<unsigned char>(c)));
}
char to_upper(char c) {
    return char(std::toupper(static_cast<unsigned char>(c)));
}

void check_children(const Object& object, const PluginSchema& plugin) {
    for (const ChildRule& rule : plugin.children) {
        int count = 0;
        for (const auto& [child, at] : object.nested) {
            if (child->category != rule.category) continue;
            if (++count > rule.at_most)
                fail(at, fmt::format("{} '{}' takes at most {} {}", name(plugin.category), plugin.type, rule.at_most,
                                     name(rule.category)));
        }
        if (count < rule.at_least)
            fail(object.at,
                 fmt::format("{} '{}' needs a {} inside", name(plugin.category), plugin.type, name(rule.category)));
    }
}

void check_film(const Object& film) {
    constexpr std::int64_t largest_side = 100000, most_pixels = std::int64_t(1) << 31;
    const std::int64_t width = film.get_int("width", 768), height = film.get_int("height", 576);
    for (const auto& [side, size] : {std::pair{"width", width}, std::pair{"height", height}})
        if (size < 1 || size > largest_side)
            film.fail(side, fmt::format("{} {} is not between 1 and {}", side, size, largest_side));
    if (width * height > most_pixels)
        film.fail("width", fmt::format("{} x {} pixels are more than {}", width, height, most_pixels));
}

void check_scene(const Object& scene) {
    bool environment = false, sensor = false;
    const Object* capture = nullptr;
    for (const auto& [child, at] : scene.nested) {
        sensor |= child->category == Category::sensor;
        if (child->category == Category::shape)
            if (const ObjectPtr inside = child->child(Category::sensor)) capture = inside.get();
        if (child->category != Category::emitter) continue;
        if (child->plugin != "envmap" && child->plugin != "constant" && child->plugin != "sunsky") continue;
        if (environment) fail(at, "a scene has at most one emitter of constant, envmap, sunsky");
        environment = true;
    }
    if (!sensor && !capture) fail(scene.at, "scene 'scene' needs a sensor inside");
    const ObjectPtr integrator = scene.child(Category::integrator);
    const bool around_corner = integrator && integrator->plugin == "transient_nlos_path";
    if (capture && !around_corner)
        fail(capture->at, "sensor 'nlos_capture_meter' needs the integrator 'transient_nlos_path'");
}

void check_integrator(const Object& object) {
    if (object.get_int("max_depth", -1) < -1)
        object.fail("max_depth", "'max_depth' must be -1 (no limit) or not negative");
    // It also drops reflected light: all light from BSDF sampling, but not that of next-event estimation.
    if (object.plugin == "transient_path" && object.get_bool("discard_direct_light", false))
        object.fail(
            "discard_direct_light",
            "'discard_direct_light' is not supported: in mitransient it drops a part of the reflected light, too");
}

void check_conductor(const Object& object) {
    if (!object.legacy && object.has("material") && (object.has("eta") || object.has("k")))
        object.fail("material", "give either 'material' or 'eta' and 'k', not both");
}

/// Requires a constant texture to lie in the range of the constant.
void check_rawconstant(const Object& object, const Parameter& parameter) {
    const Property* property = object.find(parameter.name);
    const auto* texture = property ? std::get_if<ObjectPtr>(&property->value) : nullptr;
    if (!texture || (*texture)->plugin != "rawconstant") return;
    const Spectrum value = (*texture)->get_rgb("value");
    const float low = std::min({value.r, value.g, value.b}), high = std::max({value.r, value.g, value.b});
    if (parameter.kind == ValueKind::reflectance && (low < 0 || high > 1))
        (*texture)->fail("value", fmt::format("'{}' must lie between 0 and 1", parameter.name));
    if ((parameter.flags & flag::positive) && !(low > 0))
        (*texture)->fail("value", fmt::format("'{}' must be greater than 0", parameter.name));
    if (((parameter.flags & flag::non_negative) || object.category == Category::emitter) && low < 0)
        (*texture)->fail("value", fmt::format("'{}' must not be negative", parameter.name));
}

}  // namespace

std::string_view name(Category category) {
    constexpr std::string_view names[n_categories] = {"scene",  "bsdf",    "shape",   "emitter",    "sensor",
                                                      "film",   "rfilter", "sampler", "integrator", "texture",
                                                      "medium", "phase",   "spectrum"};
    return names[int(category)];
}

const Parameter* PluginSchema::find(std::string_view name) const {
    for (const Parameter& parameter : parameters)
        if (parameter.name == name) return &parameter;
    return nullptr;
}

const ChildRule* PluginSchema::rule(Category child) const {
    for (const ChildRule& rule : children)
        if (rule.category == child) return &rule;
    return nullptr;
}

std::string snake_case(std::string_view name) {
    std::string result;
    for (std::size_t i = 0; i < name.size(); ++i) {
        // A capital starts a word after a small letter, or as the last capital before a small letter.
        const bool starts_word = i > 0 && upper(name[i]) && name[i - 1] != '_' &&
                                 (!upper(name[i - 1]) || (i + 1 < name.size() && !upper(name[i + 1])));
        if (starts_word) result += '_';
        result += to_lower(name[i]);
    }
    return result;
}

std::string camel_case(std::string_view name) {
    if (name == "int_ior") return "intIOR";
    if (name == "ext_ior") return "extIOR";
    if (name == "k_nn") return "kNN";
    std::string result;
    for (std::size_t i = 0; i < name.size(); ++i) {
        if (name[i] == '_' && i + 1 < name.size())
            result += to_upper(name[++i]);
        else
            result += name[i];
    }
    return result;
}

std::string expected_kinds(const Parameter& parameter) {
    const std::string or_texture = parameter.flags & flag::textured ? " or texture" : "";
    switch (parameter.kind) {
        case ValueKind::boolean:
            return "boolean";
        case ValueKind::integer:
            return "integer";
        case ValueKind::number:
            return "float" + or_texture;
        case ValueKind::string:
            return "string";
        case ValueKind::file:
            return "string (a file name)";
        case ValueKind::ior:
            return "float or string (the name of a material)";
        case ValueKind::reflectance:
        case ValueKind::emission:
        case ValueKind::index:
            return "rgb, spectrum or float" + or_texture;
        case ValueKind::transform:
        case ValueKind::uv_transform:
            return "transform";
        case ValueKind::point:
            return "point";
        case ValueKind::vector:
            return "vector";
        case ValueKind::texture_only:
            return "texture";
    }
    return {};
}

bool is_transient_film(const Object& film) {
    return film.plugin == "transient_hdr_film" || film.plugin == "phasor_hdr_film";
}

void check_object(const Object& object, const PluginSchema& plugin) {
    for (const Parameter& parameter : plugin.parameters)
        if ((parameter.flags & flag::required) && !object.has(parameter.name))
            fail(object.at, fmt::format("{} '{}' needs the parameter '{}' ({})", name(plugin.category), plugin.type,
                                        parameter.name, expected_kinds(parameter)));
    for (const Parameter& parameter : plugin.parameters) check_rawconstant(object, parameter);
    check_children(object, plugin);
    switch (object.category) {
        case Category::film:
            check_film(object);
            break;
        case Category::scene:
            check_scene(object);
            break;
        case Category::shape:
            if (const ObjectPtr sensor = object.child(Category::sensor);
                sensor && sensor->plugin != "nlos_capture_meter")
                fail(sensor->at, fmt::format("sensor '{}' does not belong inside a shape", sensor->plugin));
            if (const ObjectPtr emitter = object.child(Category::emitter); emitter && emitter->plugin != "area")
                fail(emitter->at, fmt::format("emitter '{}' does not belong inside a shape", emitter->plugin));
            break;
        case Category::integrator:
            check_integrator(object);
            break;
        case Category::bsdf:
            if (object.plugin == "conductor" || object.plugin == "roughconductor") check_conductor(object);
            break;
        case Category::sensor:
            if (const ObjectPtr film = object.child(Category::film);
                object.plugin == "nlos_capture_meter" && !(film && is_transient_film(*film)))
                fail(film ? film->at : object.at, "sensor 'nlos_capture_meter' needs a film 'transient_hdr_film'");
            if (object.get_double("fov", 90) >= 180) object.fail("fov", "'fov' must be less than 180 degrees");
            if (!(object.get_double("near_clip", 1e-2) < object.get_double("far_clip", 1e4)))
                object.fail(object.has("near_clip") ? "near_clip" : "far_clip", "near clip must be before far clip");
            break;
        default:
            break;
    }
}

}  // namespace loom
