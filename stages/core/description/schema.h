#pragma once
// Schema of scene files: one table of plugins with their parameters, in the names of Mitsuba 3.

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "stages/core/description/description.h"

namespace loom {

enum class ValueKind : std::uint8_t {
    boolean,
    integer,
    number,
    string,
    file,
    ior,
    reflectance,
    emission,
    index,
    transform,
    uv_transform,
    point,
    vector,
    texture_only
};

/// Bits of Parameter::flags.
namespace flag {
inline constexpr unsigned textured = 1;  // a texture may replace the number or colour
inline constexpr unsigned required = 2;
inline constexpr unsigned non_negative = 4;
inline constexpr unsigned positive = 8;
inline constexpr unsigned legacy = 16;       // 0.x dialect only
inline constexpr unsigned ignored = 32;      // without effect here: accepted, listed in the notes
inline constexpr unsigned unsupported = 64;  // would change the image: "not supported yet"
inline constexpr unsigned conductor = 128;   // string that names a conductor
inline constexpr unsigned numbered = 256;    // an integer may stand for the choice: 1 is the first
inline constexpr unsigned open = 512;        // plugin: accepts unlisted parameters, without effect
inline constexpr unsigned modern = 1024;     // not in the 0.x dialect
}  // namespace flag

struct Parameter {
    std::string_view name;
    ValueKind kind;
    unsigned flags = 0;
    std::string_view choices = {};  // "a|b/c": allowed values of a string; c in the 0.x dialect only
};

/// Allowed number of unnamed children of one category in a plugin.
struct ChildRule {
    Category category;
    int at_least = 0, at_most = 1;
};

struct PluginSchema {
    Category category;
    std::string_view type;
    std::vector<Parameter> parameters;
    std::vector<ChildRule> children;
    unsigned flags = 0;  // legacy, ignored (its type has no effect here), open, unsupported

    const Parameter* find(std::string_view name) const;
    const ChildRule* rule(Category child) const;
};

/// Returns a plugin of the category; null for an unknown type. Integrators, films, filters and samplers accept any
/// type.
const PluginSchema* find_plugin(Category category, std::string_view type);
const PluginSchema& scene_schema();
/// Returns all plugins, the unsupported ones included.
const std::vector<PluginSchema>& all_plugins();
/// Returns the supported types of the category; those of the 0.x dialect too when `legacy`.
std::vector<std::string> plugin_names(Category category, bool legacy);
std::vector<std::string> parameter_names(const PluginSchema& plugin, bool legacy);

/// Converts a 0.x name to the Mitsuba 3 dialect: "toWorld" -> "to_world", "intIOR" -> "int_ior".
std::string snake_case(std::string_view name);
/// Converts a Mitsuba 3 name to the 0.x dialect, for messages about 0.x files.
std::string camel_case(std::string_view name);

/// Returns the allowed kinds, for messages: "float or texture".
std::string expected_kinds(const Parameter& parameter);

/// Whether the film has time bins.
bool is_transient_film(const Object& film);

/// Checks an object as a whole: required parameters, numbers of children, sizes of a film, allowed positions of an
/// emitter. Children are checked before their parents.
/// throws: InputError with the location
void check_object(const Object& object, const PluginSchema& plugin);

}  // namespace loom
