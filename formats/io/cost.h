#pragma once
#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

namespace loom {

/// What making one output took. It lies beside the output, never in it: equal inputs give equal bytes, but
/// never equal seconds. Costs are added up along the chain of parents, which outlives the parents themselves:
/// an intermediate may go once it has been used, its cost stays.
struct Cost {
    std::string stage;
    double wall_s = 0, cpu_s = 0;
    std::uint64_t rays = 0;     // closest-hit and shadow rays
    std::uint64_t samples = 0;  // paths, or whatever the stage counts its work in
    std::uint64_t peak_memory_bytes = 0, bytes_written = 0;
    std::vector<std::string> parents;  // inputs that stages made: the way to each from the output's folder
    std::vector<std::string> sources;  // names of inputs that no stage made (scenes): they cost nothing
    double load_s = 0;                 // of cpu_s: reading the scene, which a picture of any size pays once
    std::string command, plan;         // as the output has them, for when it is gone; empty in older files
    bool operator==(const Cost&) const = default;
};

/// "out/pt/pass-0.exr" as a parent of "out/image.exr" -> "pt/pass-0.exr"
std::string parent_of(const std::filesystem::path& output, const std::filesystem::path& input);

/// "x.h5" -> "x.h5.cost.json"
std::filesystem::path cost_path(const std::filesystem::path& output);
void write_cost(const Cost& cost, const std::filesystem::path& output);
/// Completes the cost of a written output and writes it beside the output.
/// in:      cost     without bytes_written and parents; sources may have folders, which are dropped
///          parents  inputs that stages made, as paths from the working folder; empty ones are skipped
void write_cost_of(const std::filesystem::path& output, Cost cost, const std::vector<std::string>& parents);
/// The cost of an output.
/// throws:  InputError when there is none, or it is damaged
Cost read_cost(const std::filesystem::path& output);

}  // namespace loom
