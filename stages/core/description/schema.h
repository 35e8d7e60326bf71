#pragma once
// What a scene file may say: one table of plugins with their parameters, in the names of Mitsuba 3.

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
inline constexpr unsigned textured = 1;  // a texture may stand for the number or colour
inline constexpr unsigned required = 2;
inline constexpr unsigned non_negative = 4;
inline constexpr unsigned positive = 8;
inline constexpr unsigned legacy = 16;       // known to the 0.x dialect only
inline constexpr unsigned ignored = 32;      // without meaning here: accepted, said in the notes
inline constexpr unsigned unsupported = 64;  // would change the picture: "not supported yet"
inline constexpr unsigned conductor = 128;   // string that names a conductor
inline constexpr unsigned numbered = 256;    // an integer may stand for the choice: 1 is the first
inline constexpr unsigned open = 512;        // plugin: takes parameters that are not listed, without effect
inline constexpr unsigned modern = 1024;     // not known to the 0.x dialect
}  // namespace flag

struct Parameter {
    std::string_view name;
    ValueKind kind;
    unsigned flags = 0;
    std::string_view choices = {};  // "a|b/c": what a string may be; c in the 0.x dialect only
};

/// How many unnamed children of a category a plugin takes.
struct ChildRule {
    Category category;
    int at_least = 0, at_most = 1;
};

struct PluginSchema {
    Category category;
    std::string_view type;
    std::vector<Parameter> parameters;
    std::vector<ChildRule> children;
    unsigned flags = 0;  // legacy, ignored (its type has no meaning here), open, unsupported

    const Parameter* find(std::string_view name) const;
    const ChildRule* rule(Category child) const;
};

/// Null when no plugin of that category has the type. Integrators, films, filters and samplers may have any.
const PluginSchema* find_plugin(Category category, std::string_view type);
const PluginSchema& scene_schema();
/// Every plugin, the unsupported ones too.
const std::vector<PluginSchema>& all_plugins();
/// Types of the category that can be used, those of the 0.x dialect too when `legacy`.
std::vector<std::string> plugin_names(Category category, bool legacy);
std::vector<std::string> parameter_names(const PluginSchema& plugin, bool legacy);

/// "toWorld" -> "to_world", "intIOR" -> "int_ior": the 0.x name in the Mitsuba 3 dialect.
std::string snake_case(std::string_view name);
/// The other way, for messages about 0.x files.
std::string camel_case(std::string_view name);

/// "float or texture", for messages.
std::string expected_kinds(const Parameter& parameter);

/// Whether the film has bins.
bool is_transient_film(const Object& film);

/// Checks that need the whole object: required parameters, numbers of children, sizes of a film, places
/// where an emitter may stand. Children are checked before their parents.
/// throws: InputError with the place
void check_object(const Object& object, const PluginSchema& plugin);

}  // namespace loom
