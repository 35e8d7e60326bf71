#pragma once
// A scene file as a tree of objects, checked against the schema. The tree uses the Mitsuba 3 dialect for every file:
// defaults that differ in the 0.x dialect are explicit. No mesh or texture is opened here.

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <map>
#include <memory>
#include <set>
#include <string>
#include <string_view>
#include <utility>
#include <variant>
#include <vector>

#include "stages/core/description/xml_location.h"
#include "stages/core/math/matrix.h"
#include "stages/core/math/vector.h"

namespace loom {

enum class Category : std::uint8_t {
    scene,
    bsdf,
    shape,
    emitter,
    sensor,
    film,
    rfilter,
    sampler,
    integrator,
    texture,
    medium,
    phase,
    spectrum
};
inline constexpr int n_categories = 13;
/// Returns the tag of a category: "bsdf", "rfilter", …
std::string_view name(Category category);

class Object;
using ObjectPtr = std::shared_ptr<const Object>;

/// Type of a parameter's value. A colour is linear RGB already; the schema says whether it is a reflectance or an
/// emission.
using Value = std::variant<bool, std::int64_t, double, std::string, Spectrum, Point3<double>, Vector3<double>, Matrix4d,
                           ObjectPtr>;

struct Property {
    std::string name;
    Value value;
    Location at;
    mutable bool is_read = false;  // a getter has returned it; see unread_parameters()
};

/// One plugin of a scene file: its parameters by name and its unnamed children. A child with several references is one
/// shared object. The getters throw InputError at the location of the value when it is missing without a fallback, or
/// of another kind. A fallback applies only to a missing value.
class Object {
  public:
    Category category = Category::scene;
    std::string plugin;  // "roughplastic"
    std::string id;      // as written, or made from category and order in the file: "shape-3"
    bool has_own_id = false;
    bool legacy = false;  // written in the 0.x dialect
    Location at;
    std::vector<Property> properties;                    // in the order of the file
    std::vector<std::pair<ObjectPtr, Location>> nested;  // children without a parameter name, in order

    /// Find a parameter without marking it as read.
    const Property* find(std::string_view name) const;
    bool has(std::string_view name) const { return find(name) != nullptr; }

    bool get_bool(std::string_view name) const;
    bool get_bool(std::string_view name, bool fallback) const;
    int get_int(std::string_view name) const;
    int get_int(std::string_view name, int fallback) const;
    double get_double(std::string_view name) const;
    double get_double(std::string_view name, double fallback) const;
    float get_float(std::string_view name) const { return float(get_double(name)); }
    float get_float(std::string_view name, float fallback) const { return float(get_double(name, fallback)); }
    std::string get_string(std::string_view name) const;
    std::string get_string(std::string_view name, std::string_view fallback) const;
    /// Returns a file name, absolute or relative to the working directory; the reader checked that the file exists.
    std::filesystem::path get_path(std::string_view name) const { return get_string(name); }
    /// Returns a colour; a number counts as grey.
    Spectrum get_rgb(std::string_view name) const;
    Spectrum get_rgb(std::string_view name, const Spectrum& fallback) const;
    Point3<double> get_point(std::string_view name, const Point3<double>& fallback) const;
    Vector3<double> get_vector(std::string_view name, const Vector3<double>& fallback) const;
    /// Returns a matrix; identity when absent.
    Matrix4d get_transform(std::string_view name) const;
    ObjectPtr get_object(std::string_view name) const;  // null when absent
    /// Returns a texture object, or the constant.
    std::variant<Spectrum, ObjectPtr> get_texture_or_rgb(std::string_view name, const Spectrum& fallback) const;
    std::variant<float, ObjectPtr> get_texture_or_float(std::string_view name, float fallback) const;
    /// Returns the index of refraction, given as a number or as a material's name (ior.h).
    float get_ior(std::string_view name, std::string_view fallback) const;

    std::vector<ObjectPtr> children(Category category) const;
    bool has_child(Category category) const;
    /// Returns the only child of that category; null when there is none.
    ObjectPtr child(Category category) const;

    /// throws:  InputError at the parameter, or at the object when `parameter` is empty or absent
    [[noreturn]] void fail(std::string_view parameter, const std::string& message) const;

    /// Returns the parameter and marks it as read; null when absent.
    const Property* read(std::string_view name) const;
    /// Whether any getter was called; false for an object that the scene does not use.
    mutable bool is_used = false;
};

/// Returns a warning for each parameter without effect, once per plugin and parameter: a used object below `root` has
/// it, no getter has returned it, and flag::ignored does not mark it. Every parameter of a file is thus either used or
/// named.
std::vector<std::string> unread_parameters(const Object& root);

struct SceneDescription {
    ObjectPtr root;                                 // category scene; its nested objects are the scene's
    std::vector<std::string> notes;                 // accepted settings without effect, once each
    std::vector<std::string> warnings;              // with location: unknown parameters of 0.x files and similar
    std::vector<std::string> files;                 // scene file, includes, then all files that parameters name
    std::map<std::string, std::string> parameters;  // $name -> value that was used
    int sensor = 0;                                 // index of the chosen sensor; root has no other
};

/// Values of `-D name=value`, in order; the last value of a name counts.
using Defines = std::vector<std::pair<std::string, std::string>>;

/// Reads a Mitsuba scene file (dialects 0.5, 0.6, 2 and 3) with its includes.
/// in:     sensor  id of the sensor to keep, or its index in the order of the file, from 0; empty: the first
///         absent  parameters whose shapes are left out: each <shape> element with their $name in it
/// throws: InputError with file:line:column, the line, a caret and the allowed names
SceneDescription read_scene(const std::filesystem::path& file, const Defines& defines = {},
                            const std::string& sensor = {}, const std::set<std::string>& absent = {});

}  // namespace loom
