#include "formats/io/cost.h"

#include <algorithm>
#include <nlohmann/json.hpp>

#include "formats/io/json_members.h"
#include "formats/io/mapped_file.h"
#include "formats/io/output_file.h"

namespace loom {
namespace {

/// The single list of members, for writer and reader.
template <class Self, class Visitor>
void members(Self& cost, Visitor&& visit) {
    visit("stage", cost.stage);
    visit("wall_s", cost.wall_s);
    visit("cpu_s", cost.cpu_s);
    visit("rays", cost.rays);
    visit("samples", cost.samples);
    visit("peak_memory_bytes", cost.peak_memory_bytes);
    visit("bytes_written", cost.bytes_written);
    visit("parents", cost.parents);
    visit("sources", cost.sources);
    visit.optional("load_s", cost.load_s);
    visit.optional("command", cost.command);
    visit.optional("plan", cost.plan);
}

}  // namespace

void add(Cost& sum, const Cost& cost) {
    sum.wall_s += cost.wall_s;
    sum.cpu_s += cost.cpu_s;
    sum.load_s += cost.load_s;
    sum.rays += cost.rays;
    sum.samples += cost.samples;
    sum.bytes_written += cost.bytes_written;
    sum.peak_memory_bytes = std::max(sum.peak_memory_bytes, cost.peak_memory_bytes);
}

std::string parent_of(const std::filesystem::path& output, const std::filesystem::path& input) {
    namespace fs = std::filesystem;
    const fs::path folder = fs::absolute(output).lexically_normal().parent_path();
    return fs::absolute(input).lexically_normal().lexically_relative(folder).generic_string();
}

std::filesystem::path cost_path(const std::filesystem::path& output) {
    std::filesystem::path path = output;
    path += ".cost.json";
    return path;
}

void write_cost(const Cost& cost, const std::filesystem::path& output) {
    JsonWriter json;
    json.begin_object();
    members(cost, MemberWriter{json});
    json.end_object();
    write_text_file(cost_path(output), json.str());
}

void write_cost_of(const std::filesystem::path& output, Cost cost, const std::vector<std::string>& parents) {
    cost.bytes_written = std::filesystem::file_size(output);
    for (std::string& source : cost.sources) source = std::filesystem::path(source).filename();
    for (const std::string& parent : parents)
        if (!parent.empty()) cost.parents.push_back(parent_of(output, parent));
    write_cost(cost, output);
}

Cost read_cost(const std::filesystem::path& output) {
    const std::string file = cost_path(output).native();
    const MappedFile mapped(file);
    const auto bytes = mapped.bytes();
    const nlohmann::json json = parse_json({reinterpret_cast<const char*>(bytes.data()), bytes.size()}, file);
    Cost cost;
    members(cost, MemberReader{json, file});
    return cost;
}

}  // namespace loom
