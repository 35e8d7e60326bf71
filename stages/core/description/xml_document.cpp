#include "stages/core/description/xml_document.h"

#include <fmt/format.h>

#include <algorithm>
#include <cctype>
#include <fstream>
#include <iterator>

#include "formats/io/error.h"
#include "stages/core/description/byte_order_mark.h"

namespace loom {
namespace {

std::string read_text(const std::filesystem::path& file, const std::string& name) {
    std::error_code error;
    if (!std::filesystem::exists(file, error)) throw InputError(name + ": no such file");
    if (std::filesystem::is_directory(file, error)) throw InputError(name + ": a folder, expected a scene file");
    std::ifstream in(file, std::ios::binary);
    std::string text{std::istreambuf_iterator<char>(in), {}};
    if (!in) throw InputError(name + ": cannot be read");
    return std::string(without_byte_order_mark(text));
}

bool is_blank(char c) {
    return c == ' ' || c == '\t' || c == '\r' || c == '\n';
}
bool is_name_character(char c) {
    return std::isalnum(static_cast<unsigned char>(c)) || c == '_';
}

/// Calls visit(begin, end, name) for each $name in a text, whose place is [begin, end).
void for_each_name(std::string_view text, const auto& visit) {
    for (std::size_t begin = text.find('$'); begin != std::string_view::npos;) {
        std::size_t end = begin + 1;
        while (end < text.size() && is_name_character(text[end])) ++end;
        visit(begin, end, std::string(text.substr(begin + 1, end - begin - 1)));
        begin = text.find('$', end);
    }
}

}  // namespace

XmlDocument::XmlDocument(const std::filesystem::path& file, const std::string& name)
    : source_(std::make_shared<const SourceText>(SourceText{name, read_text(file, name)})) {
    // load_buffer works on a copy, so that offsets refer to the text that messages quote.
    const pugi::xml_parse_result result =
        tree_.load_buffer(source_->text.data(), source_->text.size(), pugi::parse_default, pugi::encoding_utf8);
    if (!result)
        fail({source_, std::size_t(std::max<std::ptrdiff_t>(result.offset, 0))},
             fmt::format("malformed XML: {}", result.description()));
}

Location XmlDocument::at(const pugi::xml_node& node) const {
    auto offset = std::size_t(std::max<std::ptrdiff_t>(node.offset_debug(), 0));
    const std::string& text = source_->text;
    if (node.type() == pugi::node_element)
        --offset;  // from the name to its `<`
    else
        while (offset < text.size() && is_blank(text[offset])) ++offset;
    return {source_, offset};
}

Location XmlDocument::at(const pugi::xml_node& node, std::string_view attribute) const {
    const Location start = at(node);
    const std::string& text = source_->text;
    std::size_t i = start.offset + 1 + std::string_view(node.name()).size();
    // The text is well-formed here: a sequence of NAME = QUOTE VALUE QUOTE.
    while (i < text.size()) {
        while (i < text.size() && is_blank(text[i])) ++i;
        if (i >= text.size() || text[i] == '>' || text[i] == '/') break;
        const std::size_t equals = text.find('=', i);
        if (equals == std::string::npos) break;
        std::string_view name(text.data() + i, equals - i);
        while (!name.empty() && is_blank(name.back())) name.remove_suffix(1);
        const std::size_t quote = text.find_first_of("\"'", equals);
        if (quote == std::string::npos) break;
        if (name == attribute) return {source_, quote + 1};
        const std::size_t end = text.find(text[quote], quote + 1);
        if (end == std::string::npos) break;
        i = end + 1;
    }
    return start;
}

void XmlDocument::allow_attributes(const pugi::xml_node& node, std::initializer_list<std::string_view> allowed) const {
    for (const pugi::xml_attribute& attribute : node.attributes())
        if (std::find(allowed.begin(), allowed.end(), attribute.name()) == allowed.end())
            fail(at(node, attribute.name()),
                 fmt::format("<{}> has no attribute '{}'; allowed: {}", node.name(), attribute.name(),
                             nearest_first(attribute.name(), {allowed.begin(), allowed.end()})));
}

Substitutions::Substitutions(const std::vector<std::pair<std::string, std::string>>& defines) {
    for (const auto& [name, value] : defines) defines_[name] = value;
    values_ = defines_;
}

void Substitutions::set_default(const std::string& name, const std::string& value) {
    values_.emplace(name, value);
}

std::string Substitutions::apply(std::string_view text, const Location& at) {
    std::string result;
    std::size_t done = 0;
    for_each_name(text, [&](std::size_t begin, std::size_t end, const std::string& name) {
        const auto found = values_.find(name);
        if (found == values_.end()) {
            std::vector<std::string> known;
            for (const auto& [key, value] : values_) known.push_back(key);
            fail(at, fmt::format("${} has no value: no <default> before this place and no -D {}=...; known: {}", name,
                                 name, nearest_first(name, known)));
        }
        if (absent_.contains(name))
            fail(at, fmt::format("${} is absent ('{}'), which drops shapes that use it; this use is in no shape", name,
                                 found->second));
        used_.insert(name);
        result += text.substr(done, begin - done);
        result += found->second;
        done = end;
    });
    result += text.substr(done);
    return result;
}

bool Substitutions::has_absent(std::string_view text) const {
    bool any = false;
    if (!absent_.empty())
        for_each_name(text, [&](std::size_t, std::size_t, const std::string& name) { any |= absent_.contains(name); });
    return any;
}

void Substitutions::leave_out(std::string_view text) {
    for_each_name(text, [&](std::size_t, std::size_t, const std::string& name) {
        if (values_.contains(name)) used_.insert(name);
    });
}

void Substitutions::check_all_used() const {
    for (const auto& [name, value] : defines_)
        if (!used_.contains(name))
            throw InputError(fmt::format("-D {}={}: the scene does not use ${}; it uses: {}", name, value, name,
                                         nearest_first(name, {used_.begin(), used_.end()})));
}

std::map<std::string, std::string> Substitutions::used() const {
    std::map<std::string, std::string> result;
    for (const std::string& name : used_) result[name] = values_.at(name);
    return result;
}

}  // namespace loom
