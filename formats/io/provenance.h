#pragma once
#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

namespace loom {

/// An input by name and content. The name has no folder, so that equal inputs give equal bytes in any folder.
struct InputId {
    std::string name;
    std::string hash;  // XXH64, 16 hexadecimal digits
    bool operator==(const InputId&) const = default;
};

/// Computes name and content hash of a file.
/// throws:  InputError when the file cannot be read
InputId identify(const std::filesystem::path& path);

/// Identifies several files whose samples are combined.
/// throws:  InputError when two files have the same samples: the variance would be halved, but not the error
std::vector<InputId> identify_parts(const std::vector<std::string>& files);

/// Return the release and the commit of this build.
std::string build_release();
std::string build_commit();

/// Origin of a file: the root attributes that all formats have in common. Holds no clock time, host name or absolute
/// path.
struct Provenance {
    std::string stage = "unknown";  // "loom-trace"
    std::string release = build_release();
    std::string commit = build_commit();
    std::string command;  // resolved options, defaults included
    std::uint64_t seed = 0;
    std::vector<InputId> inputs;
    std::string plan;  // one line: which features are on or off, and why
    bool operator==(const Provenance&) const = default;
};

// Text forms of these attributes, equal in HDF5 and EXR.
std::string producer_text(const Provenance& provenance);  // "loom-trace 0.1.0 0123456789ab"
void set_producer(Provenance& provenance, const std::string& text);
std::string input_text(const InputId& input);  // "0123456789abcdef scene.xml"
InputId input_from_text(const std::string& text);

}  // namespace loom
