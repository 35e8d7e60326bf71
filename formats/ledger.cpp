#include "formats/ledger.h"

#include <fmt/format.h>

#include <charconv>
#include <limits>

#include "formats/io/error.h"
#include "formats/io/json.h"

namespace loom {
namespace {

/// The one list of members, for the writer and the reader.
template <class Link, class Visitor>
void members(Link& link, Visitor&& visit) {
    visit("scene", link.scene.name);
    visit("hash", link.scene.hash);
    visit("what", link.what);
    visit("method", link.method);
    visit("samples", link.samples);
    visit("seed", link.seed);
    visit("var_mean", link.var_mean);
    visit("var_sample", link.var_sample);
}

struct Writer {
    JsonWriter& json;
    void operator()(const char* key, const std::string& value) const { json.text(key, value); }
    void operator()(const char* key, double value) const { json.number(key, value); }
    void operator()(const char* key, std::uint64_t value) const { json.integer(key, value); }
};

struct Reader {
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
    template <class T>
    void operator()(const char* key, T& value) const {
        const std::string& text = get<JsonValue::Number>(key).text;
        const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
        if (error != std::errc{} || end != text.data() + text.size())
            throw InputError(fmt::format("{}: \"{}\" is {}, which is no such number", file, key, text));
    }
};

}  // namespace

bool share_numbers(const LedgerLink& a, const LedgerLink& b) {
    const auto by_trace = [](const LedgerLink& link) { return !link.is_edit() || link.method == differences_method || link.method == old_graph_method; };
    return a.seed == b.seed && by_trace(a) == by_trace(b);
}

double accumulated_var_mean(const Ledger& ledger, std::size_t n) {
    double sum = 0;
    for (std::size_t i = 0; i < n; ++i) sum += ledger[i].var_mean;
    return sum;
}

double worth_samples(const Ledger& ledger, std::size_t n) {
    if (ledger.empty() || ledger.front().is_edit()) return 0;
    const double variance = accumulated_var_mean(ledger, n);
    while (n > 0 && ledger[n - 1].var_sample == 0) --n;
    if (n == 0) return 0;
    return variance > 0 ? ledger[n - 1].var_sample / variance : std::numeric_limits<double>::infinity();
}

std::string ledger_text(const Ledger& ledger) {
    if (ledger.empty()) return "";
    JsonWriter json;
    json.begin_array();
    for (const LedgerLink& link : ledger) {
        json.begin_object();
        members(link, Writer{json});
        json.end_object();
    }
    json.end_array();
    return json.str();
}

Ledger ledger_from_text(const std::string& text, const std::filesystem::path& file) {
    Ledger ledger;
    if (text.empty()) return ledger;
    const std::string where = file.native() + ": ledger";
    const JsonValue json = parse_json(text, where);
    const auto* links = std::get_if<JsonValue::Array>(&json.value);
    if (links == nullptr) throw InputError(where + ": is not a list");
    for (const JsonValue& link : *links) members(ledger.emplace_back(), Reader{link, where});
    return ledger;
}

}  // namespace loom
