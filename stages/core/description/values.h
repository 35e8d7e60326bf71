#pragma once
// Reads one value element of a scene file (<float .../>, <transform>...</transform>, ...) as a Value.

#include <filesystem>
#include <functional>
#include <string>

#include "stages/core/description/description.h"
#include "stages/core/description/schema.h"
#include "stages/core/description/xml_document.h"

namespace loom::description {

using Folders = std::vector<std::filesystem::path>;

/// State shared by the elements of one file.
struct SceneFile {
    XmlDocument document;
    Folders folders;                 // search path for files, in order: <path>s, this file's own folder, the includer's
    std::vector<std::string>* used;  // collects the files that values were read from
    bool legacy = false;             // 0.x dialect
};

/// Text of an attribute after substitution, with its location.
struct Text {
    std::string text;
    Location at;
};

/// An XML element in its file.
struct Element {
    pugi::xml_node node;
    const SceneFile* file;
    Substitutions* substitutions;

    std::string_view tag() const { return node.name(); }
    bool has(const char* attribute) const { return !node.attribute(attribute).empty(); }
    /// throws: InputError when the attribute is missing
    Text text(const char* attribute) const;
    Location at() const { return file->document.at(node); }
    Element with(const pugi::xml_node& other) const { return {other, file, substitutions}; }
    void allow(std::initializer_list<std::string_view> attributes) const {
        file->document.allow_attributes(node, attributes);
    }
};

using Warn = std::function<void(const Location&, const std::string&)>;

bool is_value_tag(std::string_view tag);
/// Returns the tags of is_value_tag, for messages.
std::vector<std::string> value_tags();

/// Reads the element as a value of the parameter. A file name stays as written.
/// throws: InputError for a wrong kind, text that is not of the kind, numbers not finite or out of range, a singular
///         matrix, a missing spectrum file
Value read_value(const Element& element, const Parameter& parameter, const PluginSchema& plugin, const Warn& warn);

double parse_number(const Text& text);
std::int64_t parse_integer(const Text& text);
/// Parses numbers separated by blanks, commas, or both.
std::vector<double> parse_numbers(const Text& text);

/// Returns the path in the first of `folders` that has a file of that name.
/// throws: InputError with the folders that were searched
std::filesystem::path find_file(const Text& name, const Folders& folders);
/// Returns the path in the first of `folders` that has a folder of that name.
std::filesystem::path find_folder(const Text& name, const Folders& folders);
/// Adds `file` to `files` unless it is there already.
void add_file(std::vector<std::string>& files, const std::filesystem::path& file);

}  // namespace loom::description
