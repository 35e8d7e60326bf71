#pragma once
// What is in any HDF5 or EXR file, ours or not, for a person to look at.

#include <cstdint>
#include <filesystem>
#include <string>
#include <utility>
#include <vector>

namespace loom {

/// Of all numbers of a dataset or channel; min, mean and max are of the finite ones.
struct Statistics {
    std::uint64_t n = 0, n_nan = 0, n_inf = 0;
    double min = 0, mean = 0, max = 0;
};

struct DatasetSummary {
    std::string name, type, units, axes, description;
    std::vector<std::size_t> extents;
    std::uint64_t bytes = 0;  // of its numbers, unpacked
    std::string storage;      // "contiguous", "chunked", "compact"
    bool is_number = false;
    Statistics statistics;            // of numbers
    std::vector<std::string> values;  // of text and of single numbers: the first few
};

using NamedTexts = std::vector<std::pair<std::string, std::string>>;

struct Survey {
    enum class Kind { hdf5, exr } kind = Kind::hdf5;
    NamedTexts attributes;  // of the root, or of the EXR header
    std::vector<DatasetSummary> datasets;
    std::uint64_t file_bytes = 0;

    /// The value of an attribute; empty when there is none.
    std::string attribute(std::string_view name) const;
};

/// throws:  InputError when the file is neither HDF5 nor EXR, cut short or damaged
Survey survey_file(const std::filesystem::path& path);

}  // namespace loom
