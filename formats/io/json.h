#pragma once
#include <cstdint>
#include <map>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

namespace loom {

/// Builds JSON text with one member or element per line. Commas and indents are its own business.
class JsonWriter {
  public:
    void begin_object(std::string_view key = {}) { open(key, '{'); }
    void end_object() { close('}'); }
    void begin_array(std::string_view key = {}) { open(key, '['); }
    void end_array() { close(']'); }
    void text(std::string_view key, std::string_view value);
    void number(std::string_view key, double value);  // NaN and infinity become null
    void integer(std::string_view key, std::uint64_t value);
    /// The finished text, with a newline at its end.
    std::string str() const { return text_ + "\n"; }

  private:
    void item(std::string_view key);
    void open(std::string_view key, char bracket);
    void close(char bracket);
    std::string text_;
    std::vector<bool> has_items_;
};

/// A parsed JSON value. Numbers keep their text, so that 64-bit integers stay exact.
struct JsonValue {
    struct Number {
        std::string text;
    };
    using Array = std::vector<JsonValue>;
    using Object = std::map<std::string, JsonValue, std::less<>>;
    std::variant<std::nullptr_t, bool, Number, std::string, Array, Object> value;

    /// The member of an object; null when there is none or this is no object.
    const JsonValue* find(std::string_view key) const;
};

/// throws:  InputError "FILE:LINE: …" when the text is not one JSON value
JsonValue parse_json(std::string_view text, std::string_view file);

}  // namespace loom
