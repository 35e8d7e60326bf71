#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cctype>
#include <map>

#include "formats/chain.h"
#include "stages/report/html.h"
#include "stages/report/report.h"

namespace loom::report {
namespace {

namespace fs = std::filesystem;

/// Replaces numbers in the file's own name: "pt/pass-12.exr" -> "pt/pass-*.exr".
std::string pattern_of(const fs::path& name) {
    std::string file = name.filename().native(), out;
    for (std::size_t i = 0; i < file.size(); ++i) {
        const auto digit = [&](std::size_t k) { return std::isdigit(static_cast<unsigned char>(file[k])) != 0; };
        // A number in the extension (.h5) is kept.
        if (!digit(i) || file.find('.') < i) {
            out += file[i];
        } else if (i == 0 || !digit(i - 1)) {
            out += '*';
        }
    }
    return (name.parent_path() / out).generic_string();
}

}  // namespace

std::vector<Made> lineage_of(const std::string& picture) {
    const fs::path folder = fs::path(picture).parent_path();
    std::vector<Made> rows;
    std::map<std::string, std::size_t> row_by_key;
    std::map<std::string, std::string> row_name_by_file;
    const auto name_of = [&](const fs::path& file) {
        return file.lexically_relative(folder.empty() ? "." : folder).generic_string();
    };
    for (const ChainFile& made : read_chain(picture)) {
        const std::string file = folder.empty() ? made.file.generic_string() : name_of(made.file);
        const std::string name = pattern_of(file);
        const auto [at, is_new] = row_by_key.try_emplace(made.cost.stage + "\t" + name, rows.size());
        if (is_new) {
            rows.push_back({name, {}, {}, made.cost});
        } else {
            Cost& sum = rows[at->second].cost;
            sum.wall_s += made.cost.wall_s;
            sum.cpu_s += made.cost.cpu_s;
            sum.load_s += made.cost.load_s;
            sum.rays += made.cost.rays;
            sum.samples += made.cost.samples;
            sum.bytes_written += made.cost.bytes_written;
            sum.peak_memory_bytes = std::max(sum.peak_memory_bytes, made.cost.peak_memory_bytes);
        }
        Made& row = rows[at->second];
        row.names.push_back(file);
        row_name_by_file[made.file.lexically_normal().generic_string()] = name;
        std::vector<std::string> from = made.cost.sources;
        for (const std::string& parent : made.cost.parents) {
            const std::string key = (made.file.parent_path() / parent).lexically_normal().generic_string();
            const auto known = row_name_by_file.find(key);
            from.push_back(known == row_name_by_file.end() ? parent : known->second);
        }
        for (const std::string& one : from)
            if (std::find(row.from.begin(), row.from.end(), one) == row.from.end()) row.from.push_back(one);
    }
    // A row with one file has the file's own name.
    std::map<std::string, std::string> own_name;
    for (Made& row : rows) {
        if (row.names.size() > 1) continue;
        own_name[row.name] = row.names[0];
        row.name = row.names[0];
    }
    for (Made& row : rows)
        for (std::string& from : row.from)
            if (const auto known = own_name.find(from); known != own_name.end()) from = known->second;
    return rows;
}

double cpu_s_of(const std::vector<Made>& lineage) {
    double sum = 0;
    for (const Made& made : lineage) sum += made.cost.cpu_s;
    return sum;
}

std::string lineage_details(const std::string& name, const std::vector<Made>& lineage, bool open) {
    if (lineage.empty()) {
        return fmt::format(
            "<details><summary><b>{}</b> made by another program, its cost is not known</summary>"
            "</details>\n",
            name);
    }
    std::vector<Cells> rows;
    std::string plans;
    std::size_t n_files = 0;
    for (const Made& made : lineage) {
        std::string stage = made.cost.stage;
        if (stage.starts_with("loom-")) stage = stage.substr(5);
        n_files += made.names.size();
        rows.push_back({fmt::format("<code>{}</code>", escaped(made.name)), escaped(stage),
                        std::to_string(made.names.size()),
                        fmt::format("<code>{}</code>", escaped(fmt::format("{}", fmt::join(made.from, ", ")))),
                        number(made.cost.cpu_s), number(made.cost.wall_s), counted(double(made.cost.rays)),
                        bytes(double(made.cost.peak_memory_bytes)), bytes(double(made.cost.bytes_written))});
        if (made.cost.command.empty() && made.cost.plan.empty()) continue;
        plans += fmt::format("<dt><code>{}</code></dt><dd>", escaped(made.name));
        if (!made.cost.command.empty()) plans += fmt::format("<code>{}</code>", escaped(made.cost.command));
        if (!made.cost.plan.empty()) plans += fmt::format("<p>{}</p>", escaped(made.cost.plan));
        plans += "</dd>\n";
    }
    return fmt::format("<details{}>\n<summary><b>{}</b> {} files, {}\u202fs of CPU time</summary>\n{}{}</details>\n",
                       open ? " open" : "", name, n_files, number(cpu_s_of(lineage)),
                       table({"file", "stage", "n", "made from", "CPU s", "wall s", "rays", "peak", "size"}, rows),
                       plans.empty() ? "" : fmt::format("<dl class=\"plans\">\n{}</dl>\n", plans));
}

}  // namespace loom::report
