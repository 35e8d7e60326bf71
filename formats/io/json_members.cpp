#include "formats/io/json_members.h"

#include <fmt/format.h>

#include <nlohmann/json.hpp>

#include "formats/io/error.h"

namespace loom {
namespace {

using nlohmann::json;

const json& member(const MemberReader& reader, const char* key, bool (json::*is_of_type)() const noexcept) {
    const auto found = reader.json.find(key);
    if (found == reader.json.end() || !((*found).*is_of_type)())
        throw InputError(fmt::format("{}: \"{}\" is missing or of another type", reader.file, key));
    return *found;
}

}  // namespace

void MemberWriter::operator()(const char* key, const std::vector<std::string>& values) const {
    json.begin_array(key);
    for (const auto& value : values) json.text({}, value);
    json.end_array();
}

void MemberReader::operator()(const char* key, std::string& value) const {
    member(*this, key, &json::is_string).get_to(value);
}

void MemberReader::operator()(const char* key, double& value) const {
    member(*this, key, &json::is_number).get_to(value);
}

void MemberReader::operator()(const char* key, std::uint64_t& value) const {
    const auto& number = member(*this, key, &json::is_number);
    if (!number.is_number_unsigned())
        throw InputError(fmt::format("{}: \"{}\" is {}, which is no such number", file, key, number.dump()));
    number.get_to(value);
}

void MemberReader::operator()(const char* key, std::vector<std::string>& values) const {
    for (const auto& element : member(*this, key, &json::is_array)) {
        if (!element.is_string()) throw InputError(fmt::format("{}: \"{}\" is not a list of names", file, key));
        values.push_back(element);
    }
}

bool MemberReader::has(const char* key) const {
    return json.contains(key);
}

}  // namespace loom
