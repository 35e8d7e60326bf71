#include "formats/io/json.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>

#include "formats/io/error.h"

namespace loom {
namespace {

std::string quoted(std::string_view text) {
    return nlohmann::json(text).dump(-1, ' ', false, nlohmann::json::error_handler_t::replace);
}

/// Returns the library's message without its kind and its own location.
std::string_view reason_of(const nlohmann::json::exception& error) {
    std::string_view what = error.what();
    what.remove_prefix(what.find("] ") + 2);
    return what.starts_with("parse error at ") ? what.substr(what.find(": ") + 2) : what;
}

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

nlohmann::json parse_json(std::string_view text, std::string_view file) {
    constexpr int max_depth = 64;
    const auto check_depth = [&](int depth, nlohmann::json::parse_event_t, const nlohmann::json&) {
        if (depth > max_depth) throw InputError(fmt::format("{}: nested deeper than {}", file, max_depth));
        return true;
    };
    try {
        return nlohmann::json::parse(text, check_depth);
    } catch (const nlohmann::json::parse_error& error) {
        const std::string_view read = text.substr(0, error.byte);
        const auto line = 1 + std::count(read.begin(), read.end(), '\n');
        throw InputError(fmt::format("{}:{}: {}", file, line, reason_of(error)));
    } catch (const nlohmann::json::exception& error) {
        throw InputError(fmt::format("{}: {}", file, reason_of(error)));
    }
}

}  // namespace loom
