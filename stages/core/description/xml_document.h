#pragma once
#include <filesystem>
#include <initializer_list>
#include <map>
#include <memory>
#include <pugixml.hpp>
#include <set>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "stages/core/description/xml_location.h"

namespace loom {

/// One parsed XML file with the locations of its nodes and attributes in the text.
class XmlDocument {
  public:
    /// in:     name  the file's name in messages
    /// throws: InputError: missing, not readable, not XML (with the location)
    XmlDocument(const std::filesystem::path& file, const std::string& name);

    pugi::xml_node root() const { return tree_.document_element(); }
    /// Returns the location of the `<` of an element, or of a piece of text.
    Location at(const pugi::xml_node& node) const;
    /// Returns the location of the first character of the attribute's value; of the element when the attribute is
    /// absent.
    Location at(const pugi::xml_node& node, std::string_view attribute) const;
    /// throws: InputError at the first attribute of the element that is not allowed
    void allow_attributes(const pugi::xml_node& node, std::initializer_list<std::string_view> allowed) const;

  private:
    std::shared_ptr<const SourceText> source_;
    pugi::xml_document tree_;
};

/// Values of $name: from the command line, else from the first <default> of that name.
class Substitutions {
  public:
    explicit Substitutions(const std::vector<std::pair<std::string, std::string>>& defines);
    /// Sets the names that only elements which are left out may use.
    void set_absent(std::set<std::string> names) { absent_ = std::move(names); }

    void set_default(const std::string& name, const std::string& value);
    /// Replaces every $name in the text; names are letters, digits and underscores.
    /// throws: InputError at `at` for a name without value, or an absent one; lists the defined names
    std::string apply(std::string_view text, const Location& at);
    /// Whether a text has the $name of an absent parameter.
    bool has_absent(std::string_view text) const;
    /// Counts the names in a text that is left out as used.
    void leave_out(std::string_view text);
    /// throws: InputError when a define was never used; lists the names that the scene uses
    void check_all_used() const;
    std::map<std::string, std::string> used() const;

  private:
    std::map<std::string, std::string> values_, defines_;
    std::set<std::string> used_, absent_;
};

}  // namespace loom
