#include "formats/ledger.h"

#include <limits>
#include <nlohmann/json.hpp>

#include "formats/io/error.h"
#include "formats/io/json_members.h"

namespace loom {
namespace {

/// The single list of members, for writer and reader.
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

}  // namespace

bool share_numbers(const LedgerLink& a, const LedgerLink& b) {
    const auto by_trace = [](const LedgerLink& link) {
        return !link.is_edit() || link.method == differences_method || link.method == old_graph_method;
    };
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
        members(link, MemberWriter{json});
        json.end_object();
    }
    json.end_array();
    return json.str();
}

Ledger ledger_from_text(const std::string& text, const std::filesystem::path& file) {
    Ledger ledger;
    if (text.empty()) return ledger;
    const std::string where = file.native() + ": ledger";
    const nlohmann::json json = parse_json(text, where);
    if (!json.is_array()) throw InputError(where + ": is not a list");
    for (const nlohmann::json& link : json) members(ledger.emplace_back(), MemberReader{link, where});
    return ledger;
}

}  // namespace loom
