#pragma once
// Lists the members of a JSON object once for writer and reader: a function calls visit(key, member) for each member.

#include <cstdint>
#include <string>
#include <vector>

#include "formats/io/json.h"

namespace loom {

struct MemberWriter {
    JsonWriter& json;
    void operator()(const char* key, const std::string& value) const { json.text(key, value); }
    void operator()(const char* key, double value) const { json.number(key, value); }
    void operator()(const char* key, std::uint64_t value) const { json.integer(key, value); }
    void operator()(const char* key, const std::vector<std::string>& values) const;
    void optional(const char* key, const auto& value) const { (*this)(key, value); }
};

/// Reads members of a JSON object.
/// throws:  InputError naming the file and the member that is missing, has another type or is out of range
struct MemberReader {
    const nlohmann::json& json;
    const std::string& file;

    void operator()(const char* key, std::string& value) const;
    void operator()(const char* key, double& value) const;
    void operator()(const char* key, std::uint64_t& value) const;
    void operator()(const char* key, std::vector<std::string>& values) const;
    /// Reads a member; leaves the value unchanged when the member is absent.
    void optional(const char* key, auto& value) const {
        if (has(key)) (*this)(key, value);
    }

  private:
    bool has(const char* key) const;
};

}  // namespace loom
