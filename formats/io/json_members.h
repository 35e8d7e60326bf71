#pragma once
// Members of a JSON object by one list for the writer and the reader: a function calls visit(key, member) for each.

#include <fmt/format.h>

#include <charconv>
#include <cstdint>
#include <string>

#include "formats/io/error.h"
#include "formats/io/json.h"

namespace loom {

struct MemberWriter {
    JsonWriter& json;
    void operator()(const char* key, const std::string& value) const { json.text(key, value); }
    void operator()(const char* key, double value) const { json.number(key, value); }
    void operator()(const char* key, std::uint64_t value) const { json.integer(key, value); }
};

/// throws:  InputError that names the file and the member: missing, of another type, or no such number
struct MemberReader {
    const JsonValue& json;
    const std::string& file;

    template <class T>
    const T& get(const char* key) const {
        const JsonValue* member = json.find(key);
        const T* value = member == nullptr ? nullptr : std::get_if<T>(&member->value);
        if (value == nullptr) throw InputError(fmt::format("{}: \"{}\" is missing or of another type", file, key));
        return *value;
    }
    void operator()(const char* key, std::string& value) const { value = get<std::string>(key); }
    void operator()(const char* key, double& value) const { number(key, value); }
    void operator()(const char* key, std::uint64_t& value) const { number(key, value); }

  private:
    template <class T>
    void number(const char* key, T& value) const {
        const std::string& text = get<JsonValue::Number>(key).text;
        const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
        if (error != std::errc{} || end != text.data() + text.size())
            throw InputError(fmt::format("{}: \"{}\" is {}, which is no such number", file, key, text));
    }
};

}  // namespace loom
