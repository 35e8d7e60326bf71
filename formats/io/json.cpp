#include "formats/io/json.h"

#include <fmt/format.h>

#include <algorithm>
#include <cctype>
#include <cmath>

#include "formats/io/error.h"

namespace loom {
namespace {

std::string quoted(std::string_view text) {
    std::string out = "\"";
    for (char c : text) {
        if (c == '"' || c == '\\')
            out += {'\\', c};
        else if (c == '\n')
            out += "\\n";
        else if (c == '\t')
            out += "\\t";
        else if (static_cast<unsigned char>(c) < 0x20)
            out += fmt::format("\\u{:04x}", static_cast<int>(c));
        else
            out += c;
    }
    return out + "\"";
}

class Parser {
  public:
    Parser(std::string_view text, std::string_view file) : text_(text), file_(file) {}

    JsonValue whole() {
        JsonValue value = next(0);
        skip_space();
        if (at_ != text_.size()) fail("text after the end");
        return value;
    }

  private:
    static constexpr int max_depth = 64;

    [[noreturn]] void fail(std::string_view what) const {
        const auto line = 1 + std::count(text_.begin(), text_.begin() + static_cast<std::ptrdiff_t>(at_), '\n');
        throw InputError(fmt::format("{}:{}: {}", file_, line, what));
    }
    void skip_space() {
        while (at_ < text_.size() && std::string_view(" \t\r\n").find(text_[at_]) != std::string_view::npos) ++at_;
    }
    bool take(std::string_view word) {
        skip_space();
        if (!text_.substr(at_).starts_with(word)) return false;
        at_ += word.size();
        return true;
    }
    void expect(std::string_view word) {
        if (!take(word)) fail(fmt::format("expected {}", word));
    }

    JsonValue next(int depth) {
        if (depth > max_depth) fail("nested too deep");
        skip_space();
        if (at_ == text_.size()) fail("the text ends early");
        if (take("{")) return {object(depth)};
        if (take("[")) return {array(depth)};
        if (text_[at_] == '"') return {text()};
        if (take("null")) return {nullptr};
        if (take("true")) return {true};
        if (take("false")) return {false};
        return {number()};
    }
    JsonValue::Object object(int depth) {
        JsonValue::Object members;
        if (take("}")) return members;
        do {
            skip_space();
            std::string key = text();
            expect(":");
            members.insert_or_assign(std::move(key), next(depth + 1));
        } while (take(","));
        expect("}");
        return members;
    }
    JsonValue::Array array(int depth) {
        JsonValue::Array elements;
        if (take("]")) return elements;
        do elements.push_back(next(depth + 1));
        while (take(","));
        expect("]");
        return elements;
    }
    JsonValue::Number number() {
        const std::size_t begin = at_;
        while (at_ < text_.size() && (std::isdigit(static_cast<unsigned char>(text_[at_])) != 0 ||
                                      std::string_view("+-.eE").find(text_[at_]) != std::string_view::npos)) {
            ++at_;
        }
        if (at_ == begin) fail("expected a value");
        return {std::string(text_.substr(begin, at_ - begin))};
    }
    std::string text() {
        expect("\"");
        std::string out;
        for (; at_ < text_.size() && text_[at_] != '"'; ++at_) {
            if (text_[at_] != '\\') {
                out += text_[at_];
                continue;
            }
            if (++at_ == text_.size()) break;
            switch (text_[at_]) {
                case 'n':
                    out += '\n';
                    break;
                case 't':
                    out += '\t';
                    break;
                case 'u':
                    out += escaped();
                    break;
                default:
                    out += text_[at_];
            }
        }
        expect("\"");
        return out;
    }
    /// \u00XX, the only escapes by number that the writer makes.
    char escaped() {
        const std::string digits(text_.substr(at_ + 1, 4));
        if (digits.size() != 4 || !digits.starts_with("00") ||
            !std::all_of(digits.begin(), digits.end(), [](unsigned char c) { return std::isxdigit(c) != 0; })) {
            fail("expected \\u00XX");
        }
        at_ += 4;
        return static_cast<char>(std::stoi(digits, nullptr, 16));
    }

    std::string_view text_, file_;
    std::size_t at_ = 0;
};

}  // namespace

void JsonWriter::item(std::string_view key) {
    if (!has_items_.empty()) {
        if (has_items_.back()) text_ += ',';
        has_items_.back() = true;
        text_ += '\n';
        text_.append(2 * has_items_.size(), ' ');
    }
    if (!key.empty()) text_ += quoted(key) + ": ";
}

void JsonWriter::open(std::string_view key, char bracket) {
    item(key);
    text_ += bracket;
    has_items_.push_back(false);
}

void JsonWriter::close(char bracket) {
    const bool had_items = has_items_.back();
    has_items_.pop_back();
    if (had_items) {
        text_ += '\n';
        text_.append(2 * has_items_.size(), ' ');
    }
    text_ += bracket;
}

void JsonWriter::text(std::string_view key, std::string_view value) {
    item(key);
    text_ += quoted(value);
}

void JsonWriter::number(std::string_view key, double value) {
    item(key);
    text_ += std::isfinite(value) ? fmt::format("{}", value) : "null";
}

void JsonWriter::integer(std::string_view key, std::uint64_t value) {
    item(key);
    text_ += fmt::format("{}", value);
}

const JsonValue* JsonValue::find(std::string_view key) const {
    const auto* object = std::get_if<Object>(&value);
    if (object == nullptr) return nullptr;
    const auto found = object->find(key);
    return found == object->end() ? nullptr : &found->second;
}

JsonValue parse_json(std::string_view text, std::string_view file) {
    return Parser(text, file).whole();
}

}  // namespace loom
