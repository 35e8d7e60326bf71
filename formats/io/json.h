#pragma once
#include <cstdint>
#include <nlohmann/json_fwd.hpp>
#include <string>
#include <string_view>
#include <vector>

namespace loom {

/// Writes JSON text with one member or element per line; adds commas and indents itself. A double is written with the
/// fewest digits that read back as the same number. Bytes that are not UTF-8 become U+FFFD.
class JsonWriter {
  public:
    void begin_object(std::string_view key = {}) { open(key, '{'); }
    void end_object() { close('}'); }
    void begin_array(std::string_view key = {}) { open(key, '['); }
    void end_array() { close(']'); }
    void text(std::string_view key, std::string_view value);
    void number(std::string_view key, double value);  // NaN and infinity become null
    void integer(std::string_view key, std::uint64_t value);
    /// Returns the finished text with a final newline.
    std::string str() const { return text_ + "\n"; }

  private:
    void item(std::string_view key);
    void open(std::string_view key, char bracket);
    void close(char bracket);
    std::string text_;
    std::vector<bool> has_items_;
};

/// Parses one JSON value of at most 64 levels.
/// throws:  InputError "FILE:LINE: …" when the text is no such value or not UTF-8
nlohmann::json parse_json(std::string_view text, std::string_view file);

}  // namespace loom
