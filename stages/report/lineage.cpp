#include <algorithm>
#include <cctype>
#include <map>

#include "formats/chain.h"
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

}  // namespace loom::report
