#include "stages/core/description/description.h"

#include <fmt/format.h>

#include <algorithm>
#include <atomic>
#include <set>

#include "stages/core/description/ior.h"
#include "stages/core/description/schema.h"

namespace loom {
namespace {

[[noreturn]] void missing(const Object& object, std::string_view parameter) {
    fail(object.at, fmt::format("{} '{}' needs the parameter '{}'", name(object.category), object.plugin, parameter));
}

[[noreturn]] void wrong_kind(const Property& property, std::string_view expected) {
    fail(property.at, fmt::format("'{}' must be {}", property.name, expected));
}

template <class T>
const T& as(const Property& property, std::string_view expected) {
    if (const T* value = std::get_if<T>(&property.value)) return *value;
    wrong_kind(property, expected);
}

double as_number(const Property& property) {
    if (const auto* integer = std::get_if<std::int64_t>(&property.value)) return double(*integer);
    return as<double>(property, "a number");
}

/// Replaces a constant texture by its value.
const Property& unwrapped(const Property& property) {
    const auto* object = std::get_if<ObjectPtr>(&property.value);
    const Property* value = object && (*object)->plugin == "rawconstant" ? (*object)->read("value") : nullptr;
    return value ? *value : property;
}

Spectrum as_rgb(const Property& property) {
    if (const auto* rgb = std::get_if<Spectrum>(&property.value)) return *rgb;
    if (std::holds_alternative<ObjectPtr>(property.value)) wrong_kind(property, "a constant colour");
    return Spectrum(float(as_number(property)));
}

/// Sets a flag; several threads may read one object.
void mark(bool& flag) {
    std::atomic_ref(flag).store(true, std::memory_order_relaxed);
}

void find_unread(const Object& object, std::set<const Object*>& seen, std::set<std::string>& named,
                 std::vector<std::string>& warnings) {
    if (!seen.insert(&object).second) return;
    for (const Property& property : object.properties) {
        if (const auto* inner = std::get_if<ObjectPtr>(&property.value)) find_unread(**inner, seen, named, warnings);
        if (!object.is_used || property.is_read) continue;
        const PluginSchema* plugin = find_plugin(object.category, object.plugin);
        const Parameter* parameter = plugin ? plugin->find(property.name) : nullptr;
        if (!parameter || (parameter->flags & flag::ignored)) continue;
        const std::string message = fmt::format("warning: {} '{}': parameter '{}' has no effect next to the others",
                                                name(object.category), object.plugin, property.name);
        if (named.insert(message).second) warnings.push_back(locate(property.at, message));
    }
    for (const auto& [child, at] : object.nested) find_unread(*child, seen, named, warnings);
}

}  // namespace

std::vector<std::string> unread_parameters(const Object& root) {
    std::set<const Object*> seen;
    std::set<std::string> named;
    std::vector<std::string> warnings;
    find_unread(root, seen, named, warnings);
    return warnings;
}

const Property* Object::read(std::string_view name) const {
    mark(is_used);
    const Property* found = find(name);
    if (found) mark(found->is_read);
    return found;
}

const Property* Object::find(std::string_view name) const {
    for (const Property& property : properties)
        if (property.name == name) return &property;
    return nullptr;
}

bool Object::get_bool(std::string_view name) const {
    const Property* found = read(name);
    if (!found) missing(*this, name);
    return as<bool>(*found, "true or false");
}

bool Object::get_bool(std::string_view name, bool fallback) const {
    return read(name) ? get_bool(name) : fallback;
}

int Object::get_int(std::string_view name) const {
    const Property* found = read(name);
    if (!found) missing(*this, name);
    return int(as<std::int64_t>(*found, "an integer"));
}

int Object::get_int(std::string_view name, int fallback) const {
    return read(name) ? get_int(name) : fallback;
}

double Object::get_double(std::string_view name) const {
    const Property* found = read(name);
    if (!found) missing(*this, name);
    return as_number(*found);
}

double Object::get_double(std::string_view name, double fallback) const {
    return read(name) ? get_double(name) : fallback;
}

std::string Object::get_string(std::string_view name) const {
    const Property* found = read(name);
    if (!found) missing(*this, name);
    return as<std::string>(*found, "a string");
}

std::string Object::get_string(std::string_view name, std::string_view fallback) const {
    return read(name) ? get_string(name) : std::string(fallback);
}

Spectrum Object::get_rgb(std::string_view name) const {
    const Property* found = read(name);
    if (!found) missing(*this, name);
    return as_rgb(*found);
}

Spectrum Object::get_rgb(std::string_view name, const Spectrum& fallback) const {
    return read(name) ? get_rgb(name) : fallback;
}

Point3<double> Object::get_point(std::string_view name, const Point3<double>& fallback) const {
    const Property* found = read(name);
    return found ? as<Point3<double>>(*found, "a point") : fallback;
}

Vector3<double> Object::get_vector(std::string_view name, const Vector3<double>& fallback) const {
    const Property* found = read(name);
    return found ? as<Vector3<double>>(*found, "a vector") : fallback;
}

Matrix4d Object::get_transform(std::string_view name) const {
    const Property* found = read(name);
    return found ? as<Matrix4d>(*found, "a transform") : Matrix4d{};
}

ObjectPtr Object::get_object(std::string_view name) const {
    const Property* found = read(name);
    return found ? as<ObjectPtr>(*found, "an object") : nullptr;
}

std::variant<Spectrum, ObjectPtr> Object::get_texture_or_rgb(std::string_view name, const Spectrum& fallback) const {
    const Property* found = read(name);
    if (!found) return fallback;
    const Property& property = unwrapped(*found);
    if (const auto* object = std::get_if<ObjectPtr>(&property.value)) return *object;
    return as_rgb(property);
}

std::variant<float, ObjectPtr> Object::get_texture_or_float(std::string_view name, float fallback) const {
    const Property* found = read(name);
    if (!found) return fallback;
    const Property& property = unwrapped(*found);
    if (const auto* object = std::get_if<ObjectPtr>(&property.value)) return *object;
    if (const auto* rgb = std::get_if<Spectrum>(&property.value))
        return rgb->r == rgb->g && rgb->g == rgb->b ? rgb->r : luminance(*rgb);
    return float(as_number(property));
}

float Object::get_ior(std::string_view name, std::string_view fallback) const {
    const Property* found = read(name);
    if (found && !std::holds_alternative<std::string>(found->value)) return float(as_number(*found));
    const std::string material = found ? std::get<std::string>(found->value) : std::string(fallback);
    const std::optional<float> ior = dielectric_ior(material);
    if (!ior)
        fail(name, fmt::format("material '{}' is not known; allowed: {}", material,
                               nearest_first(material, dielectric_names())));
    return *ior;
}

std::vector<ObjectPtr> Object::children(Category wanted) const {
    std::vector<ObjectPtr> result;
    for (const auto& [child, place] : nested)
        if (child->category == wanted) result.push_back(child);
    return result;
}

bool Object::has_child(Category wanted) const {
    return std::any_of(nested.begin(), nested.end(),
                       [wanted](const auto& child) { return child.first->category == wanted; });
}

ObjectPtr Object::child(Category wanted) const {
    ObjectPtr result;
    for (const auto& [child, place] : nested) {
        if (child->category != wanted) continue;
        if (result)
            loom::fail(place,
                       fmt::format("{} '{}' takes at most one {}", loom::name(category), plugin, loom::name(wanted)));
        result = child;
    }
    return result;
}

void Object::fail(std::string_view parameter, const std::string& message) const {
    const Property* found = find(parameter);
    loom::fail(found ? found->at : at, message);
}

}  // namespace loom
