#pragma once
#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

namespace loom {

/// Cost of making one output. It is stored beside the output, because equal inputs give equal bytes but not equal
/// seconds. Costs are summed along the chain of parents. A parent may be deleted; its cost file stays.
struct Cost {
    std::string stage;
    double wall_s = 0, cpu_s = 0;
    std::uint64_t rays = 0;     // closest-hit and shadow rays
    std::uint64_t samples = 0;  // paths, or the stage's own unit of work
    std::uint64_t peak_memory_bytes = 0, bytes_written = 0;
    std::vector<std::string> parents;  // inputs made by stages: their paths relative to the output's folder
    std::vector<std::string> sources;  // names of inputs that no stage made (scenes); their cost is zero
    double load_s = 0;                 // share of cpu_s for reading the scene, independent of the image size
    std::string command, plan;  // copies of the output's attributes, for when it is deleted; empty in older files
    bool operator==(const Cost&) const = default;
};

/// Adds times and work of another output; of the memory peaks the larger one stays.
void add(Cost& sum, const Cost& cost);

/// Returns an input's path relative to the output: "pt/pass-0.exr" for "out/pt/pass-0.exr", parent of "out/image.exr".
std::string parent_of(const std::filesystem::path& output, const std::filesystem::path& input);

/// Returns the cost file of an output: "x.h5" -> "x.h5.cost.json".
std::filesystem::path cost_path(const std::filesystem::path& output);
void write_cost(const Cost& cost, const std::filesystem::path& output);
/// Completes the cost of a written output and writes it beside the output.
/// in:      cost     without bytes_written and parents; folders of its sources are dropped
///          parents  inputs made by stages, as paths relative to the working folder; empty ones are skipped
void write_cost_of(const std::filesystem::path& output, Cost cost, const std::vector<std::string>& parents);
/// Reads the cost of an output.
/// throws:  InputError when it is missing or damaged
Cost read_cost(const std::filesystem::path& output);

}  // namespace loom
