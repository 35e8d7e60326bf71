#pragma once
#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

namespace loom {

/// An input by name (no folder: equal inputs give equal bytes wherever they lie) and content.
struct InputId {
    std::string name;
    std::string hash;  // XXH64, 16 hexadecimal digits
    bool operator==(const InputId&) const = default;
};

/// Name and content hash of a file.
/// throws:  InputError when it cannot be read
InputId identify(const std::filesystem::path& path);

/// The same of parts whose samples go together.
/// throws:  InputError when the same samples are there twice: they would halve the variance without halving the error
std::vector<InputId> identify_parts(const std::vector<std::string>& files);

/// The release and the commit of this build.
std::string build_release();
std::string build_commit();

/// Where a file comes from: the root attributes that all formats have in common. No clock, host or
/// absolute path.
struct Provenance {
    std::string stage = "unknown";  // "loom-trace"
    std::string release = build_release();
    std::string commit = build_commit();
    std::string command;  // resolved options, defaults included
    std::uint64_t seed = 0;
    std::vector<InputId> inputs;
    std::string plan;  // one line: what is on, what is off and why
    bool operator==(const Provenance&) const = default;
};

// The forms that these take as attributes, the same in HDF5 and EXR.
std::string producer_text(const Provenance& provenance);  // "loom-trace 0.1.0 0123456789ab"
void set_producer(Provenance& provenance, const std::string& text);
std::string input_text(const InputId& input);  // "0123456789abcdef scene.xml"
InputId input_from_text(const std::string& text);

}  // namespace loom
